"""Try every claim of the paper, and print a table: what the paper says, what comes out here.

    python -m tools.paper.reproduce [--fast] [--markdown FILE]

The paper is Hoescheler and Szamel, Up-to-date Technique for Easy High-Accuracy Position
Acquisition with Sinusoidal Incremental Encoders, 1997. --fast takes shorter runs. Exit status
1 when a claim does not hold, 2 when a file cannot be written.
docs/paper.md says more.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from tools.paper import conventional, detection, phase, tracking
from tools.paper.claim import FAST, FULL, Claim, Effort, Maker, markdown, plain

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
    """Try them all, one after the other."""
    for maker in MAKERS:
        yield from maker(effort)


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tools.paper.reproduce", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("--fast", action="store_true", help="shorter runs")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write the table as Markdown")
    options = parser.parse_args(argv)
    found = []
    for claim in claims(FAST if options.fast else FULL):
        print(plain([claim]), flush=True)
        found.append(claim)
    try:
        if options.markdown is not None:
            options.markdown.write_text(markdown(found), encoding="utf-8")
    except OSError as error:
        print(f"cannot write {error.filename}: {error.strerror}", file=sys.stderr)
        return 2
    failed = [claim.key for claim in found if not claim.holds]
    print(f"{len(found)} claims, {len(failed)} do not hold{': ' if failed else ''}{', '.join(failed)}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
