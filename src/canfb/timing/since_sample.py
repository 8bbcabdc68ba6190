"""The intervals since the last sample: SYNCs add to them, and each sample takes them.

Both sides of the judgement meet here. A SYNC that has come is one interval more, and so is each one before it
that was not received (sync_judge.py). A sample that answers it takes what has passed; where it may answer
another SYNC as well, so many intervals are left open for the next one (judge.py).
"""

from __future__ import annotations

MOST_INTERVALS = 1 << 20  # more are as good as lost


class SinceSample:
    """What has passed since the last sample, in intervals."""

    __slots__ = (
        "answered",
        "before_open",
        "earlier",
        "error",
        "error_before",
        "intervals",
        "lowest",
        "sampled",
        "slack",
        "slack_before",
        "taken",
        "usual",
    )

    def __init__(self) -> None:
        self.begin()

    def begin(self) -> None:
        """The next sample is the first one."""
        self.sampled = False
        """A sample came since the start."""
        self.intervals = 0
        """From the last sample to the last SYNC; below 0 if it may have answered a later one."""
        self.answered = True
        """No sample is to come for the last SYNC: it has one, or that was given up."""
        self.usual = False
        """The last SYNC was usual, and has no sample yet."""
        self.before_open = False
        """The SYNC before the last one has no sample."""
        self.slack = 0
        """Intervals that the next sample may be further from the last one."""
        self.earlier = 0
        """Of these, because the last one may have answered the SYNC before the last."""
        self.lowest: float | None = None
        """The fewest of the last sample: right unless it answered a later SYNC; None: it has one."""
        self.error = self.error_before = 0.0
        """Of the instant of the last SYNC, and of the last sample, intervals."""
        self.taken = self.slack_before = 0
        """Intervals that the last sample took, and ``slack`` before it."""

    # SYNCs.

    def add(self, lost: int, is_behind: bool) -> tuple[int, float | None]:
        """A SYNC, and ``lost`` before it that were not received; ``is_behind``: more may be missing.

        Samples that are missing for certain, and of the intervals of the last sample the one that was true,
        None if that does not follow.
        """
        missed = lost + (not self.answered) if self.sampled else 0
        missed = max(0, missed + min(0, self.intervals))  # the last sample may have answered some of them
        self.before_open = self.sampled and (not self.answered or lost > 0)
        self.pass_by(1 + lost)
        confirmed = None
        if not lost and not is_behind:  # what came before this SYNC answers none after the one before
            self.intervals += self.slack - self.earlier
            self.slack, confirmed = self.earlier, self.lowest
        else:  # it may have answered one of those that were not received
            self.earlier = self.slack
        self.lowest, self.error = None, 0.0
        self.answered = self.usual = False
        return missed, confirmed

    def pass_by(self, intervals: int) -> None:
        """So many passed."""
        self.intervals = min(self.intervals + intervals, MOST_INTERVALS)

    # Samples.

    def take(self, first: int, last: int) -> tuple[int, int]:
        """A sample answers one of the SYNCs ``first`` to ``last``: 0 the last one, -1 the one before, ...

        The fewest and the most intervals that may have passed up to it.
        """
        since = max(1, self.intervals) if self.sampled else 1
        low, high = max(1, since + first), max(1, since + last + self.slack)
        self.slack_before, self.slack = self.slack, last - first
        self.earlier = max(0, -first)
        self.taken, self.intervals = since, -last
        self.error_before = self.error
        self.usual = False
        self.answered = self.sampled = True
        return low, high

    def give_back(self) -> None:
        """The last sample was not taken after all."""
        self.slack = self.earlier = self.slack_before
        self.pass_by(max(1, self.taken))
        self.answered = self.usual = False
