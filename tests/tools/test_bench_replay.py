"""tools/bench/replay.py on very little work."""

from __future__ import annotations

import json

import pytest

from tools.bench import replay


def test_a_ratio_for_each_log(capsys: pytest.CaptureFixture[str]) -> None:
    assert replay.main(["--cycles", "20", "--repeat", "1", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert len(found) == len(replay.KINDS) * len(replay.SUFFIXES)
    assert all(one["ratio"] > 0.0 and one["frames"] >= 40 for one in found.values())
    assert replay.main(["--cycles", "20", "--repeat", "1"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == len(found) + 1
