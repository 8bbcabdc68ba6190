"""The target `files` of tools/fuzz: a few inputs of each reader, and each bound does find what breaks it."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from random import Random

import pytest

from canfb.errors import CanfbError
from tools.fuzz import files
from tools.fuzz.bounds import BeyondBoundsError, bounded
from tools.fuzz.files import READERS, NotOneLineError, Reader

INPUTS = 25
"""Some seconds for all; atheris plays thousands of each."""

pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")  # of numpy, from files with NaN


def changed(random: Random, data: bytes, other: bytes) -> bytes:
    """Bytes that are dropped, doubled or set, and a part of another input."""
    for _ in range(random.randint(1, 4)):
        begin, place = (random.randint(0, len(data)) for _ in range(2))
        end = begin + random.randint(0, 16)
        start = random.randint(0, len(other))
        part = random.choice((b"", data[begin:end] * 2, random.randbytes(4), other[start : start + 60]))
        data = data[:place] + part + data[end:] if place < begin else data[:begin] + part + data[end:]
    return data


@pytest.mark.parametrize("number", range(len(READERS)))
def test_inputs_that_were_changed_find_nothing(number: int, tmp_path: Path) -> None:
    random, kind = Random(28), bytes([number])
    seeds = READERS[number].begin()
    assert sum(files.play(kind + seed, tmp_path) for seed in seeds) > 0
    for _ in range(INPUTS):
        data = changed(random, *(random.choice(seeds) for _ in range(2)))
        files.play(kind + data, tmp_path)


def refuse(text: str) -> Callable[[Path], None]:
    def read(path: Path) -> None:
        raise CanfbError(text)

    return read


def fail(path: Path) -> None:
    raise KeyError("other")


@pytest.mark.parametrize(
    ("read", "found"),
    [
        (refuse("a.yaml:1: this is not YAML"), None),
        (refuse("two\nlines"), NotOneLineError),
        (refuse(""), NotOneLineError),
        (refuse("x" * 2000), NotOneLineError),
        (refuse("MemoryError: 9 GB"), NotOneLineError),
        (fail, KeyError),
    ],
)
def test_what_is_found(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    read: Callable[[Path], None],
    found: type[Exception] | None,
) -> None:
    monkeypatch.setattr(files, "READERS", (Reader("", read, list),))
    if found is None:
        assert files.play(b"\0", tmp_path) is False
    else:
        with pytest.raises(found):
            files.play(b"\0", tmp_path)


def test_an_input_that_takes_too_long_is_found(tmp_path: Path) -> None:
    with pytest.raises(BeyondBoundsError, match="too long"), bounded(tmp_path, seconds=0.05):
        hang()


def hang() -> None:
    while True:
        try:
            sum(range(1000))
        except Exception:
            continue


def test_an_input_that_takes_much_memory_is_found(tmp_path: Path) -> None:
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10
    with pytest.raises(BeyondBoundsError, match="memory"), bounded(tmp_path, memory=16 << 20):
        assert len(bytearray(b"x" * (peak + (32 << 20)))) > peak


@pytest.mark.parametrize(
    "act",
    [
        lambda path: (path / "out").write_bytes(b""),
        lambda path: os.mkdir(path / "folder"),
        lambda path: os.replace(path / "in" / "input", path / "moved"),
        lambda path: os.system("true"),
    ],
    ids=["file", "folder", "move", "program"],
)
def test_an_input_that_writes_elsewhere_is_found(tmp_path: Path, act: Callable[[Path], object]) -> None:
    inside = tmp_path / "in"
    inside.mkdir()
    (inside / "input").write_bytes(b"")
    with pytest.raises(BeyondBoundsError), bounded(inside):
        act(tmp_path)
    with bounded(inside):
        (inside / "own").write_bytes(b"")
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["in", "input", "own"]
