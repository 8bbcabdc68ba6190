"""The table of residuals: short runs of it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "tools.bench.calibration", *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False)


def test_every_row_keeps_what_the_table_promises() -> None:
    done = run("--encoder", "mediocre", "--seconds", "4", "--conditioning", "fit")
    assert (done.returncode, done.stderr) == (0, "")
    header, rule, *rows = done.stdout.splitlines()
    assert header.startswith("| encoder | method | speed, rpm | before, peak %")
    assert rule.count("---") == header.count("|") - 1
    cells = [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]
    assert [row[2] for row in cells] == ["9..20", "6", "60", "600", "2000", "3000"]
    for _, _, _, before, peak, rms, promised, sample in cells:
        assert float(before) > 1.5
        assert 1e-5 < float(rms) < float(peak) <= float(promised) < 0.03
        assert 0.003 < float(sample) < 0.03


def test_wrong_use() -> None:
    assert run("--seeds", "0").returncode == 2
