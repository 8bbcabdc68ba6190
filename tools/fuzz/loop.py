"""The loop: change an input, play it, keep it where it reached new lines, note what must not be.

The same seed gives the same inputs as long as code, Python and libraries are the same.
"""

from __future__ import annotations

import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from random import Random

import can
import canopen

import canfb
from canfb.errors import CanfbError
from tools.fuzz.bounds import BeyondBoundsError, ReachedLines, bounded
from tools.fuzz.mutate import Mutator
from tools.fuzz.targets import Target

LONGEST_MESSAGE = 1000
TRACED_FIRST, TRACED_SHARE = 1000, 0.1
"""Inputs that are traced at first, and the share of those after them: an input takes ten times as long so."""
SEAL_SHARE = 0.8
"""Of the inputs with checksums: those that are made right."""
TRACED = tuple(str(Path(module.__file__).parent) for module in (canfb, can, canopen) if module.__file__)


class NotOneLineError(Exception):
    """A refusal that the command line could not print as one line."""


@dataclass(frozen=True)
class Find:
    """An input that did what none may do."""

    data: bytes
    error: BaseException

    @property
    def place(self) -> str:
        """What it is known by: the error, and the last line of canfb that it went through."""
        frames = traceback.extract_tb(self.error.__traceback__)
        ours = [one for one in frames if "/canfb/" in one.filename] or list(frames)
        where = f"{ours[-1].filename.rpartition('/canfb/')[2]}:{ours[-1].lineno}" if ours else "?"
        return f"{type(self.error).__name__} at {where}"

    @property
    def text(self) -> str:
        """In one line."""
        return f"{self.place}: {' '.join(str(self.error).split())[:200]}"


@dataclass
class Campaign:
    """What has come out."""

    target: Target
    inputs: int = 0
    accepted: int = 0
    lines: int = 0
    slowest_s: float = 0.0
    corpus: list[bytes] = field(default_factory=list)
    finds: dict[str, Find] = field(default_factory=dict)
    times: Counter[str] = field(default_factory=Counter)

    def summary(self) -> str:
        """A line."""
        return (
            f"{self.target.name}: {self.inputs} inputs, {self.accepted} accepted, "
            f"{self.inputs - self.accepted - self.times.total()} refused, {self.times.total()} finds of "
            f"{len(self.finds)} kinds; corpus {len(self.corpus)}, {self.lines} lines, "
            f"slowest {1e3 * self.slowest_s:.0f} ms"
        )


def campaign(
    target: Target,
    inputs: int,
    seed: int = 1,
    seconds: float = float("inf"),
    kept: tuple[bytes, ...] = (),
    found: Callable[[Find], None] = lambda find: None,
) -> Campaign:
    """Play the seeds, ``kept`` and ``inputs`` changes of them, or as many as there is time for.

    ``found`` is called with the first find of each kind.
    """
    done, random, reached = Campaign(target), Random(seed), ReachedLines(TRACED)
    end = time.process_time() + seconds
    corpus = [*target.seeds(), *kept]
    mutator = Mutator(random, corpus, target.longest)
    with tempfile.TemporaryDirectory() as name:
        path = Path(name, f"input{target.suffix}")
        play_one(target, path, corpus[0])  # what is loaded with the first input is none of its doing
        for data in corpus:
            _note(done, reached, path, data, found, traced=True)
        done.corpus = list(corpus)
        while done.inputs < inputs + len(corpus) and time.process_time() < end:
            data = mutator.mutated(*(random.choice(done.corpus) for _ in range(2)))
            if target.sealed is not None and random.random() < SEAL_SHARE:
                data = target.sealed(data)
            traced = done.inputs < TRACED_FIRST or random.random() < TRACED_SHARE
            _note(done, reached, path, data, found, traced=traced)
    return done


def _note(
    done: Campaign,
    reached: ReachedLines,
    path: Path,
    data: bytes,
    found: Callable[[Find], None],
    *,
    traced: bool,
) -> None:
    before, begin = reached.count, time.process_time()
    with reached.watching() if traced else nullcontext():
        result = play_one(done.target, path, data)
    done.inputs += 1
    done.slowest_s = max(done.slowest_s, time.process_time() - begin)
    done.lines = reached.count
    if isinstance(result, Find):
        done.times[result.place] += 1
        if result.place not in done.finds:
            done.finds[result.place] = result
            found(result)
    else:
        done.accepted += result
        if reached.count > before:
            done.corpus.append(data)


def play_one(target: Target, path: Path, data: bytes) -> bool | Find:
    """Whether the input is accepted, or what is wrong."""
    path.write_bytes(data)
    try:
        with bounded(path.parent):
            target.play(path, data)
    except target.refusals as error:
        return _find_of_refusal(data, error)
    except (Exception, BeyondBoundsError) as error:
        return Find(data, error)
    return True


def _find_of_refusal(data: bytes, error: Exception) -> bool | Find:
    """False: it is as it should be."""
    text = str(error)
    is_line = bool(text) and len(text) <= LONGEST_MESSAGE and len(text.splitlines()) == 1
    if "MemoryError" not in text and (is_line or not isinstance(error, CanfbError)):
        return False
    told = NotOneLineError(f"{len(text)} characters: {text}")
    return Find(data, told.with_traceback(error.__traceback__))
