"""What must last for some time: the target reached, a following error too large."""

from __future__ import annotations


class Lasting:
    """True once something has been so for a time."""

    def __init__(self) -> None:
        self._since: float | None = None

    def reset(self) -> None:
        """It is not so."""
        self._since = None

    def update(self, is_so: bool, duration_s: float, now: float) -> bool:
        """Whether it has been so for ``duration_s`` at ``now``, both in seconds."""
        if not is_so:
            self._since = None
            return False
        if self._since is None:
            self._since = now
        # Sums of times round: a whole number of periods must count as such.
        return now - self._since >= duration_s - 1e-9
