"""tools/bench/cycle.py on very little work: what it measures is checked by itself, what it prints here."""

from __future__ import annotations

import json

import pytest

from tools.bench import cycle

LITTLE = ["--repeat", "2", "--cycles", "100", "--samples", "1000"]


def spread(median: float) -> cycle.Spread:
    return cycle.Spread(median, median, median)


def result(ratio: float, goal: float | None) -> cycle.Result:
    return cycle.Result("name", "ours", "other", "us", spread(1.0), spread(1.0), spread(ratio), goal)


def test_json_has_machine_and_every_comparison(capsys: pytest.CaptureFixture[str]) -> None:
    assert cycle.main(["--json", *LITTLE]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert {"processor", "python", "numpy", "canopen"} <= set(printed["machine"])
    goals = {one["name"]: one["goal"] for one in printed["results"]}
    floats, counts, stream = cycle.array_goals()
    assert goals == {
        "cycle": 0.6, "cycle, third order": 1.05, "cycle, cosine delay": 1.1, "cycle, delay": 1.1,
        "cycle, adapt": 1.1, "cycle, both and corner": None, "cycle, at standstill": None,
        "cycle, sample times": None, "cycle, can.Message": None,
        "1000 samples, float64": floats, "1000 samples, int16": counts,
        "1000 samples, supervised": stream,
        "tracker": None, "chain": None,
    }  # fmt: skip
    for one in printed["results"]:
        for key in ("ours_time", "other_time", "ratio"):
            assert 0.0 < one[key]["lower"] <= one[key]["median"] <= one[key]["upper"]


@pytest.mark.parametrize(
    ("found", "goals"),
    [
        ({"found": ["X86_V3", "X86_V4"]}, cycle.GOALS_AVX512),
        ({"found": ["AVX2", "AVX512_SKX"]}, cycle.GOALS_AVX512),
        ({"found": ["X86_V3"], "not found": ["X86_V4"]}, cycle.GOALS_OTHER),
        ({}, cycle.GOALS_OTHER),
    ],
)
def test_the_goals_of_arrays_depend_on_avx512(
    found: dict[str, list[str]], goals: tuple[float, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cycle.np, "show_config", lambda mode: {"SIMD Extensions": found})
    assert cycle.array_goals() == goals


def test_a_table_has_a_row_for_each_comparison_that_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert cycle.main(["--only", "at", *LITTLE]) == 0
    rows = [line for line in capsys.readouterr().out.splitlines() if line.startswith("|")]
    assert [row.split(" | ")[0] for row in rows[2:]] == ["| cycle, at standstill", "| 1000 samples, float64"]
    assert {row.count("|") for row in rows} == {7}


@pytest.mark.parametrize("wrong", [["--repeat", "1"], ["--cycles", "99"], ["--only", "nothing"]])
def test_wrong_use_is_told(wrong: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as error:
        cycle.main([*LITTLE, *wrong])
    assert error.value.code == 2
    assert "error:" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("ratio", "goal", "missed"), [(0.99, 1.0, False), (1.0, 1.0, True), (9.0, None, False)]
)
def test_a_goal_is_missed_from_its_value_on(ratio: float, goal: float | None, missed: bool) -> None:
    assert result(ratio, goal).is_missed == missed


def test_check_tells_by_the_exit_status(monkeypatch: pytest.MonkeyPatch) -> None:
    for ratio, status in ((0.5, 0), (1.5, 1)):
        monkeypatch.setattr(cycle.Comparison, "run", lambda self, repeat, ratio=ratio: result(ratio, 1.0))
        assert cycle.main(["--check", "--only", "tracker", *LITTLE]) == status


def test_median_and_quartiles() -> None:
    assert cycle.Spread.of([4.0, 1.0, 2.0, 3.0, 5.0]) == cycle.Spread(3.0, 2.0, 4.0)
