"""tools/bench/startup.py: ratios within a round, and the limit of `canfb --help` itself."""

from __future__ import annotations

import json

import pytest

from tools.bench import startup
from tools.bench.startup import LIMIT, LIMITED, REFERENCE, Ratios, Spent


def test_the_help_takes_no_longer_than_the_limit(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    few = {name: startup.PROGRAMS[name] for name in (REFERENCE, LIMITED)}
    monkeypatch.setattr(startup, "PROGRAMS", few)
    assert startup.main(["--rounds", "3", "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)
    assert figures[REFERENCE]["cpu_ratio"] == {"median": 1.0, "low": 1.0, "high": 1.0}
    assert 0.01 < figures[LIMITED]["cpu_ratio"]["median"] <= LIMIT


def test_a_slow_help_fails(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def started(arguments: list[str]) -> Spent:
        return Spent(1.0, 1.6 if "--help" in arguments and "run" not in arguments else 1.0)

    monkeypatch.setattr(startup, "start", started)
    assert startup.main(["--rounds", "2"]) == 1
    (line,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith(LIMITED)]
    assert line.split()[-6:] == ["1000", "1.00", "1.00..1.00", "1600", "1.60", "1.60..1.60"]


def test_ratios_are_made_within_a_round() -> None:
    """A machine that becomes twice as slow changes no ratio."""
    assert startup.ratios([0.5, 1.0, 1.0], [1.0, 2.0, 2.0]) == Ratios(0.5, 0.5, 0.5)
    assert startup.ratios([1.0, 2.0, 3.0], [1.0, 1.0, 1.0]) == Ratios(2.0, 1.5, 2.5)


def test_a_program_that_fails_is_no_measurement() -> None:
    with pytest.raises(RuntimeError, match="exit status 3"):
        startup.start(["-c", "raise SystemExit(3)"])
