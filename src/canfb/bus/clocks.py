"""Clocks, and receive times converted to the monotonic clock.

A frame received at t and processed at t + d, d >= 0, shows the difference of two clocks as offset + d. The
minimum over many frames estimates the offset; it may rise slowly, because the clocks drift.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from datetime import UTC, datetime
from math import inf, isfinite

from canfb.errors import ConfigError

now_s = time.monotonic


def date_and_time() -> str:
    return local_time().isoformat(" ", "seconds")


def page_date() -> str:
    """Now, or SOURCE_DATE_EPOCH (seconds since 1970, UTC); ConfigError if that is not a number."""
    said = os.environ.get("SOURCE_DATE_EPOCH")
    if said is None:
        return date_and_time()
    try:
        return datetime.fromtimestamp(int(said), UTC).isoformat(" ", "seconds")
    except (ValueError, OverflowError, OSError):
        raise ConfigError(f"SOURCE_DATE_EPOCH {said!r}: seconds since 1970 are required") from None


def file_date_and_time() -> tuple[str, str]:
    """Now, in the format of CiA 306: mm-dd-yyyy, and hh:mm with AM or PM."""
    now = datetime.now()
    return now.strftime("%m-%d-%Y"), now.strftime("%I:%M%p")


def local_time() -> datetime:
    return datetime.now().astimezone()


LARGEST_STEP_S = 0.0005  # a larger change of the difference between both clocks is a step of the wall clock
CLOSE_S = 1e-5  # an increase beyond this is measured again: the process may have been suspended in between
LOOKS = 3
LONGEST_DELAY_S = 60.0  # an older time stamp is not of the wall clock
DRIFT = 2e-4  # largest relative drift: two crystals of 100 ppm each
# The offset is found if at least one of this many frames is processed without delay.
LEARNED_FRAMES = 64


class OtherClock:
    """The clock of an adapter or controller: its offset is the least difference, which may rise by DRIFT.

    Known after LEARNED_FRAMES; learned again after a step of LARGEST_STEP_S or a delay above
    ``longest_delay_s``.
    """

    def __init__(self, longest_delay_s: float = LONGEST_DELAY_S) -> None:
        self._longest_delay_s = longest_delay_s
        self._stamp_s = self._taken_s = -inf  # time stamp and processing time of the last frame
        self._offset_s = self._least_s = inf
        self._left = LEARNED_FRAMES  # frames left until the least delay of all of them is checked
        self._known = False

    def received(self, stamp_s: float, now: float) -> float | None:
        """Receive time of the frame with this stamp, at most ``now``; None: not known."""
        last, self._stamp_s = self._stamp_s, stamp_s
        passed_s, self._taken_s = now - self._taken_s, now
        difference_s = now - stamp_s
        self._offset_s += DRIFT * passed_s
        late_s = difference_s - self._offset_s
        fits = stamp_s >= last and -LARGEST_STEP_S <= late_s <= self._longest_delay_s
        if not (isfinite(difference_s) and fits):
            self._learn(difference_s)
            return None
        self._offset_s = min(self._offset_s, difference_s)
        self._least_s = min(self._least_s, difference_s)
        self._left -= 1
        if not self._left:
            if self._least_s - self._offset_s > LARGEST_STEP_S:
                self._learn(self._least_s)
                return None
            self._least_s, self._left, self._known = inf, LEARNED_FRAMES, True
        return min(now, stamp_s + self._offset_s) if self._known and stamp_s > last else None

    def _learn(self, offset_s: float) -> None:
        self._offset_s = offset_s if isfinite(offset_s) else inf
        self._least_s, self._left, self._known = inf, LEARNED_FRAMES, False


class ReceiveTimes:
    """Converts time stamps of python-can to monotonic seconds.

    After the wall clock is set, frames have no receive time until the queue has been empty.
    """

    def __init__(self, clock: Callable[[], float], wall: Callable[[], float]) -> None:
        self._clock = clock
        self._wall = wall
        self._stepped = False
        self._other = OtherClock()
        self._difference_s = self._look()

    def emptied(self) -> None:
        if self._stepped:
            self._stepped = False
            self._difference_s = self._look()

    def received(self, stamp_s: float, now: float) -> float | None:
        difference_s = self._wall() - now
        if not -LARGEST_STEP_S <= difference_s - self._difference_s <= CLOSE_S:
            looked_s = self._look()  # a wrong difference would make frames look older than they are
            self._stepped |= abs(looked_s - self._difference_s) > LARGEST_STEP_S
            difference_s = self._difference_s = looked_s
        # A suspension between the two readings increases the difference: the smallest is the best estimate.
        self._difference_s = min(difference_s, self._difference_s)
        if self._stepped:
            return None
        delay_s = difference_s + now - stamp_s
        if not -LARGEST_STEP_S <= delay_s <= LONGEST_DELAY_S:
            return self._other.received(stamp_s, now)
        return min(now, now - delay_s)

    def _look(self) -> float:
        looks = []
        for _ in range(LOOKS):
            before = self._clock()
            wall = self._wall()
            after = self._clock()
            looks.append((after - before, wall - (before + after) / 2.0))
        return min(looks)[1]
