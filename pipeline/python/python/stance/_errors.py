"""The exception of the package."""

from __future__ import annotations


class Error(Exception):
    """Raised by a call that fails.

    Scripts may rely on ``code``, such as ``E-IO`` or a code of the table ``quarantine``; ``E-FAILED`` if there is no
    other. ``item`` is the file, folder or clip that the error concerns, or ``None``.
    """

    def __init__(self, message: str, code: str = "E-FAILED", item: str | None = None) -> None:
        super().__init__(message, code, item)

    @property
    def code(self) -> str:
        return self.args[1]

    @property
    def item(self) -> str | None:
        return self.args[2]

    def __str__(self) -> str:
        return self.args[0]
