"""What the fault campaign counts, and its table."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields

from tools.faults.chain.judge import Verdict

DETECTION_GOAL = 0.99
SOON_SAMPLES = 3

IN_SHORT = ("soon", "detected", "lost")  # %, see docs/evidence.md


@dataclass
class Tally:
    """Sums over episodes of one class at one setting.

    same, soon, later      first sample without VALID: the first faulty one, at most 3 after it, later
    harmless               never flagged, and never wrong by more than a quarter of a cycle
    legal                  never flagged, wrong, and all samples are those of a legal motion
    silent                 never flagged, wrong, and no legal motion has these samples
    matters, matters_seen  episodes that did harm or would have, and those of them that were flagged
    wrong_legal, wrong_reported, wrong_silent  wrong positions published as valid, samples; longest_run of all
    cycle_legal, cycle_lost    valid at the end with a wrong count: legal or reported, or not
    lost                   called lost at the end
    false_alarms           clean samples flagged before a fault began: that episode counts no further
    violations             where to find what must not be: seeds of the episodes
    """

    episodes: int = 0
    faulty: int = 0
    same: int = 0
    soon: int = 0
    later: int = 0
    harmless: int = 0
    legal: int = 0
    silent: int = 0
    matters: int = 0
    matters_seen: int = 0
    wrong_legal: int = 0
    wrong_reported: int = 0
    wrong_silent: int = 0
    longest_run: int = 0
    cycle_legal: int = 0
    cycle_lost: int = 0
    lost: int = 0
    false_alarms: int = 0
    violations: list[str] = field(default_factory=list)

    def add(self, verdict: Verdict, seed: str) -> None:
        """Count one episode; ``seed`` names it."""
        if verdict.flagged_before:
            self.false_alarms += 1
            return
        self.episodes += 1
        self.faulty += verdict.faulty
        self._add_detection(verdict)
        self.matters += verdict.matters
        self.matters_seen += verdict.matters and verdict.delay is not None
        self.wrong_legal += verdict.wrong_legal
        self.wrong_reported += verdict.wrong_reported
        self.wrong_silent += verdict.wrong_silent
        self.longest_run = max(self.longest_run, verdict.longest_run)
        self.cycle_legal += verdict.wrong_count and not verdict.wrong_silent
        self.cycle_lost += verdict.wrong_count and verdict.wrong_silent > 0
        self.lost += verdict.lost
        if verdict.wrong_silent:
            self.violations.append(seed)

    def _add_detection(self, verdict: Verdict) -> None:
        if verdict.delay is not None:
            self.same += verdict.delay == 0
            self.soon += 0 < verdict.delay <= SOON_SAMPLES
            self.later += verdict.delay > SOON_SAMPLES
        elif not verdict.harmful:
            self.harmless += 1
        elif verdict.legal:
            self.legal += 1
        else:
            self.silent += 1

    def merge(self, other: Tally) -> None:
        """Add the sums of ``other``."""
        for one in fields(self):
            mine, theirs = getattr(self, one.name), getattr(other, one.name)
            setattr(self, one.name, max(mine, theirs) if one.name == "longest_run" else mine + theirs)

    @property
    def detection(self) -> float:
        """Part detected of the episodes that did harm or would have."""
        return self.matters_seen / self.matters if self.matters else 1.0

    @property
    def detection_of_illegal(self) -> float:
        """The same without those that were not seen and are legal motions."""
        rest = self.matters - self.legal
        return self.matters_seen / rest if rest else 1.0

    @property
    def misses(self) -> list[str]:
        """The goals that are missed."""
        missed = []
        if self.wrong_silent:
            missed.append(f"{self.wrong_silent} silent wrong positions")
        if self.detection_of_illegal < DETECTION_GOAL:
            missed.append(f"only {self.detection_of_illegal:.2%} detected")
        if self.false_alarms:
            missed.append(f"{self.false_alarms} false alarms before the fault")
        if self.cycle_lost:
            missed.append(f"{self.cycle_lost} cycles lost")
        return missed

    @property
    def soon_part(self) -> float:
        """Part of the flagged episodes that were flagged at most three samples after the first faulty one."""
        flagged = self.same + self.soon + self.later
        return (self.same + self.soon) / flagged if flagged else 0.0

    def in_short(self) -> tuple[str, ...]:
        """The cells of the table that compares settings (:data:`IN_SHORT`)."""
        lost = self.lost / self.episodes if self.episodes else 0.0
        return tuple(f"{100.0 * part:.1f}" for part in (self.soon_part, self.detection, lost))

    def record(self) -> dict[str, object]:
        """For a program to read."""
        rates = {"detection": self.detection, "detection_of_illegal": self.detection_of_illegal}
        return asdict(self) | rates | {"misses": self.misses}
