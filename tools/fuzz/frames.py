"""Fuzz the frames without tracing what they reach: some ten times as many frames as a guided run plays.

    python -m tools.fuzz.frames --frames 1e6 --seed 1
    python -m tools.fuzz.frames --frames 1e8 --seed 1 --corpus build/fuzz

An input is made of kept ones, those of tests/tools/fuzz_corpus.txt and of the folders that guided runs of
tools.fuzz.sdo have filled, one after the other, and changed as in the loop of tools.fuzz. Most are long,
so that little time goes into the power-on of a device: states that a guided run reaches by themselves meet
here in one device. The checks are those of body.py. Exit code 1 if something was found: each find is
kept in --out, for `python -m tools.fuzz.sdo --show`.
"""

from __future__ import annotations

import argparse
import hashlib
import logging
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from random import Random

from tools.fuzz import body
from tools.fuzz.bounds import BeyondBoundsError, bounded
from tools.fuzz.loop import Find
from tools.fuzz.mutate import Mutator
from tools.fuzz.targets import kept_frames

LONGEST = 1600
LENGTHS = (60, 200, 400, 1200, 1200, 1200, 1200, 1500)
"""Bytes that an input is filled up to: short ones, too, whose end comes soon after each of their steps."""
LOOK_S = 60.0


@dataclass
class Count:
    """What has been played."""

    inputs: int = 0
    frames: int = 0
    processor_s: float = 0.0
    slowest_s: float = 0.0
    finds: dict[str, Find] = field(default_factory=dict)

    def summary(self) -> str:
        """A line."""
        rate = self.frames / self.processor_s if self.processor_s else 0.0
        return (
            f"{self.frames} frames of {self.inputs} inputs, {rate:.0f} frames/s, {len(self.finds)} kinds of "
            f"finds, slowest {1e3 * self.slowest_s:.0f} ms"
        )


def spliced(random: Random, corpus: Sequence[bytes]) -> Iterator[bytes]:
    """Inputs without end."""
    mutator = Mutator(random, corpus, LONGEST)
    while True:
        data, length = random.choice(corpus), random.choice(LENGTHS)
        while len(data) < length:
            data += random.choice(corpus)[1:] or b"\x00"
        yield mutator.mutated(data, random.choice(corpus))


def campaign(
    corpus: Sequence[bytes],
    frames: float,
    seed: int,
    found: Callable[[Find], None] = lambda find: None,
    look: Callable[[Count], None] = lambda count: None,
) -> Count:
    """Play inputs until so many frames have been received; ``look`` is called about once a minute."""
    count, looked_s = Count(), time.monotonic()
    body.play(corpus[0])  # what is loaded with the first input is none of its doing
    with tempfile.TemporaryDirectory() as folder:
        for data in spliced(Random(seed), corpus):
            began_s = time.process_time()
            try:
                with bounded(Path(folder)):
                    count.frames += body.play(data)
            except (Exception, BeyondBoundsError) as error:
                find = Find(data, error)
                if find.place not in count.finds:
                    count.finds[find.place] = find
                    found(find)
            took_s = time.process_time() - began_s
            count.inputs += 1
            count.processor_s += took_s
            count.slowest_s = max(count.slowest_s, took_s)
            if time.monotonic() - looked_s > LOOK_S:
                looked_s = time.monotonic()
                look(count)
            if count.frames >= frames:
                break
    return count


def main(arguments: Sequence[str]) -> int:
    """The command; its exit code."""
    parser = argparse.ArgumentParser(
        "python -m tools.fuzz.frames", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("--frames", type=float, default=1e6, metavar="N", help="(1e6)")
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="of what is random (1)")
    parser.add_argument("--corpus", type=Path, action="append", default=[], metavar="DIR", help="more inputs")
    parser.add_argument("--out", type=Path, default=Path("build"), metavar="DIR", help="for finds (build)")
    parser.add_argument("--count", type=Path, metavar="FILE", help="for the figures, each minute")
    options = parser.parse_args(arguments)
    corpus = kept_frames()
    for folder in options.corpus:
        corpus += [path.read_bytes() for path in sorted(folder.iterdir()) if path.is_file()]

    def keep(find: Find) -> None:
        options.out.mkdir(parents=True, exist_ok=True)
        path = options.out / f"crash-{hashlib.sha256(find.data).hexdigest()[:10]}"
        path.write_bytes(find.data)
        print(f"{path}: {find.text}", flush=True)

    def note(count: Count) -> None:
        if options.count is not None:
            options.count.write_text(f"{count.summary()}\n", encoding="utf-8")

    count = campaign(corpus, options.frames, options.seed, keep, note)
    note(count)
    print(count.summary())
    return 1 if count.finds else 0


if __name__ == "__main__":
    logging.disable(logging.CRITICAL)
    sys.exit(main(sys.argv[1:]))
