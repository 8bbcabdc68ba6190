"""What the judgement of a SYNC says to those who take its sample (sync_judge.py)."""

from __future__ import annotations

from typing import NamedTuple


class SyncVerdict(NamedTuple):
    """What a SYNC shows.

    missed     samples that are missing for certain, and were not reported yet
    extra      no sample is to be expected for it
    repeated   the same SYNC twice, by its counter: nothing is to be done with it
    lost       SYNCs before it that were not received
    confirmed  the one of the last set of intervals that was true, None: not known
    doubt      so many intervals may or may not have passed, and nothing will show it; 0.0: none. Less than
               half of one is a step of the grid
    """

    missed: int = 0
    extra: bool = False
    repeated: bool = False
    lost: int = 0
    confirmed: float | None = None
    doubt: float = 0.0


NOTHING_TO_REPORT = SyncVerdict()  # which a late or early SYNC may have, too
EXTRA = SyncVerdict(extra=True)
REPEATED = SyncVerdict(extra=True, repeated=True)
