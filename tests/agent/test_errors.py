"""A user's error is one line, whatever the user's files hold."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from agent.errors import UserError


def test_the_line_says_where_what_and_what_to_do() -> None:
    assert str(UserError("lab.toml: cell", "is 0", "give 0.02")) == "lab.toml: cell: is 0; give 0.02"


@given(st.text(), st.text(), st.text())
def test_whatever_it_quotes_the_error_is_one_printable_line(where: str, what: str, remedy: str) -> None:
    """A key with a line break once made two lines, and one with an escape sequence could paint the terminal."""
    error = UserError(where, what, remedy)
    assert str(error).isprintable()
    assert (error.where.isprintable(), error.what.isprintable(), error.remedy.isprintable()) == (True, True, True)


def test_letters_of_any_script_stay_readable() -> None:
    assert str(UserError("räume/実験.log", "ist leer", "…")) == "räume/実験.log: ist leer; …"
