"""An SDO write that was taken, and whose answer waits until its effect has come."""

from __future__ import annotations

from collections.abc import Callable

from canfb.cia301.codes import AbortCode

Ended = Callable[[AbortCode | None], None]


class Pending:
    """Made by the object (`Core.pending`), taken by the SDO server, which waits for `end`.

    `on_end(code)`: the write is done, or is to be aborted with `code`. None: nobody waits any more.
    """

    __slots__ = ("code", "ended", "on_end")

    def __init__(self) -> None:
        self.ended = False
        self.code: AbortCode | None = None
        self.on_end: Ended | None = None

    def end(self, code: AbortCode | None) -> None:
        """The effect has come, or has failed with `code`."""
        self.ended, self.code = True, code
        if self.on_end is not None:
            self.on_end(code)
