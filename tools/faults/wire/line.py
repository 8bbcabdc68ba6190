"""The wire: SYNCs, samples and frames of the interface, receivers and receive times of frames.

A :class:`Plan` describes each SYNC slot. :func:`lay` converts it to the events that the module receives,
each at its true receive time, and to the true position of each sample.
Times in T; ``Plan.us`` converts microseconds.
"""

import math
import struct
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import numpy as np

from canfb import Frame
from tools.faults.machine import Motion, counts, within_half
from tools.faults.wire.setups import (
    ADC_ID,
    CYCLES_PER_REVOLUTION,
    EXTRA_ID,
    NMT_ID,
    NODE,
    SDO_RX,
    SECOND_INCREMENTS,
    SYNC_ID,
    TIMES_ID,
    Options,
    Setup,
    configuration,
    sdo_read,
)

TICK_S = 1e-7
U32 = 0xFFFFFFFF
SAMPLE_LATENCY_US = 20.0  # from the end of the SYNC to the sampling instant
TIMES_LATER_US = 60.0  # from a PDO of the interface to the next one
LATEST_PDO = 0.45  # longest time from SYNC to PDO on a healthy wire, T
AMPLITUDE_COUNTS = COARSE_COUNTS = 1500.0
FIRST_PULSE = 40.0  # position of the first zero pulse, cycles
INSTANTS = 65  # instants of an interval between which the motion is interpolated linearly


@dataclass
class Slot:
    """How one SYNC and its ADC PDO are sent, delayed or lost."""

    produced: bool = True
    to_module: bool = True
    to_interface: bool = True
    late_us: float = 0.0  # delay of the SYNC itself, in addition to its jitter
    payload: bytes | None = None  # data of the SYNC; None: as in the set-up
    again: list[tuple[float, bool, bool]] = field(default_factory=list)  # us later, to module, to interface
    sample_late_us: float = 0.0  # delay of the sampling instant
    pdo_lost: bool = False
    times_lost: bool = False  # the PDO with the sample time is lost, if that is a separate one
    pdo_late_us: float = 0.0
    pdo_again_us: list[float] = field(default_factory=list)
    extra_lost: bool = False
    extra_again_us: list[float] = field(default_factory=list)
    false_pulse: float | None = None  # place of a false zero pulse in the interval, 0..1
    stamp: int | None = None  # replaces the sample time
    stamp_add: int = 0  # error of the sample time, ticks
    foreign_us: float | None = None  # time after the SYNC of a foreign PDO with random counts


class Event(NamedTuple):
    """One frame at the module, or an action of its controller."""

    time: float  # true receive time, T
    what: str  # sync, part (of a sample), pdo (completes it), extra, foreign, sdo, nmt, bus_off, bus_back
    frame: Frame | None
    number: int  # number of the slot for sync and foreign, of the sample for pdo and extra


class Sent(NamedTuple):
    now: float  # time, T
    cause: Event | None  # None: a timer
    frame: Frame
    newest: int  # number of the newest sample that the module has received; -1: none


@dataclass
class Plan:
    setup: Setup
    options: Options
    motion: Motion
    rng: np.random.Generator
    slots: list[Slot]
    fault: int  # slot of the fault
    jitter_us: float = 0.0  # jitter of the SYNC, rms (gaussian) or half width (uniform)
    gaussian: bool = False
    busy: float = 0.3  # part of the SYNCs that wait for a frame on the bus
    locked: bool = False  # the interface samples by a timer locked to SYNC, so without jitter
    drift: float = 0.0
    host: str = "quick"
    stalls: list[tuple[float, float]] = field(default_factory=list)
    actions: list[tuple[float, str, bytes]] = field(default_factory=list)  # time, kind of event, data
    reads: list[float] = field(default_factory=list)
    accelerating: bool = False  # the machine accelerates at the fault, up to its limit
    bad_rx: float = 0.0  # part of the receive times that are wrong
    tolerance: float = 0.5  # largest error of a correct position, cycles
    note: str = ""  # P1, P2, ...: why a wrong position is undetectable (tools/faults/wire/README.md)

    @property
    def us(self) -> float:
        """One microsecond in T."""
        return 1e-6 / self.options.interval_s

    @property
    def end(self) -> float:
        """End of the episode, T."""
        return float(len(self.slots))


@dataclass
class Line:
    """Result of a plan: events in the order of reception, and the truth."""

    events: list[Event]
    sample_times: list[float]
    sample_slots: list[int]
    positions: list[float]
    named: list[float]  # instants according to the sample times


class _Sampling(NamedTuple):
    slot: int
    heard: float
    time: float


def lay(plan: Plan) -> Line:
    events: list[Event] = []
    samplings: list[_Sampling] = []
    for number, at in enumerate(_sync_times(plan)):
        slot = plan.slots[number]
        if not slot.produced:
            continue
        payload = bytes([number % plan.options.overflow + 1]) if plan.setup.counter else b""
        frame = Frame(SYNC_ID, payload if slot.payload is None else slot.payload)
        copies = [(0.0, slot.to_module, slot.to_interface), *slot.again]
        for later_us, to_module, to_interface in copies:
            heard = at + later_us * plan.us
            if to_module:
                events.append(Event(heard, "sync", frame, number))
            if to_interface:
                nominal = number + 1.0 if plan.locked and later_us == 0.0 else heard
                time = nominal + (SAMPLE_LATENCY_US + slot.sample_late_us) * plan.us
                samplings.append(_Sampling(number, max(heard, nominal), time))
    positions = plan.motion.at([one.time for one in samplings])
    named = _send_samples(plan, samplings, positions, events)
    _send_foreign(plan, events)
    for at in plan.reads:
        events.append(Event(at, "sdo", sdo_read(0x2011, 1), 0))
        events.append(Event(at, "sdo", sdo_read(0x6004, 0), 0))
    for at, what, data in plan.actions:
        if what == "configure":
            frames = configuration(plan.setup, plan.options)
            events += [Event(at, "sdo", one, 0) for one in frames]
            continue
        commands = {"nmt": Frame(NMT_ID, data + bytes([NODE])), "write": Frame(SDO_RX, data)}
        events.append(Event(at, what, commands.get(what), 0))
    events.sort(key=lambda one: one.time)  # stable: events of equal time keep their order
    times, slots = [one.time for one in samplings], [one.slot for one in samplings]
    return Line(events, times, slots, positions.tolist(), named)


def _sync_times(plan: Plan) -> list[float]:
    n, rng = len(plan.slots), plan.rng
    if plan.gaussian:
        jitter = rng.normal(0.0, plan.jitter_us, n)
    else:
        jitter = rng.uniform(-plan.jitter_us, plan.jitter_us, n)
    blocked = np.where(rng.uniform(size=n) < plan.busy, rng.uniform(0.0, 135.0, n), 0.0)
    if plan.jitter_us == 0.0 and not plan.locked:
        blocked[:] = 0.0
    # The SYNC jitters about 1, 2, 3, ... T by less than half a period; more would be another fault.
    late = np.array([slot.late_us for slot in plan.slots])
    jitter = np.clip((jitter + blocked) * plan.us, -0.45, 0.45) + late * plan.us
    times: list[float] = (np.arange(1.0, n + 1.0) + jitter).tolist()
    return times


def _send_samples(
    plan: Plan, samplings: list[_Sampling], positions: np.ndarray, events: list[Event]
) -> list[float]:
    """Add the PDOs of the samples; returns the instants according to their sample times."""
    rng, us, exact = plan.rng, plan.us, plan.options.exact
    named = [one.time for one in samplings]
    tracks = partial(counts, rng=rng, exact=exact, amplitude=AMPLITUDE_COUNTS, most_noise=math.inf)
    sine, cosine = tracks(positions)
    # The clock of the interface determines the instants of earlier pairs, relative to the newest.
    apart = np.diff(named, prepend=named[0] - 1.0) if plan.options.follows else 1.0
    pairs = plan.setup.servo
    earlier = [tracks(plan.motion.at(np.subtract(named, k / pairs * apart))) for k in range(1, pairs)]
    offset = int(rng.integers(1 << 32))
    if rng.integers(3) == 0:  # the clock of the interface wraps during the episode
        offset = (1 << 32) - int(rng.uniform(0.0, plan.end * plan.options.interval_s / TICK_S))
    busy = rng.uniform(size=len(samplings)) < plan.busy
    # 95 us for the frame, some work, and possibly a frame before it; at short intervals less of all.
    work, blocked = rng.uniform(140.0, 220.0, len(samplings)), rng.uniform(0.0, 135.0, len(samplings))
    latest = LATEST_PDO * rng.uniform(0.8, 1.0, len(samplings))
    waits = np.minimum((work + busy * blocked) * us, latest).tolist()
    free = 0.0  # time from which the interface can send: its PDOs keep their order
    for n, one in enumerate(samplings):
        slot = plan.slots[one.slot]
        data = struct.pack("<hh", sine[n], cosine[n])
        stamp = b""
        if plan.setup.times:
            true_s = one.time * plan.options.interval_s
            tick = math.floor(true_s * (1.0 + plan.drift) / TICK_S) + offset
            shown = tick + slot.stamp_add if slot.stamp is None else slot.stamp
            named[n] += within_half(shown - tick, 1 << 32) * TICK_S / plan.options.interval_s
            stamp = struct.pack("<I", shown & U32)
        parts = [struct.pack("<hh", sines[n], cosines[n]) for sines, cosines in earlier] or [stamp]
        sent = max(one.heard + waits[n] + slot.sample_late_us * us, free)
        free = sent + 60.0 * us
        sent += slot.pdo_late_us * us
        if not slot.pdo_lost:
            for later in (0.0, *slot.pdo_again_us):
                what = "part" if pairs and plan.setup.times else "pdo"
                events.append(Event(sent + later * us, what, Frame(ADC_ID, data + parts[0]), n))
                if what == "part" and not slot.times_lost:
                    at = sent + (later + TIMES_LATER_US) * us
                    events.append(Event(at, "pdo", Frame(TIMES_ID, b"".join(parts[1:]) + stamp), n))
        extra = _extra(plan, slot, samplings[n - 1].time if n else 0.0, one.time)
        if extra and not slot.extra_lost:
            for later in (0.0, *slot.extra_again_us):
                at = sent + (70.0 + later) * us
                events.append(Event(at, "extra", Frame(EXTRA_ID, extra), n))
    return named


def _send_foreign(plan: Plan, events: list[Event]) -> None:
    for number, slot in enumerate(plan.slots):
        if slot.foreign_us is not None:
            data = plan.rng.integers(-1500, 1500, 4 if plan.setup.servo else 2).astype("<i2").tobytes()
            if plan.setup.times and not plan.setup.servo:
                data += plan.rng.bytes(4)
            at = number + 1.0 + slot.foreign_us * plan.us
            events.append(Event(at, "foreign", Frame(ADC_ID, data), number))


def _extra(plan: Plan, slot: Slot, before: float, here: float) -> bytes:
    """Data of RPDO2 for a sample at time ``here``: coarse track, zero pulse, second position."""
    data = b""
    if plan.options.coarse:
        angle = 2.0 * math.pi * (plan.motion.at([here])[0] / CYCLES_PER_REVOLUTION % 1.0)
        data = struct.pack(
            "<hh", round(COARSE_COUNTS * math.sin(angle)), round(COARSE_COUNTS * math.cos(angle))
        )
    if plan.options.extra:
        place = _zero_pulse(plan.motion, before, here) if slot.false_pulse is None else slot.false_pulse
        data += struct.pack("<BH", 0, 0) if place is None else struct.pack("<BH", 1, int(place * 65536))
    if plan.options.second:
        revolutions = float(plan.motion.at([here])[0]) / CYCLES_PER_REVOLUTION
        data += struct.pack("<I", round(revolutions * SECOND_INCREMENTS) & U32)
    return data


def _zero_pulse(motion: Motion, before: float, here: float) -> float | None:
    """Place of the zero pulse between these two times, 0..1; pulses at FIRST_PULSE, then every revolution."""
    begin, end = motion.at([before, here]).tolist()
    low, high = sorted((begin - FIRST_PULSE, end - FIRST_PULSE))
    turn = math.floor(high / CYCLES_PER_REVOLUTION) * CYCLES_PER_REVOLUTION
    if not low < turn <= high:
        return None
    away = motion.at(np.linspace(before, here, INSTANTS)) - (turn + FIRST_PULSE)
    crossed = int(np.flatnonzero(np.sign(away[1:]) != np.sign(away[0]))[0])
    part = away[crossed] / (away[crossed] - away[crossed + 1])
    return min(float(crossed + part) / (INSTANTS - 1), 65535 / 65536)
