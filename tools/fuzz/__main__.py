"""Fuzz what reads something from outside, guided by the lines of canfb that an input reaches.

    python -m tools.fuzz --target eds --inputs 100000 --seed 1
    python -m tools.fuzz --seconds 60                              all targets, so long each
    python -m tools.fuzz --target eds --play build/fuzz-eds-...    an input again, with its traceback

Exit code 1 if something was found: each find is kept in --out and told in a line. `python -m tools.fuzz.sdo`
fuzzes the frames with atheris.
"""

from __future__ import annotations

import argparse
import hashlib
import logging
import sys
import tempfile
import traceback
from functools import partial
from pathlib import Path

from tools.fuzz.loop import Find, campaign, play_one
from tools.fuzz.targets import TARGETS, Target


def main(arguments: list[str]) -> int:
    """The command; its exit code."""
    assert __doc__ is not None
    parser = argparse.ArgumentParser("python -m tools.fuzz", description=__doc__.partition("\n")[0])
    parser.add_argument("--target", action="append", choices=TARGETS, help="may be given several times (all)")
    parser.add_argument("--inputs", type=int, default=10_000, metavar="N", help="for each target (10000)")
    parser.add_argument("--seconds", type=float, default=float("inf"), metavar="S", help="of the processor")
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="of what is random (1)")
    parser.add_argument("--out", type=Path, default=Path("build"), metavar="DIR", help="for finds (build)")
    parser.add_argument("--play", type=Path, nargs="+", default=[], metavar="FILE", help="only these inputs")
    options = parser.parse_args(arguments)
    targets = [TARGETS[name] for name in options.target or TARGETS]
    if options.play:
        return max(_again(target, path) for target in targets for path in options.play)
    finds = 0
    for target in targets:
        done = campaign(
            target,
            options.inputs,
            options.seed,
            options.seconds,
            found=partial(_keep, target, options.out),
        )
        print(done.summary(), flush=True)
        finds += len(done.finds)
    return 1 if finds else 0


def _keep(target: Target, out: Path, find: Find) -> None:
    out.mkdir(parents=True, exist_ok=True)
    path = out / f"fuzz-{target.name}-{hashlib.sha256(find.data).hexdigest()[:10]}"
    path.write_bytes(find.data)
    print(f"{path}: {find.text}", flush=True)


def _again(target: Target, path: Path) -> int:
    with tempfile.TemporaryDirectory() as folder:
        found = play_one(target, Path(folder, f"input{target.suffix}"), path.read_bytes())
    if not isinstance(found, Find):
        print(f"{path}: {'accepted' if found else 'refused'}")
        return 0
    print(f"{path}: {found.text}")
    traceback.print_exception(found.error)
    return 1


if __name__ == "__main__":
    logging.disable(logging.CRITICAL)
    sys.exit(main(sys.argv[1:]))
