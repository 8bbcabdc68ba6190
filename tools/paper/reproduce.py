"""Try every claim of the paper, and print the table of docs/paper.md with what comes out here.

    python -m tools.paper.reproduce [--fast]

The paper is Hoescheler and Szamel, Up-to-date Technique for Easy High-Accuracy Position
Acquisition with Sinusoidal Incremental Encoders, 1997. --fast takes shorter runs. Exit status
1 when a claim does not hold.
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from tools.paper import conventional, detection, phase, tracking
from tools.paper.claim import FAST, FULL, Claim, Effort, Maker, Verdict

PAGE = Path(__file__).parents[2] / "docs" / "paper.md"
# In the order of the paper, and of the rows of docs/paper.md.
MAKERS: tuple[Maker, ...] = (
    phase.introduction,
    conventional.conventional,
    phase.phases,
    phase.reference_measurement,
    tracking.acceleration_limit,
    tracking.long_runs,
    tracking.start_up,
    detection.two_thirds,
    detection.too_fast,
    detection.never_forgets,
    phase.conclusion,
    detection.cables,
)


def claims(effort: Effort) -> Iterator[Claim]:
    for maker in MAKERS:
        yield from maker(effort)


def rows_of_the_page() -> list[list[str]]:
    """Rows of docs/paper.md without the head: place, claim, value of the paper, result, agreement."""
    lines = PAGE.read_text(encoding="utf-8").splitlines()
    _, _, *rows = (line.strip("| ").split(" | ") for line in lines if line.startswith("|"))
    return rows


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tools.paper.reproduce", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("--fast", action="store_true", help="shorter runs")
    options = parser.parse_args(argv)
    failed, rows = [], rows_of_the_page()
    print("| place | claim | the paper | ours | agrees |\n| --- | --- | --- | --- | --- |")
    for row, claim in zip(rows, claims(FAST if options.fast else FULL), strict=True):
        print("|", " | ".join([*row[:3], claim.ours, claim.verdict]), "|", flush=True)
        failed += [claim.key] if claim.verdict is Verdict.NO else []
    print(f"\n{len(rows)} claims, {len(failed)} do not hold{': ' if failed else ''}{', '.join(failed)}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
