"""docs/plan.md: its commands run on a module."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from test_commission_on_a_bus import SHORT, bench_of

from canfb import objects as od
from canfb.cli.commission import named_config, over_bus
from canfb.cli.main import build_parser
from canfb.cli.progress import Progress
from canfb.device.storage.storage import MemoryStore
from canfb.files import prepare_folder
from canfb.master.all_or_nothing import Guard

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "plan.md").read_text(encoding="utf-8").partition("\n## Measured on")[2]
(BLOCK,) = re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL)
COMMANDS = [shlex.split(line)[1:] for line in BLOCK.splitlines()]
CONFIG = "bus: {interface: virtual}\nmodules: [{node_id: 0x20, encoder_interface: 0x10}]\n"


def test_the_commands_of_the_page_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("feedback.yaml").write_text(CONFIG)
    bench = bench_of(store=MemoryStore())
    for words in COMMANDS:
        options = build_parser().parse_args([*words, *SHORT])
        options.line = ""
        config = named_config(options)
        if options.out:
            prepare_folder(options.out)
        assert over_bus(bench.master, options, config, Progress(quiet=True), Guard(), "2026-03-01") == 0
    assert Path("limits/report.html").exists()
    assert "saved (1010:04)" in capsys.readouterr().out
    assert bench.value(*od.SUPERVISION_RESIDUAL_LIMIT) < 3000
