"""The asyncio program of docs/program.md, as it stands there, on a bus of python-can."""

from __future__ import annotations

import asyncio
import re
import struct
from pathlib import Path
from typing import Any

import can

from canfb import FeedbackModule, ModuleConfig, StatusBit

PAGE = Path(__file__).parents[2] / "docs/program.md"
PATIENCE_S = 60.0


def program() -> dict[str, Any]:
    (block,) = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.M | re.S)
    names: dict[str, Any] = {"__name__": "program"}
    exec(compile(block, str(PAGE), "exec"), names)
    return names


async def session() -> tuple[list[int], bytes]:
    """SYNC and ADC PDO, each answered before the next: the counts of cycles, and the first frame."""
    module = FeedbackModule(ModuleConfig(node_id=0x20, encoder_interface=0x10))
    feedbacks: asyncio.Queue[tuple[int, int]] = asyncio.Queue()
    module.on_feedback = lambda feedback, now: feedbacks.put_nowait((feedback.cycles, feedback.status))
    ended, cycles = asyncio.Event(), []
    with (
        can.Bus(interface="virtual", channel="program") as bus,
        can.Bus(interface="virtual", channel="program") as master,
    ):
        serving = asyncio.create_task(program()["serve"](bus, module, ended))
        boot_up = await asyncio.to_thread(master.recv, PATIENCE_S)
        assert boot_up is not None
        for can_id, data in [(0x000, b"\x01\x20")] + 5 * [
            (0x080, b""),
            (0x190, struct.pack("<hh", 1500, 0)),
        ]:
            master.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))
            if can_id == 0x190:
                count, status = await asyncio.wait_for(feedbacks.get(), PATIENCE_S)
                assert status & StatusBit.VALID
                cycles.append(count)
        ended.set()
        await asyncio.wait_for(serving, PATIENCE_S)
    return cycles, bytes([boot_up.arbitration_id & 0xFF, *boot_up.data])


def test_the_asyncio_program() -> None:
    assert asyncio.run(session()) == ([0] * 5, b"\x20\x00")
