"""Options that would do nothing are refused, and not ignored."""

from __future__ import annotations

from pathlib import Path

import pytest

from canfb.cli.main import main

CONFIG = "bus: {interface: virtual, channel: idle}\nmodules: [{node_id: 32}]\n"
IDLE = {
    "columns": ("simulate CONFIG --columns a,b", "--columns: only with --samples"),
    "mid-scale": ("simulate CONFIG --mid-scale 5", "--mid-scale: only with --samples"),
    "time column": ("simulate CONFIG --time-column t", "--time-column: only with --samples"),
    "gap": ("simulate CONFIG --samples x.csv --gap 5", "--gap: only with --time-column"),
    "gap samples": ("simulate CONFIG --samples x.csv --gap-samples 5", "--gap-samples: only with --time-col"),
    "rpm": ("simulate CONFIG --samples x.csv --rpm 5", "--rpm: not with --samples"),
    "file, bus": ("calibrate --samples x.npz -c can0", "--channel: not with --samples"),
    "file, module": ("calibrate --samples x.npz 3", "NODE: not with --samples"),
    "file, dry": ("calibrate --samples x.npz --dry-run", "--dry-run: not with --samples"),
    "file, time": ("calibrate --samples x.npz --seconds 3", "--seconds: not with --samples"),
    "file, config": ("calibrate CONFIG --samples x.npz", "CONFIG.yaml: not with --samples"),
    "file, columns": ("calibrate --samples x.npz --columns a,b", "--columns: only for CSV"),
    "bus, columns": ("calibrate --columns a,b", "--columns: only with --samples"),
    "bus, cycles": ("calibrate --cycles-per-revolution 5", "--cycles-per-revolution: only with --samples"),
    "check, save": ("calibrate --check --save", "--save: not with --check"),
    "check, dry": ("calibrate --check --dry-run", "--dry-run: not with --check"),
    "dry, save": ("calibrate --dry-run --save", "--save: not with --dry-run"),
    "recorder": ("calibrate --recorder module", "--recorder: only with --source recording"),
    "status": ("why 5 --status 6", "NODE: not with --status"),
    "bundle": ("why 5 --out x.json", "--out: only with --bundle"),
    "frames": ("monitor --frames --updates 3", "--updates: not with --frames"),
    "pdo": ("monitor --pdo", "--pdo: only with --frames"),
    "both": ("monitor --frames --web", "--frames, --web: one of them"),
    "story": ("try --story --rate 200", "--rate: not with --story"),
    "no story": ("try --out x", "--out: only with --story"),
    "dcf": ("config dcf CONFIG --timeout 9", "--timeout: only with NODE"),
}


@pytest.mark.parametrize("case", IDLE)
def test_an_option_that_would_do_nothing(
    case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command, words = IDLE[case]
    path = tmp_path / "feedback.yaml"
    path.write_text(CONFIG)
    assert main([str(path) if word == "CONFIG" else word for word in command.split()]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    (line,) = said.err.splitlines()
    assert line.startswith(f"canfb: {words}")
