"""`canfb config dcf` from a running module, and what it wrote into another one, on a real bus."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import canopen
import numpy as np
from network import NODE_ID, Master, write_config

from canfb.signal.correction import CorrectionTable

BUS = ("-i", "socketcan", "-c", "vcan0", "--answer-within", "5")
OTHERWISE = """\
    adc_bits: 16
    cycles_per_revolution: 1024
    coast_samples: 9
    conditioning: {sine_offset_counts: 40.5, cosine_gain: 1.0371}
"""
PHASES = np.arange(64) / 64
TABLE = CorrectionTable(PHASES + 0.01 * np.sin(2 * np.pi * PHASES))
ANSWER_S = 5.0


def content(path: Path) -> str:
    """The DCF without its name and its date."""
    return path.read_text().partition("[DeviceInfo]")[2].replace(f"{path.stem}.table.bin", "table.bin")


def read(process: Callable[..., Any], folder: Path, name: str) -> None:
    """From the running module into a DCF and its concise form."""
    command = process(
        "config", "dcf", "--node", str(NODE_ID), *BUS,
        "--out", str(folder / f"{name}.dcf"), "--concise", str(folder / f"{name}.bin"),
    )  # fmt: skip
    assert command.wait(60.0) == 0, str(command)


def test_a_module_is_read_and_another_one_becomes_it(
    process: Callable[..., Any], tmp_path: Path, can_channel: str
) -> None:
    first = process("run", write_config(tmp_path, OTHERWISE))
    first.wait_for("end with Ctrl-C")
    master = Master(can_channel)
    try:
        master.module.sdo.download(0x2020, 1, TABLE.to_bytes())
        master.module.sdo.download(0x2020, 3, TABLE.crc32.to_bytes(4, "little"))
    finally:
        master.close()
    read(process, tmp_path, "first")
    assert (tmp_path / "first.table.bin").read_bytes() == TABLE.to_bytes()
    first.stop()

    process("run", write_config(tmp_path)).wait_for("end with Ctrl-C")
    network = canopen.Network()
    network.connect(interface="socketcan", channel=can_channel)
    try:
        node = network.add_node(NODE_ID, canopen.import_od(str(tmp_path / "first.dcf")))
        node.sdo.RESPONSE_TIMEOUT = ANSWER_S
        node.load_configuration()
        assert node.sdo[0x2020][4].raw == TABLE.crc32
    finally:
        network.disconnect()
    read(process, tmp_path, "second")
    assert content(tmp_path / "second.dcf") == content(tmp_path / "first.dcf")
    assert (tmp_path / "second.bin").read_bytes() == (tmp_path / "first.bin").read_bytes()


def test_no_node_there_is_one_line(process: Callable[..., Any]) -> None:
    command = process(
        "config", "dcf", "--node", "0x55", "-i", "socketcan", "-c", "vcan0", "--answer-within", "0.2"
    )
    assert command.wait(60.0) == 1
    assert len(command.lines) == 1
    assert "canfb: node 85 (55h): reading 1000:00: no answer" in command.lines[0]
