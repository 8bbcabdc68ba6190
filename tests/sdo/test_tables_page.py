"""docs/storage.md: its commands run, one after the other, on a module, and its backup is one."""

from __future__ import annotations

import contextlib
from pathlib import Path

import pytest

from canfb.cia301.nmt import NmtState
from canfb.cli import node_command
from canfb.device.storage.storage import MemoryStore
from canfb.eds_files import eds_path
from canfb.sdo.backups import read_backup
from canfb.sdo.object_description import ObjectDescriptions
from canfb.sdo.tables import as_yaml
from canfb.signal.conditioning import Conditioning
from canfb.signal.correction import Correction, CorrectionTable
from commissioning_kit import Bench
from documentation import blocks, commands, page
from node_commands import Commands

PAGE = page("storage")
TABLES, _, BACKUPS = PAGE.partition("\n## A file for")[0].partition("\n## Tables")[2].partition("\n## Backup")
USED = Correction(CorrectionTable.identity(64), Conditioning(sine_gain=1.5))


@pytest.fixture
def canfb(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Commands:
    monkeypatch.chdir(tmp_path)
    return Commands(monkeypatch, capsys)


def test_the_commands_for_tables(canfb: Commands) -> None:
    Path("measured").mkdir()
    Path("measured/table.yaml").write_text(as_yaml(USED, {}))
    bench = Bench(sync=False, store=MemoryStore())
    said = [canfb(bench, *words)[0] for words in commands(TABLES)]
    assert bench.module.chain.correction == USED
    assert "saved (1010:04)" in said[-1]
    shown = canfb(bench, "table", "show", "0x20")[0]
    (example,) = blocks(TABLES, "text")
    assert [line[:17] for line in example.splitlines()[1:]] == [line[:17] for line in shown.splitlines()[1:]]


def test_the_commands_for_backups(canfb: Commands, monkeypatch: pytest.MonkeyPatch) -> None:
    Path("feedback.yaml").write_text("modules: [{node_id: 0x20}]\n")
    bench, given = Bench(store=MemoryStore()), commands(BACKUPS)
    monkeypatch.setattr(node_command, "open_bus", lambda words: None)
    monkeypatch.setattr(node_command, "BusMaster", lambda bus: contextlib.nullcontext(bench.master))
    assert [words[1] for words in given] == ["save", "restore", "restore", "start"]
    canfb(bench, *given[0])
    bench.access.write(0x2010, 3, "B", 77)
    assert "2010:03 Supervision: Samples to coast: 77 -> 3 samples" in canfb(bench, *given[1])[0]
    assert "saved (1010:01)" in canfb(bench, *given[2])[0]
    assert bench.value(0x2010, 3) == 3
    assert bench.module.state is NmtState.PRE_OPERATIONAL
    canfb(bench, *given[3])
    assert bench.module.state is NmtState.OPERATIONAL


def test_the_file_of_the_page_is_one(tmp_path: Path) -> None:
    (example,) = blocks(BACKUPS, "yaml")
    path = tmp_path / "backup.yaml"
    path.write_text(example)
    backup = read_backup(path, ObjectDescriptions(eds_path("canfb-module"), 1))
    assert backup.values == {(0x2010, 1): 21845, (0x2010, 2): 12.5, (0x2010, 3): 9}
    assert backup.table == b""
