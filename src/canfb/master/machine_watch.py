"""Speed, status and counters of the module during a measurement, and its provenance."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from importlib.metadata import version
from typing import Any

from canfb import objects as od
from canfb.calibration.recording import WINDOW, away_from, find_lock
from canfb.calibration.result import Reason
from canfb.errors import CalibrationError
from canfb.master.access import CommissioningError, NodeAccess, Progress
from canfb.master.samples import Listener
from canfb.rows import Row

FIRST_S = 1.0
STANDSTILL_S = 3.0  # standstill is reported only after this, as the machine may be about to start
HALF_CYCLE = 0.5


class LockWatch:
    """Checks FIRST_S after the first SYNC whether the motion is locked to the samples: ``found``.

    ``speed_rad_s`` returns 0.0 if it is not known.
    """

    def __init__(self, cycles_per_revolution: int, speed_rad_s: Callable[[], float]) -> None:
        self.found: CalibrationError | None = None
        self._cycles_per_revolution = cycles_per_revolution
        self._speed_rad_s = speed_rad_s
        self._next_s = FIRST_S

    def __call__(self, listening: Listener) -> bool:
        if listening.elapsed_s < self._next_s or listening.intervals < WINDOW:
            return False
        samples = listening.result()
        from_s, most = self._next_s - FIRST_S, max(0, len(samples) - WINDOW)
        first = min(int(from_s * (samples.rate_hz or 0.0)), most)
        lock = find_lock(samples.sine[first:], samples.cosine[first:])
        if lock is None:
            self._next_s = math.inf
            return False
        speed = 0.0
        if samples.rate_hz:
            speed = self._speed_rad_s() * self._cycles_per_revolution / (2.0 * math.pi) / samples.rate_hz
            if speed < 0.0:  # count the direction of motion as positive
                speed, lock = -speed, -lock % 1
        if lock.denominator == 1 and speed < HALF_CYCLE and self._next_s < STANDSTILL_S:
            self._next_s = STANDSTILL_S
            return False
        self.found = self._error(lock, speed, samples.rate_hz)
        return True

    def raise_found(self) -> None:
        """CalibrationError, with a suitable speed, if the motion is locked."""
        if self.found is not None:
            raise self.found

    def _error(self, lock: Fraction, speed: float, rate_hz: float | None) -> CalibrationError:
        step, near = away_from(float(lock)), round(speed - lock) + float(lock)
        rpm = 60.0 * rate_hz / self._cycles_per_revolution if rate_hz else 0.0  # rpm at one cycle per sample
        faster = f"{step * rpm:.3g} rpm faster" if rpm else f"by {step} of a cycle per sample faster"
        if lock.denominator == 1 and speed < HALF_CYCLE:
            return CalibrationError(
                "the tracks hardly change: the machine is at standstill, or moves a whole number of "
                f"cycles per sample. Let it turn {faster}",
                Reason.COVERAGE,
            )
        known = "" if speed < HALF_CYCLE else f", for example at {(near + step) * rpm:.5g} rpm"
        count = "a whole number" if lock.denominator == 1 else f"n + {lock}"
        return CalibrationError(
            f"the motion is locked to the samples: {count} of cycles per sample, so that the same phases "
            f"repeat. Let it turn {faster}{known}",
            Reason.LOCKED,
        )


MISSED, LOST = "missed samples", "position lost"
# Counters of 2012h, by the fault that they count.
COUNTERS = {
    MISSED: od.COUNTER_MISSED,
    "residual": od.COUNTER_RESIDUAL,
    "amplitude": od.COUNTER_AMPLITUDE,
    "coasting": od.COUNTER_COASTED,
    LOST: od.COUNTER_LOST,
    "clipped": od.COUNTER_CLIPPED,
    "frozen": od.COUNTER_FROZEN,
    "coarse track": od.COUNTER_COARSE_DISAGREEMENTS,
}
U32 = 1 << 32
READINGS_EVERY_S = 0.3
SHORTEST_S = 1e-6  # shorter remaining times are rounding
MORE_THAN_BEFORE = 3.0


@dataclass(frozen=True)
class Look:
    """Status word (2011:01), cycle count (2011:04) and counters at one time."""

    status: int
    cycles: int
    counters: Mapping[str, int]

    @property
    def is_lost(self) -> bool:
        return od.position_state(self.status) is od.PositionState.LOST


@dataclass(frozen=True)
class Meanwhile:
    """The module before and after a measurement."""

    before: Look
    after: Look

    @property
    def is_lost(self) -> bool:
        return self.before.is_lost or self.after.is_lost

    @property
    def counted(self) -> dict[str, int]:
        return counted(self.before.counters, self.after.counters)

    @property
    def missed(self) -> int:
        return self.counted.get(MISSED, 0)

    @property
    def cycles(self) -> int | None:
        """Distance, or None if unknown."""
        valid = self.before.status & self.after.status & od.StatusBit.VALID
        if not valid or LOST in self.counted:
            return None
        return abs(self.after.cycles - self.before.cycles)


def look_at(module: NodeAccess) -> Look | None:
    try:
        return Look(
            module.integer(*od.FEEDBACK_STATUS, "H"),
            module.integer(*od.FEEDBACK_CYCLE_COUNT, "q"),
            read_counters(module),
        )
    except CommissioningError:
        return None


def lost_words(module: NodeAccess, status: int) -> str:
    causes = od.fault_words(status)
    why = f" ({', '.join(causes)})" if causes else ""
    return (
        f"the position of {module.name} is lost{why}: canfb why {module.node_id:#04x} says why and what to do"
    )


@dataclass(frozen=True)
class SpeedReading:
    """A speed of the module; ``at``: intervals after the first sample."""

    at: float
    rad_per_s: float


class SpeedReadings:
    """Reads the speed of the module periodically. CommissioningError without a valid position."""

    def __init__(self, module: NodeAccess) -> None:
        self._module = module
        self._next_s = 0.0
        self.found: list[SpeedReading] = []

    def __call__(self, listening: Listener) -> bool:
        if listening.elapsed_s < self._next_s or not listening.intervals:
            return False
        self._next_s = listening.elapsed_s + READINGS_EVERY_S
        before, speed = listening.intervals, self.read()
        per_sync = 1 + len(listening.recorder.layout.earlier)
        self.found.append(SpeedReading(per_sync * (before + listening.intervals) / 2.0, speed))
        return False

    def read(self) -> float:
        check_valid(self._module)
        speed = float(self._module.read(*od.FEEDBACK_VELOCITY, "f"))
        if not math.isfinite(speed):
            raise CommissioningError(f"{self._module.name}: its speed (2011:07) is {speed}")
        return speed


def check_valid(module: NodeAccess) -> None:
    """CommissioningError unless the position is valid."""
    status = module.integer(*od.FEEDBACK_STATUS, "H")
    if status & od.StatusBit.LOST:
        raise CommissioningError(
            f"{module.name}: the position is lost (2011:01), so its speed is not known: canfb why "
            f"{module.node_id:#04x} says why, and what brings it back"
        )
    if not status & (od.StatusBit.VALID | od.StatusBit.COASTING):
        raise CommissioningError(
            f"{module.name} has no valid position (2011:01 is {status:04X}h): it must be OPERATIONAL "
            f"(NMT start, canfb node start {module.node_id:#04x}), and must receive SYNC and samples"
        )


def read_counters(module: NodeAccess) -> dict[str, int]:
    values = {name: module.read_known(place) for name, place in COUNTERS.items()}
    return {name: int(value) for name, value in values.items() if value is not None}


def counted(before: Mapping[str, int], after: Mapping[str, int]) -> dict[str, int]:
    steps = {name: (after[name] - count) % U32 for name, count in before.items() if name in after}
    return {name: step for name, step in steps.items() if step}


def watch(
    module: NodeAccess,
    duration_s: float,
    usual: Mapping[str, int],
    usual_s: float,
    progress: Progress = lambda part: None,
) -> None:
    """Observe the module with new limits. CommissioningError if it flags more than ``usual`` (counts in
    ``usual_s``), or processes no samples.
    """
    master = module.master
    began, first = master.now(), read_counters(module)
    samples = module.integer(*od.FEEDBACK_SAMPLES, "I")
    while True:
        passed = master.now() - began
        allowed = {name: MORE_THAN_BEFORE * (known * passed / usual_s + 1.0) for name, known in usual.items()}
        flagged = counted(first, read_counters(module))
        more = {name: count for name, count in flagged.items() if count > allowed.get(name, 0.0)}
        if more:
            raise CommissioningError(
                f"{module.name} flags samples with the new limits that it did not flag before: "
                f"{in_words(more)}"
            )
        progress(min(1.0, passed / duration_s))
        left = began + duration_s - master.now()
        if left < SHORTEST_S:
            break
        master.wait(min(READINGS_EVERY_S, left))
    check_valid(module)
    if module.integer(*od.FEEDBACK_SAMPLES, "I") == samples:
        raise CommissioningError(f"{module.name} has processed no sample with the new limits (2011:08)")


def in_words(counts: Mapping[str, int]) -> str:
    """E.g. "3 residual, 1 amplitude"."""
    return ", ".join(f"{count} {name}" for name, count in counts.items())


ARC_SECONDS = 360.0 * 3600.0
PERCENT = 100.0


@dataclass(frozen=True)
class Provenance:
    """Where and when a measurement was taken; "" or None: not known.

    date, time      ISO 8601; time of day with the offset to UTC
    identity        1018h: vendor-ID, product code, revision, serial number
    encoder         as the user named it
    meanwhile       the module before and after
    """

    date: str
    module: int | None = None
    encoder_interface: int | None = None
    encoder: str = ""
    cycles_per_revolution: int | None = None
    time: str = ""
    version: str = ""
    command: str = ""
    identity: tuple[int, ...] | None = None
    interface_identity: tuple[int, ...] | None = None
    meanwhile: Meanwhile | None = None

    @classmethod
    def of_run(cls, date: str, command: str, **known: Any) -> Provenance:
        """For a run of ``command``; ``date`` is ISO 8601, with a space before the time."""
        day, _, time = date.partition(" ")
        return cls(day, time=time, version=version("canfb"), command=command, **known)

    def arc_seconds(self, cycles: float) -> float | None:
        """``cycles`` as an angle of the shaft."""
        return cycles * ARC_SECONDS / self.cycles_per_revolution if self.cycles_per_revolution else None


def origins(where: Provenance) -> list[Row]:
    module, interface = where.module, where.encoder_interface
    return [
        Row("module", None if module is None else _node(module, where.identity)),
        Row("encoder interface", None if interface is None else _node(interface, where.interface_identity)),
        Row("program", f"canfb {where.version}" if where.version else None),
        Row("command", where.command or None),
    ]


def _node(node_id: int, identity: tuple[int, ...] | None) -> str:
    words = f"{node_id} ({node_id:02X}h)"
    if identity is None:
        return words
    named = zip(("vendor", "product", "revision", "serial number"), identity, strict=False)
    return f"{words}; {', '.join(f'{name} {number}' for name, number in named)} (1018h)"


def where_words(where: Provenance) -> dict[str, Any]:
    return {
        "date": where.date,
        "time": where.time or None,
        "canfb": where.version or None,
        "command": where.command or None,
        "encoder": where.encoder or None,
        "module": where.module,
        "module_identity": where.identity and list(where.identity),
        "encoder_interface": where.encoder_interface,
        "encoder_interface_identity": where.interface_identity and list(where.interface_identity),
        "cycles_per_revolution": where.cycles_per_revolution,
    }


def percent(cycles: float, where: Provenance) -> str:
    arc = where.arc_seconds(cycles)
    words = f"{PERCENT * cycles:.3g} %"
    return words if arc is None else f"{words} ({arc:.2g}″)"
