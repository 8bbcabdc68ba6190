"""A module as `canfb run` serves it, on a bus that notes every frame: the live side of a replay."""

import math
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import can

from canfb import FeedbackModule, Frame, ModuleConfig
from canfb.bus.frame_bus import PythonCanBus
from canfb.bus.runner import Runner
from canfb.device.storage.storage import MemoryStore
from canfb.replay.module_replay import ModuleReplay
from fake_bus import FakeBus, FakeClock, message
from ideal_tracks import adc_pdo

EPOCH_S = 1e6  # as a monotonic clock: near 1.7e9 a float is exact to 0.24 us only, and periods differ by it
NODE_ID, INTERFACE_ID = 0x20, 0x10
PERIOD_S = 1e-3
SYNC_ID, ADC_ID, POSITION_ID = 0x80, 0x190, 0x1A0
Planned = tuple[float, Frame]


class NotingBus(FakeBus):
    """Notes the planned frames at their times, and what is sent, in the order of the bus."""

    def __init__(self, clock: FakeClock, plan: Sequence[Planned]) -> None:
        super().__init__(clock, [(at, as_message(frame)) for at, frame in plan])
        self.log: list[Frame] = []
        self.answers: list[Frame] = []

    def _note(self, message: can.Message) -> Frame:
        message.timestamp = self.clock.now
        frame = Frame(message.arbitration_id, bytes(message.data), message.is_remote_frame, self.clock.now)
        self.log.append(frame)
        return frame

    def recv(self, timeout: float | None = None) -> can.Message | None:
        message = super().recv(timeout)
        if message is not None:
            self._note(message)
        return message

    def send(self, message: can.Message) -> None:
        self.answers.append(self._note(message))


def live(
    plan: Sequence[Planned], store: MemoryStore | None = None, **fields: Any
) -> tuple[list[Frame], list[Frame]]:
    """The log of a live run, and of it what the module has sent."""
    clock = FakeClock()  # monotonic and wall clock in one
    clock.now = EPOCH_S
    bus = NotingBus(clock, plan)
    module = FeedbackModule(config(**fields), store)
    frame_bus = PythonCanBus(bus)  # type: ignore[arg-type]
    runner = Runner(frame_bus, [module], lambda line: None, clock=clock, sleep=lambda s: None, wall=clock)
    runner.run(finished=lambda: not bus.plan)
    return bus.log, bus.answers


def config(**fields: Any) -> ModuleConfig:
    return ModuleConfig(node_id=NODE_ID, encoder_interface=INTERFACE_ID, **fields)


def replayed(
    frames: Sequence[Frame],
    store: MemoryStore | None = None,
    options: dict[str, Any] | None = None,
    **fields: Any,
) -> tuple[ModuleReplay, list[Frame]]:
    """The replay of a log, closed, and what the module has sent."""
    sent: list[Frame] = []
    replay = ModuleReplay(config(**fields), store, sent=sent.append, **(options or {}))
    replay.feed(list(frames))
    replay.close()
    return replay, sent


def as_message(frame: Frame) -> can.Message:
    at_s = frame.timestamp or 0.0
    return message(frame.can_id, frame.data, timestamp=at_s, is_remote_frame=frame.rtr, channel=0)


def write_log(path: Path, frames: Sequence[Frame]) -> Path:
    with can.Logger(path) as logger:
        for frame in frames:
            logger.on_message_received(as_message(frame))
    return path


def contents(frames: Sequence[Frame]) -> list[tuple[int, str]]:
    return [(frame.can_id, frame.data.hex()) for frame in frames]


def nmt(command: int, node: int = NODE_ID) -> Frame:
    return Frame(0, bytes((command, node)))


def sdo_write(index: int, subindex: int, data: bytes) -> Frame:
    command = 0x23 | (4 - len(data)) << 2
    return Frame(0x600 + NODE_ID, struct.pack("<BHB4s", command, index, subindex, data))


def motion(samples: int, begin_s: float = 0.1, speed: float = 0.07, jitter_s: float = 0.0) -> list[Planned]:
    """SYNC and sample, ``speed`` in cycles per period."""
    plan: list[Planned] = []
    for n in range(samples):
        at = begin_s + n * PERIOD_S + jitter_s * math.sin(7.0 * n)
        plan += [(at, Frame(SYNC_ID, b"")), (at + 2e-4, adc_pdo(speed * n))]
    return plan


def session(samples: int = 300, **rest: Any) -> list[Planned]:
    return [(0.05, nmt(1, 0)), *motion(samples, **rest)]
