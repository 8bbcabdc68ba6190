"""The targets of tools/fuzz: a short campaign of each, and each bound does find what breaks it."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from random import Random

import pytest

from canfb.errors import CanfbError
from tools.fuzz.__main__ import main
from tools.fuzz.bounds import BeyondBoundsError, ReachedLines, bounded
from tools.fuzz.loop import Find, campaign, play_one
from tools.fuzz.mutate import Mutator
from tools.fuzz.targets import TARGETS, Target

INPUTS = 25
"""Some seconds for all; a campaign has thousands of each."""
PLAYED_ELSEWHERE = {"frames"}  # test_fuzz.py

pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")  # of numpy, from files with NaN


@pytest.mark.parametrize("name", sorted(set(TARGETS) - PLAYED_ELSEWHERE))
def test_a_short_campaign_finds_nothing(name: str) -> None:
    done = campaign(TARGETS[name], INPUTS, seed=28)
    assert [find.text for find in done.finds.values()] == []
    assert done.inputs >= INPUTS
    assert done.accepted > 0
    assert done.lines > 10


def played(tmp_path: Path, play: Callable[[Path, bytes], None], data: bytes = b"") -> bool | Find:
    return play_one(Target("own", list, play), tmp_path / "input", data)


def refuse(text: str) -> Callable[[Path, bytes], None]:
    def play(path: Path, data: bytes) -> None:
        raise CanfbError(text)

    return play


def test_what_is_refused_in_one_line_is_no_find(tmp_path: Path) -> None:
    assert played(tmp_path, refuse("a.yaml:1: this is not YAML")) is False


@pytest.mark.parametrize("text", ["two\nlines", "", "x" * 2000, "MemoryError: 9 GB"])
def test_a_refusal_that_is_no_line_is_found(tmp_path: Path, text: str) -> None:
    found = played(tmp_path, refuse(text))
    assert isinstance(found, Find)
    assert "NotOneLineError" in found.text


def test_any_other_exception_is_found(tmp_path: Path) -> None:
    found = played(tmp_path, lambda path, data: {b"other": None}[data], b"key")
    assert isinstance(found, Find)
    assert isinstance(found.error, KeyError)
    assert found.data == b"key"


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


def branches(data: bytes) -> int:
    if data == b"a":
        return 1
    return 2


def test_lines_are_counted_once() -> None:
    reached = ReachedLines((str(Path(__file__)),))
    counts = []
    for data in (b"b", b"b", b"a", b"a"):
        with reached.watching():
            branches(data)
        counts.append(reached.count)
    assert counts == [2, 2, 3, 3]


def test_the_same_seed_makes_the_same_inputs() -> None:
    seeds = [b"a: 1\nb: [2, 3]\n", b"\x00\x01\x02\x03"]
    made = []
    for seed in (1, 1, 2):
        mutator = Mutator(Random(seed), seeds, 100)
        made.append([mutator.mutated(seeds[n % 2], seeds[0]) for n in range(300)])
    assert made[0] == made[1] != made[2]
    assert max(map(len, made[0])) == 100
    assert len(set(made[0])) > 200


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = ["--out", str(tmp_path)]
    assert main(["--target", "concise", "--inputs", "30", "--seed", "3", *out]) == 0
    assert capsys.readouterr().out.startswith("concise: 31 inputs, ")
    (tmp_path / "input").write_bytes(b"\0\0\0\0")
    assert main(["--target", "concise", "--play", str(tmp_path / "input")]) == 0
    assert capsys.readouterr().out.endswith("input: accepted\n")
