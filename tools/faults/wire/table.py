"""What was counted over the episodes, as a table."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from tools.faults.wire.judge import EMCY_LIMIT, Verdict
from tools.faults.wire.play import Episode

OUTCOMES = ("wrong", "physics", "lost", "flagged", "kept")
HEAD = (
    "class",
    "set-up",
    "episodes",
    "silent wrong",
    "physics",
    "lost",
    "flagged",
    "kept",
    "early",
    "accel.",
    "EMCY",
    "PDOs",
)
EXAMPLES = 3


@dataclass
class Tally:
    """The episodes of one class and set-up."""

    episodes: int = 0
    outcomes: dict[str, int] = field(default_factory=lambda: dict.fromkeys(OUTCOMES, 0))
    early: int = 0
    after_start: int = 0  # not valid later than a start may take
    acceleration: int = 0
    emergencies: int = 0
    unanswered: int = 0
    examples: list[str] = field(default_factory=list)

    def add(self, episode: Episode, verdict: Verdict) -> None:
        self.episodes += 1
        self.outcomes[verdict.outcome] += 1
        self.early += verdict.early > 0
        self.after_start += verdict.after_start > 0
        self.acceleration += verdict.acceleration_wrong > 0
        self.emergencies += verdict.emergencies > EMCY_LIMIT
        self.unanswered += verdict.unanswered > 0
        if verdict.outcome == "wrong" and len(self.examples) < EXAMPLES:
            first = verdict.first_wrong
            where = f"{first.error:+.1f} cycles at {first.now:.1f} T" if first else ""
            self.examples.append(f"{episode}: {verdict.wrong} frames, first {where}")

    def merge(self, other: Tally) -> None:
        self.episodes += other.episodes
        for name in OUTCOMES:
            self.outcomes[name] += other.outcomes[name]
        self.early += other.early
        self.after_start += other.after_start
        self.acceleration += other.acceleration
        self.emergencies += other.emergencies
        self.unanswered += other.unanswered
        self.examples = (self.examples + other.examples)[:EXAMPLES]

    def row(self, *names: str) -> tuple[str, ...]:
        own = (self.early, self.acceleration, self.emergencies, self.unanswered)
        numbers = (self.episodes, *self.outcomes.values(), *own)
        return (*names, *map(str, numbers))


def plain(rows: Iterable[tuple[str, ...]]) -> str:
    """Rows with aligned columns, the first of them the heads."""
    lines = list(rows)
    widths = [max(len(row[n]) for row in lines) for n in range(len(lines[0]))]
    return "".join(
        "  ".join(
            cell.ljust(w) if n < 2 else cell.rjust(w)
            for n, (cell, w) in enumerate(zip(row, widths, strict=True))
        )
        + "\n"
        for row in lines
    )


def markdown(rows: Iterable[tuple[str, ...]]) -> str:
    """The same for the documentation."""
    head, *body = rows
    rule = ("---", "---", *("---:" for _ in head[2:]))
    return "".join("| " + " | ".join(row) + " |\n" for row in (head, rule, *body))
