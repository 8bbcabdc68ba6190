"""What stands around the module in the soak: cables, another node, a slow store, and who knows the truth."""

from __future__ import annotations

import logging
from collections import OrderedDict, deque
from collections.abc import Callable, Collection

from canfb.cia301.frame import Frame
from canfb.device.device_protocol import Device
from canfb.device.storage.storage import Changes, MemoryStore, Store
from canfb.interface.encoder_interface import EncoderInterface
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig

SAVE_POLLS = 5
MOST_ON_THE_WAY = 4096  # samples

logging.getLogger("canopen").setLevel(logging.CRITICAL)  # transfers are broken off on purpose


class Cable:
    """A device behind a cable that can be pulled out, and that loses frames of some CAN-IDs."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self.pulled = False
        self.losing: dict[int, int] = {}
        """By CAN-ID: how many frames more do not arrive."""
        self.lost = 0
        self.stamp_s: float | None = None
        """By how much the clock of receive times is ahead; None: frames have none."""

    def start(self, now: float) -> list[Frame]:
        return self.device.start(now)

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        if self.pulled:
            return []
        if self.losing.get(frame.can_id):
            self.losing[frame.can_id] -= 1
            self.lost += 1
            return []
        if self.stamp_s is not None:
            frame = frame._replace(timestamp=now + self.stamp_s)
        return self.device.receive(frame, now)

    def tick(self, now: float) -> list[Frame]:
        frames = self.device.tick(now)
        return [] if self.pulled else frames

    def deadline(self) -> float | None:
        return self.device.deadline()


class Truths:
    """Where the machine was at each sample that is on its way, by the bytes of its PDO."""

    def __init__(self) -> None:
        self._by_id: OrderedDict[int, tuple[bytes, float]] = OrderedDict()

    def note(self, data: bytes, position_cycles: float) -> None:
        """A sample leaves. The very object is kept, so that no other one has its id."""
        self._by_id.pop(id(data), None)
        self._by_id[id(data)] = data, position_cycles
        if len(self._by_id) > MOST_ON_THE_WAY:
            self._by_id.popitem(last=False)

    def of(self, data: bytes) -> float | None:
        """It has arrived; None for a PDO of somebody else."""
        found = self._by_id.get(id(data))
        return None if found is None else found[1]


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


class OtherNode:
    """A node with a heartbeat and nothing else; it comes and goes."""

    def __init__(self, node_id: int, period_s: float) -> None:
        self.is_there = True
        self._heartbeat = Frame(0x700 + node_id, b"\x05")
        self._period_s = period_s
        self._next_s = 0.0

    def start(self, now: float) -> list[Frame]:
        self._next_s = now + self._period_s
        return []

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        return []

    def deadline(self) -> float | None:
        return self._next_s

    def tick(self, now: float) -> list[Frame]:
        if now < self._next_s:
            return []
        self._next_s = now + self._period_s
        return [self._heartbeat] if self.is_there else []


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
