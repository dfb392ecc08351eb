"""What a user can mend: one line that says what is wrong, where, and what to do."""

from __future__ import annotations


class UserError(Exception):
    """Bad input or a bad configuration. The command line prints it as one line and exits with status 2.

    Keys, names and values come from the user's files: whatever in them is no printable character is shown escaped.

    Args:
        where: the file, key or option at fault.
        what: what is wrong with it.
        remedy: what to do about it.
    """

    def __init__(self, where: object, what: str, remedy: str) -> None:
        self.where, self.what, self.remedy = printable(str(where)), printable(what), printable(remedy)
        super().__init__(f"{self.where}: {self.what}; {self.remedy}")


def printable(text: str) -> str:
    """The text with whatever a terminal could take for an order shown escaped."""
    return "".join(sign if sign.isprintable() else repr(sign)[1:-1] for sign in text)
