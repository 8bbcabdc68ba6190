"""tools/bench/walk.py: calls and changes of file are counted, and the frames go where they belong."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tools.bench import walk

FRAMES = ["SYNC", "ADC PDO to position PDO", "activation of a table", "ADC PDO with sample time"]


def code(file: Path, text: str, **names: object) -> dict[str, Any]:
    """What a file with this text defines, given these names."""
    namespace = dict(names)
    exec(compile(text, str(file), "exec"), namespace)
    return namespace


def walked(folder: Path, function: Callable[[], object]) -> walk.Walk:
    seen = walk.Walk(folder)
    seen.begin()
    function()
    seen.end()
    return seen


@pytest.fixture
def two(tmp_path: Path) -> dict[str, Any]:
    return code(tmp_path / "two.py", "def inner(): pass\ndef outer():\n    inner()\n    inner()\n")


def test_calls_within_a_file_change_nothing(tmp_path: Path, two: dict[str, Any]) -> None:
    seen = walked(tmp_path, two["outer"])
    assert seen.route == [(0, "two.py", "outer"), (1, "two.py", "inner"), (1, "two.py", "inner")]
    assert (seen.calls, seen.files, seen.changes) == (3, 1, 0)


def test_a_call_and_its_return_are_two_changes(tmp_path: Path, two: dict[str, Any]) -> None:
    one = code(tmp_path / "one.py", "def start():\n    outer()\n    outer()\n", outer=two["outer"])
    seen = walked(tmp_path, one["start"])
    assert (seen.calls, seen.files, seen.changes) == (7, 2, 4)


def test_what_is_elsewhere_does_not_count(tmp_path: Path, two: dict[str, Any]) -> None:
    def elsewhere() -> None:
        two["inner"]()

    one = code(tmp_path / "one.py", "def start():\n    abs(-1)\n    elsewhere()\n", elsewhere=elsewhere)
    seen = walked(tmp_path, one["start"])
    assert [function for _, _, function in seen.route] == ["start", "inner"]
    assert seen.changes == 2


def test_an_exception_returns_as_well(tmp_path: Path) -> None:
    two = code(tmp_path / "two.py", "def outer():\n    raise ValueError\n")
    text = "def after(): pass\ndef start():\n    try: outer()\n    except ValueError: after()\n"
    one = code(tmp_path / "one.py", text, outer=two["outer"])
    seen = walked(tmp_path, one["start"])
    assert [(depth, function) for depth, _, function in seen.route] == [
        (0, "start"),
        (1, "outer"),
        (1, "after"),
    ]
    assert seen.changes == 2


def test_it_begins_in_the_file_that_runs(tmp_path: Path, two: dict[str, Any]) -> None:
    """A frame begins in the runner: to leave it is a change. What returns below the begin is no depth."""
    seen = walk.Walk(tmp_path)
    text = "def deep():\n    begin()\ndef start():\n    deep()\n    inner()\n    end()\n"
    code(tmp_path / "one.py", text, begin=seen.begin, end=seen.end, inner=two["inner"])["start"]()
    assert seen.route == [(0, "two.py", "inner")]
    assert seen.changes == 2


def test_a_neighbour_folder_is_another(tmp_path: Path) -> None:
    (tmp_path / "canfb").mkdir()
    other = code(tmp_path / "canfb_other.py", "def outer(): pass\n")
    assert walked(tmp_path / "canfb", other["outer"]).calls == 0


def test_the_usual_walk_is_the_median(tmp_path: Path, two: dict[str, Any]) -> None:
    walks = [walked(tmp_path, two[name]) for name in ("outer", "inner", "inner", "outer", "outer")]
    assert walk.usual(walks).calls == 3


@pytest.fixture(scope="module")
def frames() -> dict[str, walk.Walk]:
    return walk.all_walks()


def test_each_frame_goes_where_it_belongs(frames: dict[str, walk.Walk]) -> None:
    assert list(frames) == FRAMES
    through = {name: {(file, function) for _, file, function in one.route} for name, one in frames.items()}
    sync, sample, activation, timed = (through[name] for name in FRAMES)
    step, activate = ("signal/stages.py", "Stages.take"), ("signal/chain.py", "SignalChain.activate")
    assert step in (sample & timed) - sync - activation
    assert ("signal/sample_times.py", "SampleTimes.in_turn") in timed - sample
    assert activate in activation - sample - sync
    assert ("device/sync.py", "Sync.handle") in sync - sample
    assert all(("bus/runner.py", "Runner._take") in one for one in through.values())
    assert all(0 < one.changes <= 2 * one.calls for one in frames.values())


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch, frames: dict[str, walk.Walk]) -> None:
    """The frames are measured already."""
    monkeypatch.setattr(walk, "all_walks", lambda: frames)


@pytest.mark.usefixtures("quick")
def test_one_row_for_each_walk(capsys: pytest.CaptureFixture[str]) -> None:
    assert walk.main([]) == 0
    rows = capsys.readouterr().out.splitlines()
    assert {row.count("|") for row in rows} == {5}
    assert [row.split(" | ")[0] for row in rows[2:]] == [f"| {name}" for name in FRAMES]


@pytest.mark.usefixtures("quick")
def test_a_route_has_every_call(capsys: pytest.CaptureFixture[str]) -> None:
    assert walk.main(["--route", "ADC"]) == 0
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["signal/stages.py", "Stages.take"] in lines
    with pytest.raises(SystemExit):
        walk.main(["--route", "nothing"])
    assert "SYNC" in capsys.readouterr().err
