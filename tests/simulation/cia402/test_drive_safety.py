"""Whatever comes, in whatever order: no torque where the state forbids it, no enabled drive that is blind."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from drive_bench import DRIVE_ID, MODULE_ID, SYNC, UNITS
from hypothesis import event, given, settings
from hypothesis import strategies as st

from canfb.cia301.frame import Frame
from canfb.cia301.nmt import NmtState
from canfb.simulation.cia402.drive import FeedbackModuleLink, ServoDrive
from canfb.simulation.cia402.plant import Motor, MotorConfig, Plant
from canfb.simulation.cia402.state_machine import POWERED, SWITCHED_ON, State

INCREMENTS = 20_480_000


@dataclass
class Rig:
    """A drive with a feedback that is right unless the test spoils it."""

    def __post_init__(self) -> None:
        self.plant = Plant(Motor(MotorConfig()))
        self.drive = ServoDrive(DRIVE_ID, self.plant, FeedbackModuleLink(node_id=MODULE_ID), autostart=True)
        self.now = 1.0
        self.drive.start(self.now)
        self.status = 1
        self.offset = 0
        self.silent = False

    def give(self, can_id: int, data: bytes) -> None:
        frame = Frame(can_id, data)
        self.plant.receive(frame, self.now)
        self.drive.receive(frame, self.now)
        self.check()

    def cycle(self, count: int = 1) -> None:
        for _ in range(count):
            self.wait(1e-3)
            self.give(SYNC.can_id, SYNC.data)
            if not self.silent:
                raw = round(self.plant.motor.revolutions * INCREMENTS) + self.offset
                self.give(0x180 + MODULE_ID, struct.pack("<IHH", raw % 4_280_320_000, self.status, 0))

    def wait(self, seconds: float) -> None:
        end = self.now + seconds
        while (due := self.drive.deadline()) is not None and due <= end:
            self.now = max(self.now, due)
            self.drive.tick(self.now)
            self.check()
        self.now = end

    def control(self, word: int) -> None:
        mode = self.drive.dictionary.entry(0x6060).value
        self.give(0x200 + DRIVE_ID, struct.pack("<Hb", word, mode))

    def check(self) -> None:
        drive, motor = self.drive, self.plant.motor
        if drive.power not in POWERED or drive.state is not NmtState.OPERATIONAL:
            assert (motor.command_nm, motor.torque_nm, motor.braked) == (0.0, 0.0, True)
        if drive.power in SWITCHED_ON:
            assert not drive.feedback.wrong
        assert abs(motor.command_nm) <= 0.5
        assert (drive.error != 0) == (drive.power in (State.FAULT, State.FAULT_REACTION_ACTIVE))
        shown = drive.dictionary.entry(0x6041).value
        assert shown & 0x6F == drive.power.value or drive.power.value & 0x4F == shown & 0x4F


def mode(value: int) -> bytes:
    return struct.pack("<Hb", 0, value)


WORDS = [0x00, 0x02, 0x06, 0x07, 0x0F, 0x1F, 0x3F, 0x5F, 0x80, 0x10F, 0x8F]
ACTION = st.one_of(
    st.tuples(st.just("control"), st.sampled_from(WORDS)),
    st.tuples(st.just("control"), st.sampled_from(WORDS)),
    st.tuples(st.just("cycle"), st.integers(1, 30)),
    st.tuples(st.just("cycle"), st.integers(1, 30)),
    st.tuples(st.just("target"), st.integers(-UNITS, UNITS)),
    st.tuples(st.just("mode"), st.sampled_from([0, 1, 8, 3])),
    st.tuples(st.just("status"), st.sampled_from([1, 1, 1, 0, 2])),
    st.tuples(st.just("silent"), st.booleans()),
    st.tuples(st.just("jump"), st.sampled_from([0, 0, 5, 30_000_000, -1_000_000_000])),
    st.tuples(st.just("emergency"), st.sampled_from([0x7300, 0x0000, 0x8130])),
    st.tuples(st.just("nmt"), st.sampled_from([1, 1, 2, 128, 129, 130])),
    st.tuples(st.just("pause"), st.sampled_from([0.01, 0.2])),
    st.tuples(st.just("boot"), st.just(0)),
)


@settings(max_examples=150)
@given(st.lists(ACTION, max_size=40))
def test_no_torque_without_a_state_that_allows_it(actions: list[tuple[str, int]]) -> None:
    rig = Rig()
    rig.cycle(5)
    for word in (0x06, 0x07, 0x0F):
        rig.control(word)
    assert rig.drive.power is State.OPERATION_ENABLED
    for name, value in actions:
        if name == "control":
            rig.control(value)
        elif name == "cycle":
            rig.cycle(value)
        elif name == "target":
            rig.give(0x300 + DRIVE_ID, struct.pack("<i", value))
        elif name == "mode":
            rig.give(0x600 + DRIVE_ID, struct.pack("<BHBb3x", 0x2F, 0x6060, 0, value))
        elif name == "status":
            rig.status = value
        elif name == "silent":
            rig.silent = bool(value)
        elif name == "jump":
            rig.offset += value
        elif name == "emergency":
            rig.give(0x80 + MODULE_ID, struct.pack("<HB5x", value, 1))
        elif name == "nmt":
            rig.give(0x000, bytes([value, DRIVE_ID]))
        elif name == "pause":
            rig.wait(value)
        elif name == "boot":
            rig.give(0x700 + MODULE_ID, b"\x00")
    event(rig.drive.power.name)
