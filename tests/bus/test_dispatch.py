"""A module that gets only the frames it listens to does what one does that gets them all."""

from __future__ import annotations

import struct
from collections import Counter, deque
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.bus.frame_bus import REMOTE, FrameBus, Received
from canfb.bus.runner import Runner
from canfb.device.core import CanIds
from canfb.device.node import Device, Selective
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig
from drawing import examples
from fake_bus import FakeClock, FakeDevice
from ideal_tracks import counts_at

NODES, UNCONFIGURED, SERIAL = (32, 33, 34), 255, 4711
NEW_NODE = 35  # what LSS gives the last module
INTERFACES = (16, 17, 17, 18)  # two look at one encoder
WALL_S = 1.8e9
PERIOD_S = 0.002
# COB-IDs that modules may have by default, may be given, or that nobody has.
CAN_IDS = (0x080, 0x0A0, 0x0A1, 0x100, 0x190, 0x191, 0x1A0, 0x1A1, 0x1A2, 0x2A0, 0x2A1, 0x333, 0x334)


@dataclass(frozen=True)
class Batch:
    """Frames that wait together: so many seconds after the batch before, with receive times or without."""

    after_s: float
    frames: tuple[tuple[int, bytes], ...]
    stamped: bool = True


def sdo(node: int, index: int, subindex: int, size: int, value: int) -> tuple[int, bytes]:
    return 0x600 + node, struct.pack("<BHBI", 0x23 | (4 - size) << 2, index, subindex, value)


def lss(*data: int) -> tuple[int, bytes]:
    return 0x7E5, bytes(data).ljust(8, b"\0")


def select_last() -> list[tuple[int, bytes]]:
    """LSS switch selective to the module without a node-ID, which then gets one."""
    return [
        lss(0x40),
        lss(0x41, 1),
        lss(0x42, 1),
        lss(0x43, *SERIAL.to_bytes(4, "little")),
        lss(0x11, NEW_NODE),
    ]


nodes = st.sampled_from((*NODES, NEW_NODE))
can_ids = st.sampled_from(CAN_IDS)


def written(indices: tuple[int, ...], sub: int, size: int, values: Iterable[int]) -> st.SearchStrategy[Any]:
    build = lambda node, index, value: sdo(node, index, sub, size, value)  # noqa: E731
    return st.builds(build, nodes, st.sampled_from(indices), st.sampled_from(list(values)))


def flagged(*flags: int) -> list[int]:
    return [can_id | bits for can_id in CAN_IDS for bits in flags]


writes = st.one_of(
    written((0x1400, 0x1401, 0x1800, 0x1801), 1, 4, flagged(0, 0x4000_0000, 0xC000_0000)),
    written((0x1400, 0x1800, 0x1801), 2, 1, (0, 1, 2, 252, 253, 254, 255)),
    written((0x1005,), 0, 4, flagged(0, 0, 0, 0x4000_0000)),
    written((0x1012,), 0, 4, flagged(0x8000_0000)),
    written((0x1016,), 1, 4, (node << 16 | ms for node in (*NODES, NEW_NODE, 5) for ms in (0, 20, 100))),
    written((0x1017,), 0, 2, (0, 10, 50)),
    written((0x1006,), 0, 4, (0, 2000)),
    written((0x100C,), 0, 2, (20,)),
    written((0x1014,), 0, 4, (0xA0,)),
)
commands = st.builds(
    lambda command, node: (0x000, bytes([command, node])),
    st.sampled_from((1, 1, 1, 2, 0x80)),
    st.sampled_from((0, 0, *NODES, NEW_NODE)),
)
resets = st.builds(
    lambda command, node: (0x000, bytes([command, node])),
    st.sampled_from((0x81, 0x82)),
    st.sampled_from((0, *NODES)),
)
others = st.one_of(
    st.builds(lambda can_id, data: (can_id, data), can_ids, st.binary(max_size=8)),
    st.builds(
        lambda can_id: (can_id | REMOTE, b""), st.sampled_from((0x1A0, 0x1A1, 0x2A0, 0x720, 0x721, 0x333))
    ),
    st.builds(
        lambda node, state: (0x700 + node, bytes([state])), st.sampled_from((5, 32, 33, 35)), st.just(5)
    ),
    st.builds(lambda node: (0x580 + node, bytes(8)), nodes),
    st.builds(lambda can_id: (can_id, b""), st.integers(0x001, 0x7FF)),
)


def cycle(number: int, sync_id: int = 0x080) -> list[tuple[int, bytes]]:
    """A SYNC, and the samples of all encoders, some of which turn fast."""
    frames = [(sync_id, b"")]
    for interface in (16, 17, 18):
        counts = struct.pack("<hh", *counts_at(0.11 * (interface - 15) * number))
        frames.append((0x180 + interface, counts))
    return frames


@st.composite
def plans(draw: st.DrawFn) -> list[Batch]:
    """A master that waits for the answers to SDO, LSS and resets, and for nothing else."""
    plan = [Batch(0.01, ((0x000, b"\x01\x00"), *cycle(0)))]
    number = 1
    stamped = draw(st.booleans())
    for kind in draw(st.lists(st.sampled_from("wwwccccccorljp"), min_size=5, max_size=30)):
        pause_s = PERIOD_S
        frames: list[tuple[int, bytes]]
        if kind == "w":
            plan.append(Batch(1e-4, (draw(writes),), stamped))
            continue
        if kind == "r":
            plan.append(Batch(1e-4, (draw(resets),), stamped))
            frames = [(0x000, b"\x01\x00")]
        elif kind == "l":
            plan.extend(Batch(1e-4, (frame,), stamped) for frame in select_last())
            plan.append(Batch(1e-4, (lss(0x04, 0),), stamped))
            frames = [(0x000, b"\x01\x00")]
        elif kind == "o":
            frames = draw(st.lists(others, min_size=1, max_size=5))
        elif kind == "j":
            frames, pause_s = draw(st.lists(others, max_size=2)), draw(st.sampled_from((0.005, 0.03, 0.2)))
        elif kind == "p":
            frames = [draw(commands), *cycle(number)]
        else:
            frames = cycle(number, draw(st.sampled_from((0x080, 0x080, 0x080, 0x334))))
        number += 1
        plan.append(Batch(pause_s, tuple(frames), stamped))
    return plan


class Bus:
    """Hands out batches; frames that are not asked for when they come may be left out, as a kernel does."""

    def __init__(self, clock: FakeClock, plan: list[Batch], filters: bool) -> None:
        self.clock, self.plan, self.filters = clock, list(plan), filters
        self.due_s = clock.now + plan[0].after_s
        self.sent: list[tuple[float, int, bytes, bool]] = []
        self.heard: frozenset[int] | None = None
        self.left_out = 0
        self.taken: deque[Received] = deque()

    def receive(self, wait_s: float) -> Received | None:
        end_s = self.clock.now + wait_s  # also where frames come that are left out
        while not self.taken:
            if not self.plan or self.due_s > end_s:
                self.clock.now = end_s
                return None
            self.clock.now = max(self.clock.now, self.due_s)
            batch = self.plan.pop(0)
            self.due_s = self.clock.now + (self.plan[0].after_s if self.plan else 0.0)
            first_s = self.clock.now - 1e-5 * len(batch.frames)
            for n, frame in enumerate(batch.frames):
                if self._passes(frame[0]):
                    self.taken.append((*frame, first_s + 1e-5 * n + WALL_S if batch.stamped else 0.0))
                else:
                    self.left_out += 1
        return self.taken.popleft()

    def _passes(self, can_id: int) -> bool:
        return not self.filters or self.heard is None or can_id in self.heard

    def send(self, can_id: int, data: bytes, remote: bool) -> bool:
        self.sent.append((round(self.clock.now, 9), can_id, data, remote))
        return True

    def accept(self, can_ids: Iterable[int] | None, remote_can_ids: Iterable[int]) -> None:
        self.heard = (
            None if can_ids is None else frozenset([*can_ids, *(one | REMOTE for one in remote_can_ids)])
        )


class HearsAll:
    """A module that does not say what it listens to."""

    def __init__(self, module: FeedbackModule) -> None:
        self.start, self.receive, self.tick = module.start, module.receive, module.tick
        self.deadline, self.end = module.deadline, module.end
        self.inhibited, self.sent = module.inhibited, module.sent


@dataclass
class Outcome:
    sent: list[tuple[float, int, bytes, bool]]
    states: list[Any] = field(default_factory=list)
    left_out: int = 0


def modules() -> list[FeedbackModule]:
    configured = [
        ModuleConfig(node_id=node, encoder_interface=interface)
        for node, interface in zip(NODES, INTERFACES, strict=False)
    ]
    last = ModuleConfig(node_id=UNCONFIGURED, serial_number=SERIAL, encoder_interface=INTERFACES[-1])
    return [FeedbackModule(config) for config in (*configured, last)]


def state_of(module: FeedbackModule) -> tuple[Any, ...]:
    """All that the module holds; what it does not listen to is counted where it arrives only."""
    counters = asdict(module.counters) | {"unknown_cob_ids": 0, "remote_frames": 0}
    values = {(entry.index, entry.subindex): entry.value for entry in module.dictionary}
    return module.node_id, module.state, counters, values, module.feedback, module.limits


def played(plan: list[Batch], dispatched: bool) -> Outcome:
    clock = FakeClock()
    made = modules()
    devices: list[Device] = [one if dispatched else HearsAll(one) for one in made]
    assert all(isinstance(device, Selective) is dispatched for device in devices)
    bus = Bus(clock, plan, dispatched)
    frame_bus: FrameBus = bus  # type: ignore[assignment]
    runner = Runner(frame_bus, devices, clock=clock, sleep=clock.sleep, wall=lambda: clock.now + WALL_S)
    end_s = clock.now + sum(batch.after_s for batch in plan) + 0.5
    runner.run(finished=lambda: clock.now >= end_s)
    assert not bus.plan
    return Outcome(bus.sent, [state_of(one) for one in made], bus.left_out)


@given(plans())
@examples(40)
def test_the_same_frames_out_and_the_same_states(plan: list[Batch]) -> None:
    to_all, dispatched = played(plan, False), played(plan, True)
    assert dispatched.sent == to_all.sent
    assert dispatched.states == to_all.states


def test_such_plans_do_something() -> None:
    """Positions from all modules, the one with a new node-ID too, and frames that nobody needs left out."""
    plan = [Batch(0.01, (frame,)) for frame in (*select_last(), lss(0x04, 0))]
    plan += [Batch(0.01, ((0x000, b"\x01\x00"), *cycle(0), (0x333, b"")))]
    plan += [Batch(PERIOD_S, tuple(cycle(number))) for number in range(1, 20)]
    got = played(plan, True)
    sent = Counter(can_id for _, can_id, _, _ in got.sent)
    for node in (*NODES, NEW_NODE):
        assert sent[0x280 + node] == 20, "at each SYNC, also the one that came with the command"
        assert sent[0x180 + node] >= 20
    assert got.left_out == 1


def test_a_new_cob_id_is_heard_before_its_answer_goes_out() -> None:
    clock = FakeClock()
    plan = [Batch(0.01, (sdo(32, 0x1401, 1, 4, 0x333),))]
    bus = Bus(clock, plan, True)
    heard: list[bool] = []
    send: Callable[..., bool] = bus.send

    def noted(can_id: int, data: bytes, remote: bool) -> bool:
        heard.append(bus.heard is not None and 0x333 in bus.heard)
        return send(can_id, data, remote)

    bus.send = noted  # type: ignore[method-assign]
    runner = Runner(bus, list(modules()[:1]), clock=clock, sleep=clock.sleep)  # type: ignore[arg-type]
    runner.run(finished=lambda: not (bus.plan or bus.taken))
    assert heard == [False, True], "the boot-up, and the answer"


class Listening(FakeDevice):
    """A device that listens to the CAN-ID of its ticks, and counts how often its deadline is asked for."""

    asked = 0

    def deadline(self) -> float | None:
        self.asked += 1
        return None

    def can_ids(self) -> CanIds:
        return CanIds(frozenset({self.tick_id}), frozenset())

    def follow_can_ids(self, moved: Callable[[], None]) -> None:
        """It stays what it is."""


@pytest.mark.parametrize("count", [2, 32])
def test_a_frame_costs_only_those_who_listen(count: int) -> None:
    clock = FakeClock()
    devices = [Listening(clock, tick_id=0x100 + number) for number in range(count)]
    frames = tuple((0x100 + n % 4, b"") for n in range(100))
    bus = Bus(clock, [Batch(0.001, frames)], False)
    runner = Runner(bus, list(devices), clock=clock, sleep=clock.sleep)  # type: ignore[arg-type]
    runner.run(finished=lambda: not (bus.plan or bus.taken))
    assert sum(len(device.heard) for device in devices) == 25 * min(count, 4)
    assert sum(device.asked for device in devices) <= 25 * min(count, 4) + 3 * count
    assert runner.counters.received == 100
