"""What a user can mend: one line that says what is wrong, where, and what to do."""

from __future__ import annotations


class UserError(Exception):
    """Bad input or a bad configuration. The command line prints it as one line and exits with status 2.

    Args:
        where: the file, key or option at fault.
        what: what is wrong with it.
        remedy: what to do about it.
    """

    def __init__(self, where: object, what: str, remedy: str) -> None:
        self.where, self.what, self.remedy = str(where), what, remedy
        super().__init__(f"{where}: {what}; {remedy}")
