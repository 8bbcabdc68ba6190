"""tools/bench/cycle.py: each piece of work does what it is compared for; pyperf measures it."""

from __future__ import annotations

import pytest

from tools.bench import cycle

COMPARISON = cycle.Comparison("name", "ours", "other", 1.0)


@pytest.fixture
def runner(monkeypatch: pytest.MonkeyPatch) -> None:
    """pyperf has one in each process."""
    monkeypatch.setattr(cycle.pyperf.Runner, "_created", set())


@pytest.mark.parametrize("name", cycle.WORK)
def test_each_piece_of_work_checks_itself(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cycle, "SAMPLES", 1000)
    work = cycle.WORK[name].make()
    for _ in range(2):
        work()


def test_goals_are_those_of_the_page() -> None:
    floats, counts, stream = cycle.array_goals()
    assert {one.name: one.goal for one in cycle.comparisons()} == {
        "cycle": 0.6, "cycle, cosine delay": 1.1, "cycle, delay": 1.1,
        "cycle, adapt": 1.1, "cycle after 1 ms of sleep": 0.8, "cycle, sample times": 1.1,
        "samples, float64": floats, "samples, int16": counts, "samples, supervised": stream,
    }  # fmt: skip
    assert {name for one in cycle.comparisons() for name in (one.ours, one.other)} == set(cycle.WORK)


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


def test_the_command_prints_a_row_for_what_is_named(runner: None, capsys: pytest.CaptureFixture[str]) -> None:
    assert cycle.main(["--only", "cycle, adapt", "--debug-single-value"]) == 0
    said = capsys.readouterr().out
    rows = [line for line in said.splitlines() if line.startswith("|")]
    assert [row.split(" | ")[0] for row in rows[2:]] == ["| cycle, adapt"]
    assert "2002:08" in said


def test_wrong_use_is_refused(runner: None, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as error:
        cycle.main(["--only", "nothing"])
    assert error.value.code == 2
    assert "error:" in capsys.readouterr().err


@pytest.mark.parametrize(("ours", "status", "verdict"), [(0.99, 0, "met"), (1.0, 1, "MISSED")])
def test_check_reports_a_missed_goal_by_the_exit_status(
    ours: float, status: int, verdict: str, capsys: pytest.CaptureFixture[str]
) -> None:
    medians = {"ours": ours, "other": 1.0}
    assert cycle.report([COMPARISON], medians, check=True) == status
    assert cycle.report([COMPARISON], medians, check=False) == 0
    assert f"< 1: {verdict}" in capsys.readouterr().out
