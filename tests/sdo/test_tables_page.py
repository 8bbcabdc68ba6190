"""docs/tables.md: its commands run, one after the other, on a module."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from canfb.device.storage.storage import MemoryStore
from canfb.sdo.table_file import as_yaml
from canfb.signal.conditioning import Conditioning
from canfb.signal.correction import Correction, CorrectionTable
from commissioning_kit import Bench
from node_commands import Commands

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "tables.md").read_text(encoding="utf-8").partition("\n## Backup")[0]
COMMANDS = [
    shlex.split(line)[1:]
    for block in re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL)
    for line in block.splitlines()
]
USED = Correction(CorrectionTable.identity(64), Conditioning(sine_gain=1.5))


def test_the_commands_of_the_page_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("measured").mkdir()
    Path("measured/table.yaml").write_text(as_yaml(USED, {}))
    canfb, bench = Commands(monkeypatch, capsys), Bench(sync=False, store=MemoryStore())
    said = [canfb(bench, *words)[0] for words in COMMANDS]
    assert bench.module.chain.correction == USED
    assert "saved (1010:04)" in said[-1]
    shown = canfb(bench, "table", "show", "0x20")[0]
    rows = [line[:17].strip() for line in PAGE.splitlines() if line.startswith("active table")]
    assert rows == ["active table"]
    labels = [line[:17] for line in shown.splitlines()[1:]]
    (example,) = re.findall(r"```text\n(.*?)```", PAGE, re.DOTALL)
    assert [line[:17] for line in example.splitlines()[1:]] == labels
