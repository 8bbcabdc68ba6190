"""What stands around the module in the soak: machine, cable, another node, a slow store."""

from __future__ import annotations

import logging
import math
from collections import deque
from collections.abc import Callable, Collection

from canfb.cia301.frame import Frame
from canfb.device.node import Device
from canfb.device.storage.storage import Changes, MemoryStore, Store
from canfb.interface.encoder_interface import EncoderInterface
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig
from canfb.signal.sample import Sample
from canfb.simulation.embedded_bus import SimulatedDevice
from canfb.sources.protocol import SourceError

AMPLITUDE_COUNTS = 1500.0
MOVE_S, REST_S = 1.4, 2.0
TOP_CYCLES_S = 20_000.0
MAX_ACCELERATION_CYCLES_S2 = TOP_CYCLES_S * math.pi / MOVE_S
SAVE_POLLS = 5

logging.getLogger("canopen").setLevel(logging.CRITICAL)  # transfers are broken off on purpose


def position_cycles(time_s: float) -> float:
    """To and fro, with a rest at either end: v = top / 2 (1 - cos(2 pi t / MOVE_S))."""
    within = time_s % (2.0 * (MOVE_S + REST_S))
    back = within >= MOVE_S + REST_S
    t = min(within - (MOVE_S + REST_S if back else 0.0), MOVE_S)
    way = TOP_CYCLES_S / 2.0 * (t - MOVE_S / (2.0 * math.pi) * math.sin(2.0 * math.pi * t / MOVE_S))
    whole = TOP_CYCLES_S / 2.0 * MOVE_S
    return 0.3 + (whole - way if back else way)


def rests(time_s: float, spare_s: float = 0.0) -> bool:
    """Whether it stands still from now until ``spare_s`` later."""
    within = time_s % (MOVE_S + REST_S)
    return within >= MOVE_S and within + spare_s < MOVE_S + REST_S


def is_fast(time_s: float) -> bool:
    """Whether it moves fast, and does so for a while."""
    return 0.3 <= time_s % (MOVE_S + REST_S) <= 0.4


class Machine:
    """A source of samples; remembers where the machine was at the last one.

    ``coarse``: the samples have a track with one cycle per revolution of ``cycles_per_revolution``, too.
    ``broken``: the converter gives nothing.
    """

    def __init__(self, cycles_per_revolution: int, *, coarse: bool = False) -> None:
        self._per_revolution = cycles_per_revolution
        self._coarse = coarse
        self.broken = False
        self.sampled_cycles = 0.0

    def sample_at(self, now: float) -> Sample:
        if self.broken:
            raise SourceError("the converter does not answer")
        self.sampled_cycles = position = position_cycles(now)
        sine, cosine = _tracks(position)
        if not self._coarse:
            return Sample(sine, cosine)
        coarse_sine, coarse_cosine = _tracks(position / self._per_revolution)
        return Sample(sine, cosine, coarse_sine=coarse_sine, coarse_cosine=coarse_cosine)

    def next(self) -> Sample:
        """Not asked: the interface knows when it samples."""
        raise NotImplementedError


def _tracks(position: float) -> tuple[int, int]:
    angle = 2.0 * math.pi * (position % 1.0)
    return round(AMPLITUDE_COUNTS * math.sin(angle)), round(AMPLITUDE_COUNTS * math.cos(angle))


class Cable:
    """A device behind a cable that can be pulled out, and that loses frames of some CAN-IDs.

    losing   by CAN-ID: how many frames more do not arrive
    stamp_s  by how much the clock of receive times is ahead; None: frames have none
    """

    def __init__(self, device: Device, stamp_s: float | None) -> None:
        self._device, self.stamp_s = device, stamp_s
        self.pulled = False
        self.losing: dict[int, int] = {}
        self.start, self.deadline = device.start, device.deadline

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        if self.pulled:
            return []
        if self.losing.get(frame.can_id):
            self.losing[frame.can_id] -= 1
            return []
        if self.stamp_s is not None:
            frame = frame._replace(timestamp=now + self.stamp_s)
        return self._device.receive(frame, now)

    def tick(self, now: float) -> list[Frame]:
        frames = self._device.tick(now)
        return [] if self.pulled else frames


class SampledInterface(EncoderInterface):
    """Calls ``on_sample`` with each PDO that it sends at a SYNC."""

    on_sample: Callable[[Frame], None] = staticmethod(lambda frame: None)

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        frames = super().receive(frame, now)
        for one in frames:
            self.on_sample(one)
        return frames


class WatchedModule(FeedbackModule):
    """Calls ``on_frame`` with each frame, before it is taken."""

    def __init__(self, config: ModuleConfig, store: Store) -> None:
        self.on_frame: Callable[[Frame], None] = lambda frame: None
        super().__init__(config, store)

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        self.on_frame(frame)
        return super().receive(frame, now)


class OtherNode(SimulatedDevice):
    """A node with a heartbeat and nothing else; it comes and goes."""

    def __init__(self, node_id: int, period_s: float) -> None:
        self.is_there = True
        self._heartbeat = Frame(0x700 + node_id, b"\x05")
        self._period_s = period_s

    def start(self, now: float) -> list[Frame]:
        self._next_s = now + self._period_s
        return []

    def tick(self, now: float) -> list[Frame]:
        frames = super().tick(now)
        return frames if self.is_there else []

    def _due(self, due_s: float, now: float) -> Frame:
        self._next_s = now + self._period_s
        return self._heartbeat


class SlowStore(MemoryStore):
    """Is asked some times before a save is done; one in nine fails, as on a full disk."""

    def __init__(self) -> None:
        super().__init__()
        self._begun: deque[Changes] = deque()
        self._polls = self._saves = 0

    def begin(self, changes: Changes) -> None:
        self._begun.append(changes)
        self._polls = SAVE_POLLS

    def ended(self) -> Collection[OSError | None]:
        self._polls -= 1
        if self._polls > 0:
            return ()
        ended: list[OSError | None] = []
        while self._begun:
            changes = self._begun.popleft()
            self._saves += 1
            if self._saves % 9:
                self.save(changes)
                ended.append(None)
            else:
                ended.append(OSError(28, "No space left on device"))
        return ended
