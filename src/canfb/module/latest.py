"""The last feedback, for all who publish it or compute from it."""

from __future__ import annotations

from canfb.signal.feedback import Feedback


class Latest:
    """``feedback`` is the last one, ``valid`` the last one with a valid position; None before the first."""

    __slots__ = ("feedback", "valid")

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """After a reset of the node: no sample."""
        self.feedback: Feedback | None = None
        self.valid: Feedback | None = None
