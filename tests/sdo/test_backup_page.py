"""docs/tables.md, backup: its commands run, one after the other, and its file is one."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import pytest

from canfb.cia301.nmt import NmtState
from canfb.cli import nmt_command
from canfb.device.storage.storage import MemoryStore
from canfb.eds_files import eds_path
from canfb.sdo.backup_file import read_backup
from canfb.sdo.object_description import ObjectDescriptions
from commissioning_kit import Bench
from node_commands import Commands

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "tables.md").read_text(encoding="utf-8").partition("\n## Backup")[2]
COMMANDS = [
    shlex.split(line)[1:]
    for block in re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL)
    for line in block.splitlines()
]


class Sending:
    """In place of the master of `canfb nmt`."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench

    def __enter__(self) -> Any:
        return self._bench.master

    def __exit__(self, *ending: Any) -> None:
        """There is nothing to close."""


def test_the_commands_of_the_page_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("feedback.yaml").write_text("modules: [{node_id: 0x20}]\n")
    canfb, bench = Commands(monkeypatch, capsys), Bench(store=MemoryStore())
    monkeypatch.setattr(nmt_command, "open_bus", lambda words: None)
    monkeypatch.setattr(nmt_command, "BusMaster", lambda bus: Sending(bench))
    assert [words[0] for words in COMMANDS] == ["backup", "restore", "restore", "nmt"]
    canfb(bench, *COMMANDS[0])
    bench.access.write(0x2010, 3, "B", 77)
    assert "2010:03 Supervision: Samples to coast: 77 -> 3 samples" in canfb(bench, *COMMANDS[1])[0]
    assert "saved (1010:01)" in canfb(bench, *COMMANDS[2])[0]
    assert bench.value(0x2010, 3) == 3
    assert bench.module.state is NmtState.PRE_OPERATIONAL
    canfb(bench, *COMMANDS[3])
    assert bench.module.state is NmtState.OPERATIONAL


def test_the_file_of_the_page_is_one(tmp_path: Path) -> None:
    (example,) = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)
    path = tmp_path / "backup.yaml"
    path.write_text(example)
    backup = read_backup(path, ObjectDescriptions(eds_path("canfb-module"), 1))
    assert backup.values == {(0x2010, 1): 21845, (0x2010, 2): 12.5, (0x2010, 3): 9}
    assert backup.table == b""
