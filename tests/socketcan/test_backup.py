"""`canfb table`, `backup`, `restore` and `sdo` against `canfb run`, processes on a real bus."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import can
from network import NODE_ID, Master, wait_for_boot_up, write_config
from pace import Pace

from canfb.sdo.tables import as_yaml
from canfb.signal.conditioning import Conditioning
from canfb.signal.correction import Correction
from commissioning_kit import TABLE
from processes import Process

NODE = str(NODE_ID)


def test_a_module_is_backed_up_changed_and_restored(
    process: Callable[..., Process], tmp_path: Path, can_bus: can.BusABC, can_channel: str, pace: Pace
) -> None:
    bus = ("-i", "socketcan", "-c", can_channel, "--timeout", str(pace.answer_s))

    def canfb(*arguments: str) -> str:
        command = process(*arguments, *bus)
        assert command.wait() == 0, str(command)
        return str(command)

    table, backup = tmp_path / "table.yaml", str(tmp_path / "backup.yaml")
    table.write_text(as_yaml(Correction(TABLE, Conditioning(sine_gain=1.25)), {}))
    process("run", write_config(tmp_path, f"    state_dir: {tmp_path / 'state'}\n"))
    wait_for_boot_up(can_bus, pace, NODE_ID)
    canfb("table", "write", NODE, str(table), "--activate")
    canfb("sdo", "write", NODE, "samples to coast", "9")
    canfb("backup", "save", NODE, backup)
    canfb("table", "clear", NODE, "--conditioning")
    canfb("sdo", "write", NODE, "samples to coast", "4")
    assert "saved (1010:01)" in canfb("backup", "restore", backup, "--save")
    with Master(can_channel, pace) as master:
        sdo = master.module.sdo
        assert (sdo[0x2020][4].raw, sdo[0x2020][6].raw) == (TABLE.crc32, TABLE.crc32)
        assert (sdo[0x2010][3].raw, sdo[0x2002][3].raw) == (9, 1.25)
        assert sdo.upload(0x2020, 1) == TABLE.to_bytes()
