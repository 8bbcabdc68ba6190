"""A module that gets only the frames it listens to does what one does that gets them all."""

import struct
from collections import Counter, deque
from collections.abc import Callable, Iterable
from dataclasses import asdict
from typing import Any, NamedTuple

import pytest
from hypothesis import given, strategies as st

from canfb import FeedbackModule, ModuleConfig
from canfb.bus.frame_bus import REMOTE, FrameBus, Received
from canfb.bus.runner import Runner
from canfb.device.core import CanIds
from canfb.device.node import Device, Selective
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


# Frames that wait together: so many seconds after those before.
Plan = list[tuple[float, list[tuple[int, bytes]]]]
START = (0x000, b"\x01\x00")


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
        lss(0x04, 0),
    ]


nodes = st.sampled_from((*NODES, NEW_NODE))
can_ids = st.sampled_from(CAN_IDS)


def flagged(*flags: int) -> list[int]:
    return [can_id | bits for can_id in CAN_IDS for bits in flags]


WRITES: tuple[tuple[tuple[int, ...], int, int, list[int]], ...] = (
    ((0x1400, 0x1401, 0x1800, 0x1801), 1, 4, flagged(0, 0x4000_0000, 0xC000_0000)),
    ((0x1400, 0x1800, 0x1801), 2, 1, [0, 1, 2, 252, 253, 254, 255]),
    ((0x1005,), 0, 4, flagged(0, 0, 0, 0x4000_0000)),
    ((0x1012,), 0, 4, flagged(0x8000_0000)),
    ((0x1016,), 1, 4, [node << 16 | ms for node in (*NODES, NEW_NODE, 5) for ms in (0, 20, 100)]),
    ((0x1017,), 0, 2, [0, 10, 50]),
    ((0x1006,), 0, 4, [0, 2000]),
    ((0x100C,), 0, 2, [20]),
    ((0x1014,), 0, 4, [0xA0]),
)


@st.composite
def writes(draw: st.DrawFn) -> tuple[int, bytes]:
    indices, subindex, size, values = draw(st.sampled_from(WRITES))
    return sdo(draw(nodes), draw(st.sampled_from(indices)), subindex, size, draw(st.sampled_from(values)))


def nmt(*commands: int) -> st.SearchStrategy[tuple[int, bytes]]:
    targets = st.sampled_from((0, 0, *NODES, NEW_NODE))
    return st.builds(
        lambda command, node: (0x000, bytes([command, node])), st.sampled_from(commands), targets
    )


others = st.one_of(
    st.tuples(can_ids, st.binary(max_size=8)),
    st.sampled_from([(can_id | REMOTE, b"") for can_id in (0x1A0, 0x1A1, 0x2A0, 0x720, 0x721, 0x333)]),
    st.sampled_from([(0x700 + node, b"\x05") for node in (5, 32, 33, 35)]),
    st.tuples(nodes.map(lambda node: 0x580 + node), st.just(bytes(8))),
    st.tuples(st.integers(0x001, 0x7FF), st.just(b"")),
)
requests = st.one_of(
    st.lists(writes(), max_size=3),
    nmt(0x81, 0x82).map(lambda reset: [reset, START]),
    st.just([*select_last(), START]),
)
pauses_s = st.sampled_from((*[PERIOD_S] * 6, 0.005, 0.03, 0.2))
sync_ids = st.sampled_from((*[0x080] * 6, 0x334, None))


def cycle(number: int, sync_id: int = 0x080) -> list[tuple[int, bytes]]:
    """A SYNC, and the samples of all encoders, some of which turn fast."""
    frames = [(sync_id, b"")]
    for interface in (16, 17, 18):
        counts = struct.pack("<hh", *counts_at(0.11 * (interface - 15) * number))
        frames.append((0x180 + interface, counts))
    return frames


@st.composite
def plans(draw: st.DrawFn) -> Plan:
    """A master that waits for the answers to SDO, LSS and resets, and for nothing else."""
    steps = st.tuples(requests, pauses_s, st.lists(nmt(1, 1, 1, 2, 0x80) | others, max_size=3), sync_ids)
    plan: Plan = [(0.01, [START, *cycle(0)])]
    for number, (asked, pause_s, frames, sync_id) in enumerate(
        draw(st.lists(steps, min_size=5, max_size=15)), 1
    ):
        plan += [(1e-4, [frame]) for frame in asked]
        plan.append((pause_s, [*frames, *([] if sync_id is None else cycle(number, sync_id))]))
    return plan


class Bus:
    """Hands out batches; frames that are not asked for when they come may be left out, as a kernel does."""

    def __init__(self, clock: FakeClock, plan: Plan, filters: bool, stamped: bool = True) -> None:
        self.clock, self.plan, self.filters, self.stamped = clock, list(plan), filters, stamped
        self.due_s = clock.now + plan[0][0]
        self.sent: list[tuple[float, int, bytes, bool]] = []
        self.heard: frozenset[int] | None = None
        self.heard_at_send: list[frozenset[int] | None] = []
        self.left_out = 0
        self.taken: deque[Received] = deque()

    def receive(self, wait_s: float) -> Received | None:
        end_s = self.clock.now + wait_s  # also where frames come that are left out
        while not self.taken:
            if not self.plan or self.due_s > end_s:
                self.clock.now = end_s
                return None
            self.clock.now = max(self.clock.now, self.due_s)
            _, frames = self.plan.pop(0)
            self.due_s = self.clock.now + (self.plan[0][0] if self.plan else 0.0)
            first_s = self.clock.now - 1e-5 * len(frames)
            for n, frame in enumerate(frames):
                if not self.filters or self.heard is None or frame[0] in self.heard:
                    self.taken.append((*frame, first_s + 1e-5 * n + WALL_S if self.stamped else 0.0))
                else:
                    self.left_out += 1
        return self.taken.popleft()

    def send(self, can_id: int, data: bytes, remote: bool) -> bool:
        self.sent.append((round(self.clock.now, 9), can_id, data, remote))
        self.heard_at_send.append(self.heard)
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


class Outcome(NamedTuple):
    sent: list[tuple[float, int, bytes, bool]]
    states: list[Any]
    left_out: int


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


def played(plan: Plan, dispatched: bool, stamped: bool = True) -> Outcome:
    clock = FakeClock()
    made = modules()
    devices: list[Device] = [one if dispatched else HearsAll(one) for one in made]
    assert all(isinstance(device, Selective) is dispatched for device in devices)
    bus = Bus(clock, plan, dispatched, stamped)
    frame_bus: FrameBus = bus  # type: ignore[assignment]
    runner = Runner(frame_bus, devices, clock=clock, sleep=clock.sleep, wall=lambda: clock.now + WALL_S)
    end_s = clock.now + sum(after_s for after_s, _ in plan) + 0.5
    runner.run(finished=lambda: clock.now >= end_s)
    assert not bus.plan
    return Outcome(bus.sent, [state_of(one) for one in made], bus.left_out)


@given(plans(), st.booleans())
@examples(40)
def test_the_same_frames_out_and_the_same_states(plan: Plan, stamped: bool) -> None:
    to_all, dispatched = played(plan, False, stamped), played(plan, True, stamped)
    assert dispatched.sent == to_all.sent
    assert dispatched.states == to_all.states


def test_such_plans_do_something() -> None:
    """Positions from all modules, the one with a new node-ID too, and frames that nobody needs left out."""
    plan: Plan = [(0.01, [frame]) for frame in select_last()]
    plan.append((0.01, [START, *cycle(0), (0x333, b"")]))
    plan += [(PERIOD_S, cycle(number)) for number in range(1, 20)]
    got = played(plan, True)
    sent = Counter(can_id for _, can_id, _, _ in got.sent)
    for node in (*NODES, NEW_NODE):
        assert sent[0x280 + node] == 20, "at each SYNC, also the one that came with the command"
        assert sent[0x180 + node] >= 20
    assert got.left_out == 1


def test_a_new_cob_id_is_heard_before_its_answer_goes_out() -> None:
    clock = FakeClock()
    bus = Bus(clock, [(0.01, [sdo(32, 0x1401, 1, 4, 0x333)])], True)
    runner = Runner(bus, list(modules()[:1]), clock=clock, sleep=clock.sleep)  # type: ignore[arg-type]
    runner.run(finished=lambda: not (bus.plan or bus.taken))
    heard = [can_ids is not None and 0x333 in can_ids for can_ids in bus.heard_at_send]
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
    bus = Bus(clock, [(0.001, [(0x100 + n % 4, b"") for n in range(100)])], False)
    runner = Runner(bus, list(devices), clock=clock, sleep=clock.sleep)  # type: ignore[arg-type]
    runner.run(finished=lambda: not (bus.plan or bus.taken))
    assert sum(len(device.heard) for device in devices) == 25 * min(count, 4)
    assert sum(device.asked for device in devices) <= 25 * min(count, 4) + 3 * count
    assert runner.counters.received == 100
