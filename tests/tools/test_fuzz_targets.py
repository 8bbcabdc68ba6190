"""The targets of tools/fuzz: a few inputs of each, and each bound does find what breaks it."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from random import Random

import pytest

from canfb.errors import CanfbError
from tools.fuzz.__main__ import main
from tools.fuzz.bounds import BeyondBoundsError, bounded
from tools.fuzz.targets import TARGETS, NotOneLineError, Target

INPUTS = 25
"""Some seconds for all; atheris plays thousands of each."""
PLAYED_ELSEWHERE = {"frames"}  # test_fuzz.py

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


@pytest.mark.parametrize("name", sorted(set(TARGETS) - PLAYED_ELSEWHERE))
def test_inputs_that_were_changed_find_nothing(name: str, tmp_path: Path) -> None:
    target, random = TARGETS[name], Random(28)
    path, seeds = tmp_path / f"input{target.suffix}", target.seeds()
    assert sum(target.accepts(path, seed) for seed in seeds) > 0
    for _ in range(INPUTS):
        data = changed(random, *(random.choice(seeds) for _ in range(2)))[: target.longest]
        target.accepts(path, data if target.sealed is None else target.sealed(data))


def played(tmp_path: Path, play: Callable[[Path, bytes], None], data: bytes = b"") -> bool:
    return Target("own", list, play).accepts(tmp_path / "input", data)


def refuse(text: str) -> Callable[[Path, bytes], None]:
    def play(path: Path, data: bytes) -> None:
        raise CanfbError(text)

    return play


def test_what_is_refused_in_one_line_is_no_find(tmp_path: Path) -> None:
    assert played(tmp_path, refuse("a.yaml:1: this is not YAML")) is False


@pytest.mark.parametrize("text", ["two\nlines", "", "x" * 2000, "MemoryError: 9 GB"])
def test_a_refusal_that_is_no_line_is_found(tmp_path: Path, text: str) -> None:
    with pytest.raises(NotOneLineError):
        played(tmp_path, refuse(text))


def test_any_other_exception_is_found(tmp_path: Path) -> None:
    with pytest.raises(KeyError):
        played(tmp_path, lambda path, data: {b"other": None}[data], b"key")


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


def test_an_input_is_played_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "input").write_bytes(b"\0\0\0\0")
    assert main(["concise", "--play", str(tmp_path / "input")]) == 0
    assert capsys.readouterr().out.endswith("input: accepted\n")


def test_a_find_is_played_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "input").write_bytes(b"")
    monkeypatch.setitem(TARGETS, "own", Target("own", list, refuse("two\nlines")))
    assert main(["own", "--play", str(tmp_path / "input")]) == 1
    assert "NotOneLineError: 9 characters" in capsys.readouterr().err
