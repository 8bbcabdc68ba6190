"""The asyncio program of docs/service.md, as it stands there, on a bus of python-can."""

from __future__ import annotations

import asyncio
import re
import struct
from pathlib import Path
from typing import Any

import can

from canfb import FeedbackModule, ModuleConfig, StatusBit

PATIENCE_S = 60.0


async def session(names: dict[str, Any]) -> tuple[int, bytes]:
    """SYNC and ADC PDO, each answered before the next: the valid positions, and the first frame."""
    module = FeedbackModule(ModuleConfig(node_id=0x20, encoder_interface=0x10))
    statuses: asyncio.Queue[int] = asyncio.Queue()
    module.on_feedback = lambda feedback, now: statuses.put_nowait(feedback.status & StatusBit.VALID)
    ended, valid = asyncio.Event(), 0
    with (
        can.Bus(interface="virtual", channel="program") as bus,
        can.Bus(interface="virtual", channel="program") as master,
    ):
        serving = asyncio.create_task(names["serve"](bus, module, ended))
        boot_up = await asyncio.to_thread(master.recv, PATIENCE_S)
        assert boot_up is not None
        cycle = [(0x080, b""), (0x190, struct.pack("<hh", 1500, 0))]
        for can_id, data in [(0x000, b"\x01\x20"), *5 * cycle]:
            master.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))
            if can_id == 0x190:
                valid += await asyncio.wait_for(statuses.get(), PATIENCE_S)
        ended.set()
        await asyncio.wait_for(serving, PATIENCE_S)
    return valid, bytes([boot_up.arbitration_id & 0xFF, *boot_up.data])


def test_the_asyncio_program() -> None:
    page = (Path(__file__).parents[2] / "docs/service.md").read_text("utf-8")
    (block,) = re.findall(r"^```python\n(.*?)^```", page, re.M | re.S)
    names: dict[str, Any] = {"__name__": "program"}
    exec(block, names)
    assert asyncio.run(session(names)) == (5, b"\x20\x00")
