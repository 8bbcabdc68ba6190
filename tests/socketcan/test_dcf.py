"""`canfb config dcf` from a running module, and what it wrote into another one, on a real bus."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import can
import canopen
from network import NODE_ID, Master, wait_for_boot_up, write_config
from pace import Pace

from commissioning_kit import TABLE
from processes import Process

OTHERWISE = """\
    adc_bits: 16
    cycles_per_revolution: 1024
    coast_samples: 9
    conditioning: {sine_offset_counts: 40.5, cosine_gain: 1.0371}
"""


def content(path: Path) -> str:
    """The DCF without its name and its date."""
    return path.read_text().partition("[DeviceInfo]")[2].replace(f"{path.stem}.table.bin", "table.bin")


def read(process: Callable[..., Process], folder: Path, name: str, pace: Pace) -> None:
    """From the running module into a DCF and its concise form."""
    command = process(
        "config", "dcf", str(NODE_ID), "-i", "socketcan", "-c", "vcan0",
        "--timeout", str(pace.answer_s),
        "--out", str(folder / f"{name}.dcf"), "--concise", str(folder / f"{name}.bin"),
    )  # fmt: skip
    assert command.wait() == 0, str(command)


def test_a_module_is_read_and_another_one_becomes_it(
    process: Callable[..., Process], tmp_path: Path, can_bus: can.BusABC, can_channel: str, pace: Pace
) -> None:
    first = process("run", write_config(tmp_path, OTHERWISE))
    wait_for_boot_up(can_bus, pace, NODE_ID)
    with Master(can_channel, pace) as master:
        master.module.sdo.download(0x2020, 1, TABLE.to_bytes())
        master.module.sdo.download(0x2020, 3, TABLE.crc32.to_bytes(4, "little"))
    read(process, tmp_path, "first", pace)
    assert (tmp_path / "first.table.bin").read_bytes() == TABLE.to_bytes()
    assert first.stop() == 0

    while can_bus.recv(0.0) is not None:
        pass
    process("run", write_config(tmp_path))
    wait_for_boot_up(can_bus, pace, NODE_ID)
    with Master(can_channel, pace) as master:
        node = master.network.add_node(NODE_ID, canopen.import_od(str(tmp_path / "first.dcf")))
        node.sdo.RESPONSE_TIMEOUT = pace.patience_s
        node.load_configuration()
        assert node.sdo[0x2020][4].raw == TABLE.crc32
    read(process, tmp_path, "second", pace)
    assert content(tmp_path / "second.dcf") == content(tmp_path / "first.dcf")
    assert (tmp_path / "second.bin").read_bytes() == (tmp_path / "first.bin").read_bytes()
