"""Encoder interface, feedback module and drive on an embedded bus, with python canopen's CiA 402 master."""

import functools
import struct
from typing import Any

import canopen
import numpy as np
from canopen.pdo.base import PdoMap
from canopen.profiles.p402 import BaseNode402

from canfb import FeedbackModule, Frame, ModuleConfig, eds_path
from canfb.demo.story import EmbeddedNetwork
from canfb.interface.encoder_interface import EncoderInterface, SampleClock
from canfb.simulation.cia402.drive import ServoDrive
from canfb.simulation.cia402.plant import DriveConfig, Motor, Plant, PlantSource
from canfb.simulation.cia402.state_machine import State
from canfb.simulation.embedded_bus import EmbeddedBus
from canfb.simulation.encoder import Encoder, ShaftEncoder
from played import Changing

DRIVE_ID, MODULE_ID, INTERFACE_ID = 0x30, 0x20, 0x10
UNITS = 1 << 20
SYNC = Frame(0x80, b"")


class DriveBench:
    """All powered on and operational, the drive in Switch on disabled, after 20 SYNCs."""

    speed_rev_s: float
    place: float

    def __init__(
        self,
        *,
        period_s: float = 1e-3,
        synchronous: bool = False,
        cycles_per_revolution: int = 2500,
        **motor: Any,
    ) -> None:
        self.period_s = period_s
        self.bus = EmbeddedBus()
        self.network = EmbeddedNetwork(self.bus)
        self.heard: list[Frame] = []
        self.bus.observers.append(lambda frame, now: self.heard.append(frame))
        self.motor = Motor(DriveConfig(node_id=DRIVE_ID, synchronous_feedback=synchronous, **motor))
        self.plant = Plant(self.motor)
        encoder = Encoder(noise_lsb=0.5)
        self.source = Changing(PlantSource(ShaftEncoder(encoder, cycles_per_revolution), self.plant))
        self.interface = EncoderInterface(INTERFACE_ID, self.source, clock=SampleClock(100.0))
        config = ModuleConfig(
            node_id=MODULE_ID, encoder_interface=INTERFACE_ID, cycles_per_revolution=cycles_per_revolution
        )
        self.module = FeedbackModule(config)
        self.drive = ServoDrive(self.plant, config)
        self.master = BaseNode402(DRIVE_ID, str(eds_path("drive")))
        self.module_master = canopen.RemoteNode(MODULE_ID, str(eds_path("canfb-module")))
        self.interface_master = canopen.RemoteNode(INTERFACE_ID, str(eds_path("encoder-interface")))
        for node in (self.master, self.module_master, self.interface_master):
            self.network.add_node(node)
        for participant in (self.plant, self.interface, self.module, self.drive):
            self.bus.attach(participant)
        self.master.setup_402_state_machine()
        for tpdo in self.master.tpdo.values():
            tpdo.wait_for_reception = functools.partial(self._wait_for, tpdo)
        self.network.nmt.state = "OPERATIONAL"
        self.cycle(20)

    def _wait_for(self, tpdo: PdoMap, timeout: float = 10.0) -> float | None:
        """In place of canopen's, which waits for a thread: simulated time passes."""
        tpdo.is_received = False
        end = self.bus.now + timeout
        while not tpdo.is_received and self.bus.now < end:
            self.cycle()
        return tpdo.timestamp if tpdo.is_received else None

    def cycle(self, count: int = 1) -> None:
        """So many SYNCs, each with all that it causes."""
        for _ in range(count):
            self.bus.run_until(self.bus.now + self.period_s)
            self.bus.send(SYNC)

    def enable(self, mode: str = "CYCLIC SYNCHRONOUS POSITION") -> None:
        self.master.op_mode = mode
        self.master.state = "OPERATION ENABLED"
        assert self.state is State.OPERATION_ENABLED

    def target(self, units: int) -> None:
        """607Ah by RPDO2; it is taken at the next SYNC."""
        self.network.send_message(0x300 + DRIVE_ID, struct.pack("<i", units))

    def control(self, controlword: int) -> None:
        """6040h by RPDO1, the mode as it is."""
        mode = self.drive.dictionary.entry(0x6060).value
        self.network.send_message(0x200 + DRIVE_ID, struct.pack("<Hb", controlword, mode))

    def read(self, index: int, subindex: int = 0) -> int:
        """An object of the drive by SDO."""
        thing = self.master.sdo[index]
        return (thing[subindex] if subindex else thing).raw

    def write(self, index: int, value: float, subindex: int = 0) -> None:
        thing = self.master.sdo[index]
        (thing[subindex] if subindex else thing).raw = value

    @property
    def state(self) -> State:
        return self.drive.power

    @property
    def shaft_units(self) -> float:
        """Where the shaft truly is, in units of the drive."""
        return self.motor.revolutions * UNITS

    def words(self, can_id: int) -> list[int]:
        """The first word of each frame: a statusword, or an error code."""
        return [struct.unpack_from("<H", frame.data)[0] for frame in self.heard if frame.can_id == can_id]

    def emergencies(self, node_id: int = DRIVE_ID) -> list[int]:
        return self.words(0x80 + node_id)

    def onward(self, count: int = 1) -> None:
        """So many SYNCs, and the target for the next, at this speed."""
        for _ in range(count):
            self.place += self.speed_rev_s * UNITS * self.period_s
            self.target(round(self.place))
            self.cycle()

    def follow(self, targets: list[int] | np.ndarray) -> np.ndarray:
        """A target for each SYNC; the true position of the shaft at each, in units."""
        truth = []
        for target in targets:
            self.target(int(target))
            self.cycle()
            truth.append(self.shaft_units)
        return np.array(truth)


def cruising(speed_rev_s: float = 5.0, **fields: Any) -> DriveBench:
    """At a constant speed, by targets at each SYNC."""
    bench = DriveBench(**fields)
    bench.enable()
    bench.speed_rev_s, bench.place = 0.0, float(bench.read(0x6064))
    while bench.speed_rev_s < speed_rev_s:
        bench.speed_rev_s = min(bench.speed_rev_s + 50 * bench.period_s, speed_rev_s)
        bench.onward()
    bench.onward(50)
    assert bench.state is State.OPERATION_ENABLED
    assert abs(bench.motor.speed_rad_s / 6.283185 - speed_rev_s) <= 0.02 * speed_rev_s
    return bench
