"""tools/bench/bus.py on very little work: each kind of node answers, on a pair of sockets."""

from __future__ import annotations

import re

import pytest

from tools.bench import bus


def test_one_line_for_each_kind(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bus, "WARM_UP", 5)
    monkeypatch.setattr(bus, "MOST_MISSED", 1.0)  # a machine with other work
    assert bus.main(["--cycles", "10", "--repeat", "1", "--rate", "100"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [re.split(r" *\| *", line)[1] for line in lines[2:]] == list(bus.KINDS)
    assert all(re.fullmatch(r"\| [a-z:-]+( \| \d+ \| (\d+\.\d\d|nan)){3} \|", line) for line in lines[2:])
    assert lines[2].endswith(" | 1.00 |")


def test_kinds_that_there_are_not() -> None:
    with pytest.raises(SystemExit):
        bus.main(["--kinds", "stock,other"])
