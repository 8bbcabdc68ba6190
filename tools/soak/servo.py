"""A drive in the soak: the position loop of a CiA 402 drive is closed over the module that is disturbed."""

from __future__ import annotations

import contextlib
import math

from canfb.cia301.frame import Frame
from canfb.cia301.nmt import NmtCommand, NmtState
from canfb.errors import CanfbError
from canfb.master.access import NodeAccess
from canfb.signal.sample import Sample
from canfb.simulation.cia402.drive import FeedbackModuleLink, ServoDrive
from canfb.simulation.cia402.plant import Motor, MotorConfig, Plant, PlantSource
from canfb.simulation.cia402.state_machine import State
from canfb.simulation.encoder import Encoder
from canfb.sources.protocol import SourceError
from tools.soak.setups import CYCLES, Setup
from tools.soak.world import INTERVAL_S, MODULE, World

DRIVE, POSITION = 0x30, 0x180 + MODULE
UNITS, RANGE = 20_480_000, 4_280_320_000  # of 6004h in a revolution, and in all, by default
TURN_REVOLUTIONS, REVOLUTIONS_S2, DWELL_S = 0.4, 1.5, 2.0
TURN_S = math.pi * math.sqrt(TURN_REVOLUTIONS / 2.0 / REVOLUTIONS_S2)  # (1 - cos) / 2 from rest to rest
TOP_REVOLUTIONS_S = math.pi / 2.0 * TURN_REVOLUTIONS / TURN_S
MOST_SPEED_RAD_S = 1.3 * 2.0 * math.pi * TOP_REVOLUTIONS_S
PER_MILLE = 60  # of the rated torque: 15 rad/s²
STANDS_RAD_S, RUNS_RAD_S = 1e-6, 0.6 * 2.0 * math.pi * TOP_REVOLUTIONS_S
MOTOR = MotorConfig(inertia_kg_m2=0.002, coulomb_friction_nm=0.003, rated_torque_nm=0.5, brake_torque_nm=0.1)
PARAMETERS = {
    (0x1006, 0): ("I", round(1e6 * INTERVAL_S)),
    (0x608F, 1): ("I", UNITS),
    (0x2110, 2): ("H", 1),  # of the status word of the module bit 0, position valid
    (0x2110, 3): ("H", 1),
    (0x2110, 8): ("H", 100),
    (0x6065, 0): ("I", UNITS // 8),
    (0x6072, 0): ("H", PER_MILLE),
    (0x6085, 0): ("I", round(UNITS * REVOLUTIONS_S2)),
    (0x6060, 0): ("b", 8),
}
CONTROLWORD, TARGETS = (0x6040, 0), 0x300 + DRIVE
SHUTDOWN, SWITCH_ON, ENABLE, RESET_FAULT = 0x06, 0x07, 0x0F, 0x80
NEXT = {
    State.SWITCH_ON_DISABLED: SHUTDOWN,
    State.READY_TO_SWITCH_ON: SWITCH_ON,
    State.SWITCHED_ON: ENABLE,
    State.QUICK_STOP_ACTIVE: 0,
}


class ServoMachine(PlantSource):
    """The encoder on the shaft of the motor, as the world knows its machine."""

    def __init__(self, plant: Plant) -> None:
        super().__init__(Encoder(noise_lsb=0.5), plant, CYCLES)
        self.broken = False

    @property
    def sampled_cycles(self) -> float:
        """Where it was at the last sample."""
        return self.position_cycles

    def sample_at(self, now: float) -> Sample:
        """See Machine."""
        if self.broken:
            raise SourceError("the converter does not answer")
        return super().sample_at(now)


class ServoWorld(World):
    """The same network with a drive, whose master lets it turn to and fro, and resets its faults."""

    def __init__(self, setup: Setup, seed: int) -> None:
        self.plant = Plant(Motor(MOTOR))
        self.drive = ServoDrive(DRIVE, self.plant, FeedbackModuleLink(node_id=MODULE))
        self._aim = TURN_REVOLUTIONS
        self._dwells_until_s = 0.0
        self._is_turning = False
        self._from_units, self._begun_s = 0, 0.0
        self._published = 0
        super().__init__(setup, seed, ServoMachine(self.plant), first=[self.plant], last=[self.drive])
        self.bus.observers.append(self._hear_position)
        self._drive_access = NodeAccess(self.master, DRIVE, "drive")
        self.configure_drive()

    def configure_drive(self) -> None:
        """After its power-on or reset."""
        with contextlib.suppress(CanfbError):
            for place, (kind, value) in PARAMETERS.items():
                self._drive_access.write(*place, kind, value)
        self.bus.send(Frame(0x000, bytes((NmtCommand.START, DRIVE))))

    def rests(self, spare_s: float) -> bool:
        """It stands, and is not moved."""
        return self._stands() and not self._is_turning and self.bus.now + spare_s < self._dwells_until_s

    def is_fast(self) -> bool:
        """It moves fast."""
        return abs(self.plant.motor.speed_rad_s) > RUNS_RAD_S

    def care(self) -> None:
        """One step of the master of the drive; a request that is not answered is tried again."""
        super().care()
        with contextlib.suppress(CanfbError):
            self._care_for_drive()

    def _care_for_drive(self) -> None:
        drive, now = self.drive, self.bus.now
        if drive.node.state is not NmtState.OPERATIONAL:
            self.configure_drive()
        elif drive.state is State.FAULT:
            self._is_turning = False
            self._dwells_until_s = now + DWELL_S
            if self.valid():
                self._command(0)
                self._command(RESET_FAULT)
        elif drive.state in NEXT:
            self._is_turning = False  # it has forgotten its target, and will not say that it is there
            self._command(NEXT[drive.state])
        elif drive.state is State.OPERATION_ENABLED:
            self._turn(now)

    def _turn(self, now: float) -> None:
        if self._is_turning and now > self._begun_s + TURN_S and self._stands():
            self._is_turning, self._dwells_until_s = False, now + DWELL_S
        elif not self._is_turning and now >= self._dwells_until_s:
            self._is_turning, self._aim, self._begun_s = True, -self._aim, now
            self._from_units = int(self.drive.dictionary.entry(0x6064).value)

    def _stands(self) -> bool:
        return abs(self.plant.motor.speed_rad_s) < STANDS_RAD_S

    def _send_target(self, now: float) -> None:
        """The target of the move for the next SYNC."""
        if self._is_turning:
            part = min(1.0, (now - self._begun_s) / TURN_S)
            gone = round(self._aim * UNITS * (1.0 - math.cos(math.pi * part)) / 2.0)
            self.bus.send(Frame(TARGETS, (self._from_units + gone).to_bytes(4, "little", signed=True)))

    def _command(self, controlword: int) -> None:
        self._drive_access.write(*CONTROLWORD, "H", controlword)
        self.bus.run_until(self.bus.now + 2.0 * INTERVAL_S)

    def _hear_position(self, frame: Frame, now: float) -> None:
        if frame.can_id == POSITION:
            self._published = int.from_bytes(frame.data[:4], "little")

    def on_sync(self, now: float) -> None:
        """The drive holds what the module has published, and does not run away."""
        self._send_target(now)
        feedback = self.drive.feedback
        if not feedback.wrong and self.drive.state is State.OPERATION_ENABLED:
            self.found.driven += 1
            if (feedback.position - self._published) % RANGE:
                self.see_wrong(
                    f"{now:.3f} s, the drive has {feedback.position}, published was {self._published}"
                )
        if abs(self.plant.motor.speed_rad_s) > MOST_SPEED_RAD_S:
            self.see_wrong(f"{now:.3f} s, the drive turns with {self.plant.motor.speed_rad_s:.1f} rad/s")


def drive_goes(world: World) -> None:
    """NMT stop or reset of the drive, in motion too."""
    command = world.rng.choice((NmtCommand.STOP, NmtCommand.ENTER_PRE_OPERATIONAL, NmtCommand.RESET_NODE))
    world.bus.send(Frame(0x000, bytes((command, DRIVE))))
    world.pass_(world.rng.uniform(0.002, 0.5))


def quick_stop(world: World) -> None:
    """In motion too; the master lets it go on."""
    world.bus.send(Frame(0x600 + DRIVE, bytes.fromhex("2b40600002000000")))
    world.pass_(0.5)


OF_A_DRIVE = (drive_goes, quick_stop)
