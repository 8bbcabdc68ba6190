"""Several samples for each SYNC, from the encoder interface to the position, on a bus with jitter."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from canfb import Feedback, FeedbackModule, Frame, ModuleConfig, objects as od
from canfb.interface.encoder_interface import EncoderInterface
from canfb.signal.conditioning import IDENTITY
from canfb.signal.correction import Correction
from canfb.simulation.encoder import Encoder, Motion, MotionSource, Ramp, ShaftEncoder
from folding import each
from servo_kit import IDEAL_TABLE, s_curve

N, PERIOD_S, START_S = 2500, 1e-3, 1.0
SYNC = b""


class Servo:
    """At rest for 0.2 s, then 0 to 3000 rpm in 50 ms."""

    def revolutions(self, time_s: float) -> float:
        return float(self.revolutions_at(np.array([time_s]))[0])

    def revolutions_at(self, times_s: np.ndarray) -> np.ndarray:
        return s_curve(100.0 * math.pi, 7850.0, 785e3, times_s - 0.2) / (2.0 * math.pi)


class Bus:
    """The interface, its module, and a master whose SYNC jitters."""

    def __init__(self, jitter_s: float = 0.0, seed: int = 1, **config: float) -> None:
        values = {"node_id": 32, "times": True, "autostart": True, **config}
        self.module = FeedbackModule(ModuleConfig(**values))  # type: ignore[arg-type]
        self.source = MotionSource(ShaftEncoder(Encoder(noise_lsb=0.5), N, seed), Servo(), PERIOD_S)
        words: Any = {name: values[name] for name in ("autostart", "times", "samples_per_sync")}
        self.interface = EncoderInterface(16, self.source, **words)
        self._rng, self._jitter_s, self._syncs = np.random.default_rng(seed), jitter_s, 0.0
        self.deliver: Callable[[Frame], bool] = lambda frame: True
        self.interface.start(0.0)
        self.module.start(0.0)
        self.module.use_correction(Correction(IDEAL_TABLE, IDENTITY))

    def sync(self, rate: float = 1.0, heard: bool = True) -> Feedback | None:
        now = START_S + self._syncs * PERIOD_S + self._rng.uniform(-self._jitter_s, self._jitter_s)
        self._syncs += rate
        pdos = self.interface.receive(Frame(0x80, SYNC, timestamp=now), now)
        self.module.tick(now)
        if heard:
            self.module.receive(Frame(0x80, SYNC, timestamp=now), now)
        for number, frame in enumerate(filter(self.deliver, pdos)):
            came = now + 130e-6 * (number + 1)
            self.module.receive(Frame(frame.can_id, frame.data, timestamp=came), came)
        return self.module.feedback

    def run(self, syncs: int) -> Feedback | None:
        return [self.sync() for _ in range(syncs)][-1]

    def read(self, place: tuple[int, int]) -> float:
        return float(self.module.dictionary.entry(*place).current())


def away(bus: Bus, got: Feedback) -> float:
    return got.cycles + got.phase - bus.source.position_cycles


def followed(bus: Bus, syncs: int) -> list[tuple[Feedback, float]]:
    """What comes of so many SYNCs from the fourth sample on, and how far it is from the machine."""
    return [(got, away(bus, got)) for _ in range(syncs) if (got := bus.sync()) and got.samples > 3]


@each("jitter_s, per_sync, residual", [
    *((jitter_s, *case) for jitter_s in (0.0, 5e-5) for case in [(4, 0.204), (5, 0.134), (7, 0.073)]),
    (0.0, 8, 0.049),  # 7850 rad/s^2 at 8 kHz; the PDOs have no room for a time
])  # fmt: skip
def test_a_servo_move_over_a_bus_with_jitter(per_sync: int, residual: float, jitter_s: float) -> None:
    bus = Bus(jitter_s, samples_per_sync=per_sync, times=per_sync < 8)
    largest, first = 0.0, None
    for _ in range(400):
        got = bus.sync()
        if got is None or got.samples < (4 if per_sync < 8 else 40):
            continue
        first = away(bus, got) if first is None else first
        assert got.valid
        assert away(bus, got) == pytest.approx(first, abs=0.1)
        largest = max(largest, *(one.residual for one in (*bus.module.chain.between, got)))
    assert bus.module.interval_s == pytest.approx(PERIOD_S / per_sync, rel=1e-2)
    assert largest == pytest.approx(residual, rel=0.08)
    assert [bus.read((0x2012, sub)) for sub in (1, 2, 3, 4, 5, 8)] == [0] * 6


@each("said_us", [700, 1300, 1500, 3000])
def test_a_1006h_that_is_wrong_is_not_the_interval_of_the_sample_times(said_us: int) -> None:
    bus = Bus(1e-4, samples_per_sync=4, sync_jitter_s=3e-4)
    bus.module.dictionary.entry(0x1006).value = said_us
    found = followed(bus, 400)
    off = [off for got, off in found if got.valid]
    assert found[-1][0].valid
    assert len(off) > 350
    assert off == pytest.approx([off[0]] * len(off), abs=0.1)
    assert bus.module.interval_s == pytest.approx(PERIOD_S / 4, rel=1e-2)


@each("per_sync", [4, 7])
@each("times", [False, True])
def test_speed_and_acceleration_are_those_of_the_machine(per_sync: int, times: bool) -> None:
    bus = Bus(samples_per_sync=per_sync, times=times)
    bus.run(227)  # the acceleration is constant between 10 and 40 ms of the move
    speed, acceleration = bus.read(od.FEEDBACK_VELOCITY), bus.read(od.FEEDBACK_ACCELERATION)
    newest_s = START_S + 226 * PERIOD_S - PERIOD_S / 16.0
    between_s = bus.source.machine_time(newest_s) - PERIOD_S / per_sync / 2.0
    assert speed == pytest.approx(7850.0 * (between_s - 0.2 - 0.005), rel=0.01)
    assert acceleration == pytest.approx(7850.0, rel=0.05)


def test_the_mapping_says_how_many_samples_there_are() -> None:
    module = Bus(samples_per_sync=3).module
    entry = module.dictionary.entry
    assert [entry(od.RPDO_MAPPING, sub).value for sub in range(5)] == [
        4, 0x20000110, 0x20000210, 0x20000810, 0x20000910,
    ]  # fmt: skip
    more = [entry(od.RPDO_MAPPING + 1, sub).value for sub in range(4)]
    assert more == [3, 0x20000A10, 0x20000B10, 0x20000520]
    assert [entry(od.RPDO + number, 1).value for number in range(2)] == [0x190, 0x290]
    assert Bus(samples_per_sync=8, times=False).read((od.RPDO + 3, 1)) == 0x490
    assert module.limits.samples_per_sync == 3


@pytest.mark.parametrize("lost_id", [0x190, 0x290])
def test_a_sample_with_a_lost_pdo_is_missed_as_a_whole(lost_id: int) -> None:
    bus = Bus(samples_per_sync=2, max_acceleration_rad_s2=100.0)
    bus.run(150)
    bus.deliver = lambda frame: frame.can_id != lost_id
    bus.sync()
    bus.deliver = lambda frame: True
    got = bus.run(20)
    assert got is not None
    assert got.valid
    assert bus.read(od.COUNTER_MISSED) == 1
    assert away(bus, got) == pytest.approx(round(away(bus, got)), abs=0.1)
    bus.deliver = lambda frame: False
    bus.run(10)
    assert bus.read(od.COUNTER_LOSS_BAD) == 2 * 4, "2010:03 is 3 SYNCs: the fourth is too many"


def test_a_first_sample_that_answers_a_sync_before_operational_misses_none() -> None:
    bus = Bus(samples_per_sync=3)
    bus.source.motion = Motion((), start_rpm=18.0)  # a quarter of a cycle per sample
    found = [(got, away(bus, got)) for n in range(9) if (got := bus.sync(heard=n > 1))]
    assert all(got.valid and abs(off) < 0.1 for got, off in found)


def test_without_times_and_with_jitter_it_is_never_wrong() -> None:
    bus = Bus(5e-5, samples_per_sync=2, times=False)
    found = followed(bus, 400)
    assert all(not got.valid or abs(off - found[0][1]) < 0.4 for got, off in found)


@each("jitter_s, kept", [(5e-5, True), (1e-4, False)])
def test_without_times_a_sync_that_is_early_costs_its_sample(jitter_s: float, kept: bool) -> None:
    """By more than 20 us and 0.3 of the answer delay, which is 130 us here."""
    bus = Bus(jitter_s, samples_per_sync=2, times=False)
    bus.source.motion = Motion([Ramp(0.3, 0.0), Ramp(0.5, 60.0)])
    found = followed(bus, 1000)[80:]
    assert all(got.valid for got, _ in found) is kept
    assert all(abs(off - found[0][1]) < 0.4 for got, off in found if got.valid)


@each("per_sync", [4, 8])
def test_a_sync_that_is_early_before_the_interface_knows_its_grid_has_its_samples(per_sync: int) -> None:
    bus = Bus(1.5e-4, samples_per_sync=per_sync, times=False)
    bus.source.motion = Motion(())
    got = [bus.sync() for _ in range(64)]
    assert all(one is not None and one.valid for one in got[1:])


@each("per_sync, rate", [(2, 0.5), *((n, rate) for n in (2, 3) for rate in (0.9, 1.02, 1.1, 2.0))])
@each("times", [False, True])
def test_at_rest_sync_may_come_at_another_rate(per_sync: int, times: bool, rate: float) -> None:
    bus = Bus(samples_per_sync=per_sync, times=times)
    bus.source.motion = Motion(())
    for n in range(400):
        got = bus.sync(1.0 if n < 200 else rate)
    assert got is not None
    assert got.valid
