"""Frames of a log in the order of their stamps, although some were written down late.

A step back is a clock that was set if the frames behind it fill half of the way to the newest stamp without
reaching it, and half of them have a CAN-ID that came with a later stamp; or if it is longer than the window
and lasts.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterable, Iterator
from itertools import accumulate, chain, repeat
from operator import itemgetter, le

from canfb.cia301.frame import Frame
from canfb.logfile.log_files import LogCounters

WINDOW_S = 1.0
"""A frame later than this does not get its place; it is taken as if it had come when it was written."""
MOST_LATE = 100  # frames behind a longer step back that may be late as well
LOOK_BEHIND = 8  # older frames: late ones stand among those before a step
MOST_HELD = 1 << 16  # frames: stamps that stand still come to an end as well


def in_order(batches: Iterable[list[Frame]], counters: LogCounters) -> Iterator[list[Frame]]:
    """The same frames; their stamps (seconds, of any clock) go back where the clock was set, and nowhere
    else. Frames with the same stamp keep their order, and those whose stamp is no number their place.
    """
    held: list[Frame] = []
    for batch, end in chain(zip(batches, repeat(False)), [([], True)]):
        held += batch
        again = True
        while held and again:
            ready, held, again = _ready(held, end, counters)
            yield ready


def _ready(frames: list[Frame], end: bool, counters: LogCounters) -> tuple[list[Frame], list[Frame], bool]:
    """Frames that are in order, those held back, and whether the first of these begins a set clock."""
    stamps = _stamps(frames)
    if all(map(le, stamps, stamps[1:])):
        cut = len(frames) if end else bisect_left(stamps, stamps[-1] - WINDOW_S)
        return frames[:cut], frames[cut:], False
    newest, looked_to = -math.inf, 0
    for n, stamp in enumerate(stamps):
        if stamp < newest and n >= looked_to:
            was_set, looked_to = _clock_was_set(frames, stamps, n, newest)
            if looked_to == len(frames) and not end and len(frames) - n < MOST_HELD:  # undecided
                ready, held = _sorted(frames[:n], stamps[:n], newest - WINDOW_S, counters)
                return ready, held + frames[n:], False
            if was_set:
                return _sorted(frames[:n], stamps[:n], math.inf, counters)[0], frames[n:], True
        newest = max(newest, stamp)
    ready, held = _sorted(frames, stamps, math.inf if end else newest - WINDOW_S, counters)
    return ready, held, False


def _sorted(
    frames: list[Frame], stamps: list[float], limit_s: float, counters: LogCounters
) -> tuple[list[Frame], list[Frame]]:
    ready, held = [], []
    for frame, stamp, newest in zip(frames, stamps, accumulate(stamps, max), strict=True):
        if newest - stamp > WINDOW_S:
            frame, stamp = frame._replace(timestamp=newest), newest
        if stamp < limit_s:
            counters.late += stamp < newest
            ready.append((stamp, frame))
        else:
            held.append(frame)
    return [frame for _, frame in sorted(ready, key=itemgetter(0))], held


def _stamps(frames: list[Frame]) -> list[float]:
    stamps = [-math.inf if frame[3] is None else frame[3] for frame in frames]
    if not all(map(math.isfinite, stamps)):
        before = next(filter(math.isfinite, stamps), 0.0)
        for n, stamp in enumerate(stamps):
            before = stamps[n] = stamp if math.isfinite(stamp) else before
    return stamps


def _clock_was_set(frames: list[Frame], stamps: list[float], begin: int, newest: float) -> tuple[bool, int]:
    """Whether it was set before this frame, and where the frames end that say so.

    That is ``len(frames)`` if there are too few of them to say.
    """
    back_s = newest - stamps[begin]
    is_long = back_s > WINDOW_S
    before: dict[int, float] = {}
    older = 0
    for n in range(begin - 1, -1, -1):
        older += stamps[n] < stamps[begin]
        if is_long or older > LOOK_BEHIND:
            break
        before[frames[n][0]] = max(stamps[n], before.get(frames[n][0], stamps[n]))
    again = 0
    for n in range(begin, len(frames)):
        stamp = stamps[n]
        if stamp >= newest:
            return False, n
        again += before.get(frames[n][0], -math.inf) > stamp
        if is_long and n - begin == MOST_LATE:
            return True, n
        if not is_long and stamp - stamps[begin] >= back_s / 2.0 and n > begin:
            return 2 * again >= n - begin, n
    return is_long, len(frames)
