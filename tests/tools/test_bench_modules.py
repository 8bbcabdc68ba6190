"""tools/bench/modules.py on very little work."""

from __future__ import annotations

import re

import pytest

from tools.bench import modules


def test_one_line_for_each_number_of_modules(capsys: pytest.CaptureFixture[str]) -> None:
    assert modules.main(["--modules", "1,3", "--cycles", "5", "--repeat", "1"]) == 0
    head, *lines = capsys.readouterr().out.splitlines()
    assert head.split() == ["modules", "us", "per", "frame", "ratio", "processor", "at", "1", "kHz"]
    assert [int(line.split()[0]) for line in lines] == [1, 3]
    assert all(re.fullmatch(r" *\d+ +\d+\.\d +\d+\.\d\d +\d+%", line) for line in lines)


@pytest.mark.parametrize("text", ["0", "64"])
def test_more_nodes_than_there_are(text: str) -> None:
    with pytest.raises(SystemExit):
        modules.main(["--modules", text])
