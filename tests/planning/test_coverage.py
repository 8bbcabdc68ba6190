"""Diagnostic coverage against docs/evidence.md, and the commands of docs/plan.md with their output."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from planning_kit import planned

from canfb.cia301.frame import frame_bits
from canfb.planning.coverage import (
    KINDS,
    FaultCoverage,
    SampleWindow,
    area_coverage,
    fault_coverage,
    second_tolerance,
    window_of,
)
from canfb.planning.plan_rows import coverage_rows
from canfb.rows import as_figures
from commands import Command
from documentation import blocks, page

DEFAULT = SampleWindow(
    full_scale_counts=2048,
    low_counts=410,
    high_counts=2560,
    nominal_counts=1500.0,
    limit_cycles=1.0 / 3.0,
    motion_cycles=0.01,
    tolerance_cycles=25.0,
)
COMMISSIONED = replace(DEFAULT, low_counts=1200, high_counts=1800, limit_cycles=0.06)
PAGE = page("evidence")


@cache
def found(window: SampleWindow) -> dict[str, FaultCoverage]:
    return {one.name: one for one in fault_coverage(window)}


@pytest.mark.parametrize("window", [DEFAULT, COMMISSIONED, replace(DEFAULT, low_counts=0, high_counts=4000)])
def test_the_area_is_that_of_any_voltages(window: SampleWindow) -> None:
    n = 1000
    axis = (np.arange(n) + 0.5) / n * 2.0 * window.full_scale_counts - window.full_scale_counts
    length = np.hypot(axis[:, None], axis[None, :])
    allowed = ((length >= window.low_counts) & (length <= window.high_counts)).mean()
    shares = area_coverage(window)
    assert shares.amplitude == pytest.approx(1.0 - allowed, abs=1e-3)
    assert shares.residual == pytest.approx(1.0 - allowed * 2.0 * window.limit_cycles, abs=1e-3)
    assert shares.second_position == shares.residual, "a second position of 25 cycles sees nothing of a phase"


def test_the_window_of_a_plan() -> None:
    plan = planned(acceleration_rad_s2=25.0, residual_limit=0.06)
    (budget,) = plan.budgets
    window = window_of(budget)
    assert (window.low_counts, window.high_counts) == (410, 2560)
    assert window.limit_cycles == pytest.approx(0.06, abs=2e-5)
    assert window.motion_cycles == pytest.approx(25.0 * 2500 / (2 * math.pi) * 1e-6)
    assert window.tolerance_cycles == 25.0
    assert second_tolerance(budget) is None
    figures = as_figures(coverage_rows(budget))["coverage"]
    assert figures["second_position_mapped"] is False
    assert list(figures["faults"]) == list(KINDS)


def test_a_second_position_that_is_mapped(tmp_path: Path, command: Command) -> None:
    config = tmp_path / "second.yaml"
    config.write_text(
        "bus: {interface: virtual, channel: test}\n"
        "modules:\n  - node_id: 0x20\n    cycles_per_revolution: 1000\n"
        "    second_position: {cob_id: 0x381, increments: 4096, tolerance_revolutions: 0.05}\n"
    )
    (module,) = command("plan --json", config).json["modules"]
    assert module["coverage"]["second_position_mapped"] is True
    assert module["coverage"]["second_position_cycles"] == pytest.approx(50.0)


def test_the_table_is_printed_on_request(command: Command) -> None:
    lines = command("plan --coverage --acceleration 25").lines
    (area,) = (line for line in lines if "1 - allowed area / whole area" in line)
    assert "no certificate" in "".join(lines)
    begin = next(n for n, line in enumerate(lines) if line.split()[:2] == ["fault", "amplitude"])
    assert [line[4:30].strip() for line in lines[begin + 1 : begin + 1 + len(KINDS)]] == list(KINDS)
    table = lines[begin - 2 : begin + 1 + len(KINDS)]
    assert [line for line in lines if line not in table] == command("plan --acceleration 25").lines
    assert "by the amplitude" in area


def row(name: str) -> list[str]:
    """The computed cells of the table of the page, beside what was measured."""
    cells = []
    for window in (DEFAULT, COMMISSIONED):
        one = found(window)[name]
        second = one.shares.second_position
        shares = (one.shares.amplitude, one.shares.residual, second)
        cells.append(" / ".join(f"{math.floor(100.0 * share + 1e-9)}" for share in shares))
        cells.append("-" if one.within is None else f"{one.within}")
    return cells


def test_the_page_has_these_figures() -> None:
    rows = {}
    for line in re.findall(r"^\| (.*) \|$", PAGE, re.M):
        name, *cells = (cell.strip() for cell in line.split("|"))
        if name in KINDS and len(cells) == 6:
            rows[name] = [cells[0], cells[1], cells[3], cells[4]]
    assert rows == {name: row(name) for name in KINDS}, "\n".join(f"{n}: {row(n)}" for n in KINDS)


PLAN_PAGE = page("plan")
PLAN_PAGE = PLAN_PAGE.partition("\n## The SYNC rate")[0]
BLOCKS = [block.splitlines() for block in blocks(PLAN_PAGE, "sh")]


def test_the_commands_have_the_output_of_the_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: Command
) -> None:
    """With and without sample times, with a configuration, and with several samples for each SYNC."""
    monkeypatch.chdir(tmp_path)
    (first,), (times,), (example, *plans), *several = BLOCKS
    shown, *parts = blocks(PLAN_PAGE, "text")
    assert command(first.removeprefix("canfb"), code=1).out == shown
    assert "the plan holds" in command(times.removeprefix("canfb")).out
    for (line,), part, code in zip(several, parts, (1, 0), strict=True):
        assert part in command(line.removeprefix("canfb"), code=code).out
    assert example == "canfb config example > feedback.yaml"
    Path("feedback.yaml").write_text(command("config example").out)
    for line in plans:
        command(line.removeprefix("canfb"))


def test_the_length_of_a_frame() -> None:
    (formula,) = re.findall(r"\| (47 \+ .*?) bits", PLAN_PAGE)
    for n in range(9):
        assert frame_bits(n) == 47 + 8 * n + (34 + 8 * n - 1) // 4
    assert formula == "47 + 8 n + floor((34 + 8 n - 1) / 4)"
