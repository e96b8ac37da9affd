"""The one exception a user sees: a line that names the file, the cause and the way out."""

from __future__ import annotations


class AttestError(Exception):
    """A fault of the input or of the request, told in one line.

    Parameters
    ----------
    message : str
        What is wrong, with the name of the file.
    hint : str
        The way out; empty where there is none.
    """

    def __init__(self, message: str, hint: str = "") -> None:
        self.message = message
        self.hint = hint
        super().__init__(f"{message}; {hint}" if hint else message)


class UsageError(AttestError):
    """A fault of the command line: exit code 2."""
