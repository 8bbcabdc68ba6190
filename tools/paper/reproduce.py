"""Try every claim of the paper, and print a table: what the paper says, what comes out here.

    python -m tools.paper.reproduce [--fast]

The paper is Hoescheler and Szamel, Up-to-date Technique for Easy High-Accuracy Position
Acquisition with Sinusoidal Incremental Encoders, 1997. --fast takes shorter runs. Exit status
1 when a claim does not hold. docs/paper.md says more.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence

from tools.paper import conventional, detection, phase, tracking
from tools.paper.claim import COLUMNS, FAST, FULL, Claim, Effort, Maker, cells
from tools.site.markdown import table

# In the order of the paper.
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


def _rows(effort: Effort, found: list[Claim]) -> Iterator[Sequence[str]]:
    for claim in claims(effort):
        found.append(claim)
        yield cells(claim)


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tools.paper.reproduce", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("--fast", action="store_true", help="shorter runs")
    options = parser.parse_args(argv)
    found: list[Claim] = []
    for line in table(COLUMNS, _rows(FAST if options.fast else FULL, found)):
        print(line, flush=True)
    failed = [claim.key for claim in found if not claim.holds]
    print(f"\n{len(found)} claims, {len(failed)} do not hold{': ' if failed else ''}{', '.join(failed)}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
