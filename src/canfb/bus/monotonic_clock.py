"""The clock of durations, for what shows how long something takes."""

from __future__ import annotations

import time


def now_s() -> float:
    """Seconds since some moment; no setting of the time of day moves it."""
    return time.monotonic()
