"""Object 2002h: drifting tracks are followed, shown and kept; the delays of the analog path are removed."""

import math
import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from module_bench import Bench

from canfb import AdaptConfig, Conditioning, FeedbackModule, Frame
from canfb.configuration import parse_config
from canfb.device.storage.storage import MemoryStore
from canfb.objects import AdaptationState as State, StatusBit
from canfb.signal.correction import Correction
from folding import each
from ideal_tracks import adc_pdo
from servo_kit import IDEAL_TABLE

# The truth of the encoder below. No harmonics are known, so that the first samples are the reference.
CALIBRATED = Conditioning(40.0, -30.0, 1.0, 1.0, 0.02)
AMPLITUDE = 1500.0
DRIFT, CODE = 1 << 13, 0xFF1D
UNITS = 8192
FAST = AdaptConfig(rate_per_hour=10.0)


class Turning(Bench):
    """A machine that turns, whose tracks drift; an hour has so few of its samples that they learn fast."""

    def __init__(
        self, store: MemoryStore | None = None, adapt: AdaptConfig | bool = FAST, **fields: Any
    ) -> None:
        super().__init__(store, conditioning=CALIBRATED, adapt=adapt, phase_error_cycles=0.05, **fields)
        self.interval_s = 4e-3
        self.place = self.speed = 0.0
        self.sine_offset = self.cosine_offset = self.gain = 0.0
        self.rng = np.random.default_rng(1)

    def calibrate(self) -> None:
        self.module.use_correction(Correction(IDEAL_TABLE, CALIBRATED))

    def pair(self) -> tuple[int, int]:
        angle = 2.0 * math.pi * (self.place % 1.0)
        sine = AMPLITUDE * ((1.0 + self.gain) * math.sin(angle) + self.sine_offset) + 40.0
        cosine = AMPLITUDE * (math.cos(angle - 0.02) + self.cosine_offset) - 30.0
        noise = self.rng.normal(0.0, 0.5, 2)
        return round(sine + noise[0]), round(cosine + noise[1])

    def turn(self, samples: int, speed: float = 3.1371) -> list[float]:
        """Errors of 6004h, cycles, without whole ones; all samples are valid."""
        errors = []
        for _ in range(samples):
            self.speed += max(-0.05, min(speed - self.speed, 0.05))
            self.place += self.speed
            self.sync()
            units, status, _ = self.position(self.counts(*self.pair()))
            assert status & 1
            errors.append(units / UNITS - self.place)
        return list((np.array(errors) + 0.5) % 1.0 - 0.5)

    def drift(self) -> tuple[float, ...]:
        """2002:0F..12."""
        return tuple(self.sdo[0x2002][subindex].raw for subindex in range(15, 19))

    def warnings(self) -> list[tuple[int, int]]:
        """Code and 6505h of each EMCY."""
        frames = [frame.data for frame in self.heard if frame.can_id == 0xA0]
        return [(code, bits) for code, _, bits in (struct.unpack_from("<HBH", data) for data in frames)]


def machine(store: MemoryStore | None = None, **fields: Any) -> Turning:
    turning = Turning(store, **fields)
    turning.start()
    turning.calibrate()
    turning.turn(2000)
    return turning


def test_the_drift_is_followed_and_shown() -> None:
    one = machine()
    assert one.sdo[0x2002][13].raw == State.FOLLOWING
    before = np.std(one.turn(500))
    for step in range(1, 21):
        one.sine_offset, one.gain = 0.002 * step, -0.002 * step
        errors = one.turn(250)
    errors = one.turn(1500)[-500:]
    assert np.std(errors) < before + 0.0002
    sine, cosine, gain, phase = one.drift()
    assert sine == pytest.approx(0.04 * AMPLITUDE, rel=0.05)
    assert gain == pytest.approx(-0.04, rel=0.1)
    assert abs(cosine) < 0.002 * AMPLITUDE
    assert abs(phase) < 0.002
    assert one.sdo[0x2002][14].raw == pytest.approx(100 * 0.04 / 0.15, abs=3)
    # The conditioning is that of the calibration, and the recording has the counts of the converter.
    assert one.sdo[0x2002][1].raw == 40.0
    one.sdo[0x2002][8].raw = 0
    assert one.drift() == (0.0, 0.0, 0.0, 0.0)
    assert one.sdo[0x2002][13].raw == State.OFF
    assert np.std(one.turn(500)) > 0.004


def test_the_limit_is_a_warning_until_it_is_not_reached() -> None:
    one = machine(adapt=AdaptConfig(offset=0.02, rate_per_hour=10.0))
    one.sdo[0x2004][2].raw = 100
    one.sine_offset = 0.015
    one.turn(3000)
    assert one.sdo[0x6505].raw == 0
    one.sine_offset = 0.03
    one.turn(2000)
    assert one.sdo[0x6505].raw == DRIFT
    assert one.sdo[0x2002][13].raw == State.AT_LIMIT
    assert one.sdo[0x2002][14].raw >= 100
    assert one.warnings() == [(CODE, DRIFT)]
    one.sine_offset = 0.0
    one.turn(5000)
    assert one.sdo[0x6505].raw == 0
    assert [code for code, _ in one.warnings()] == [CODE, 0]


def test_save_keeps_the_drift_and_an_activation_ends_it() -> None:
    calibrated_32 = Conditioning(40.0, -30.0, 1.0, 1.0, float(np.float32(0.02)))
    store = MemoryStore()
    one = machine(store)
    one.sine_offset = 0.02
    one.turn(4000)
    found = one.drift()
    assert found[0] > 0.015 * AMPLITUDE
    one.sdo.download(0x1010, 4, b"save")
    one.turn(10)
    again = Turning(store, adapt=False)  # saved values take precedence
    again.start()
    assert again.drift() == pytest.approx(found, rel=1e-6)
    assert again.module.chain.correction == Correction(IDEAL_TABLE, calibrated_32)
    assert again.sdo[0x2002][13].raw == State.WAITING
    again.sine_offset = 0.02
    assert np.std(again.turn(600)[100:]) < 0.0008
    again.sdo[0x2020][3].raw = IDEAL_TABLE.crc32
    assert again.drift() == (0.0, 0.0, 0.0, 0.0)
    again.remote.nmt.send_command(0x81)
    assert again.drift() == pytest.approx(found, rel=1e-6)
    again.sdo.download(0x1011, 4, b"load")
    again.remote.nmt.send_command(0x81)
    assert again.drift() == (0.0, 0.0, 0.0, 0.0)


def test_samples_that_nobody_confirms_are_not_learned() -> None:
    """After a pause the position is withheld, and with it what was taken before."""
    one = machine(coast_samples=20)
    sectors = one.module.chain.adaptation
    one.turn(200, 0.0)
    one.turn(3)
    one.start("PRE-OPERATIONAL")
    one.sync()
    one.counts(*one.pair())
    assert not one.module.feedback or not one.module.feedback.valid
    assert sectors._sectors.taken == 0


@each(
    "text, expected",
    [
        ("true", (1, 150, 250, 50, 500)),
        ("false", (0, 150, 250, 50, 500)),
        ("{}", (1, 150, 250, 50, 500)),
        ("{offset: 0.1, gain: 0.0001, phase_rad: 0, rate_per_hour: 2}", (1, 100, 1, 0, 2000)),
    ],
)
def test_the_key(text: str, expected: tuple[int, ...]) -> None:
    module = FeedbackModule(parse_config(f"modules:\n- {{node_id: 3, adapt: {text}}}\n").modules[0])
    assert tuple(module.dictionary.entry(0x2002, n).value for n in range(8, 13)) == expected


def test_several_samples_for_each_sync() -> None:
    bench = Turning(samples_per_sync=2)
    bench.start()
    bench.calibrate()

    def run(syncs: int) -> None:
        for _ in range(syncs):
            bench.speed = min(bench.speed + 0.002, 0.6137)
            bench.place += bench.speed
            earlier = bench.pair()
            bench.place += bench.speed
            bench.sync()
            bench.sent(Frame(0x190, struct.pack("<hhhh", *bench.pair(), *earlier)))

    run(6000)
    bench.sine_offset = 0.02
    run(10000)
    assert bench.drift()[0] == pytest.approx(0.02 * AMPLITUDE, rel=0.15)


INTERVAL_S, ADC_S = 1e-3, 2e-4
QUANTUM = 1.5 / UNITS + 1e-4  # of the position, and of a converter of 16 bits at 0.7 of its range
Motion = Callable[[float], float]


class Machine(Bench):
    """A module and its encoder; the analog path is a delay of both tracks."""

    def __init__(self, position: Motion, lag_s: float = 0.0, **fields: Any) -> None:
        super().__init__(adc_bits=16, **fields)
        self.place_at, self.lag_s = position, lag_s
        self.module.use_correction(Correction(IDEAL_TABLE, self.module.config.conditioning))
        self.interval_s, self.now = INTERVAL_S - ADC_S, 0.0
        self.start()

    def sample(self) -> tuple[float, int]:
        """One SYNC and its sample: error of 6004h against the position at the SYNC, cycles; status."""
        sent = self.sync()
        self.now = now = self.bus.now
        pdo = adc_pdo(self.place_at(now - self.lag_s), 23000.0, now if self.module.config.times else None)
        self.bus.run_until(now + ADC_S)
        units, status, _ = self.position(sent + self.sent(pdo))
        away = units / UNITS - self.place_at(now)
        turns = 2500 * 209
        return (away + turns / 2) % turns - turns / 2, status

    def run(self, samples: int) -> np.ndarray:
        """Errors of so many samples, all valid; the whole cycles of the start are taken away."""
        found = [self.sample() for _ in range(samples)]
        assert all(status & StatusBit.VALID for _, status in found)
        errors = np.array([error for error, _ in found])
        return errors - np.round(errors[0])


def accelerating(top: float, acceleration: float = 0.1) -> Motion:
    """From standstill to ``top`` cycles per interval, by so many cycles per interval^2."""
    until = top / acceleration * INTERVAL_S

    def position(now: float) -> float:
        if now < until:
            return 0.5 * acceleration * (max(now, 0.0) / INTERVAL_S) ** 2 + 0.3
        return top * (now - until / 2.0) / INTERVAL_S + 0.3

    return position


@each("lag_s", [1.27e-6, -1e-6, 1e-4, 1.3e-3])
@each("fields", [{}, {"times": True}, {"times": True, "nominal_sync": True}])
def test_the_position_is_that_of_the_sync(fields: dict[str, Any], lag_s: float) -> None:
    """Also while the machine accelerates, but for the interval in which that begins or ends."""
    machine = Machine(accelerating(40.037), lag_s=lag_s, conditioning=Conditioning(delay_s=lag_s), **fields)
    errors = machine.run(1000)
    kinks = 0.12 * (1.0 + lag_s / INTERVAL_S) ** 2
    assert np.abs(errors).max() < QUANTUM + kinks
    steady = np.r_[errors[20:390], errors[410:]]
    assert np.abs(steady).max() < QUANTUM + 4e-4 * lag_s / INTERVAL_S
    late = Machine(accelerating(40.037), lag_s=lag_s, **fields).run(1000)
    assert late[-1] == pytest.approx(-40.037 * lag_s / INTERVAL_S, abs=QUANTUM)


def test_other_objects_say_the_same_position() -> None:
    machine = Machine(accelerating(40.037), lag_s=1e-4, conditioning=Conditioning(delay_s=1e-4))
    machine.run(500)
    read = machine.value
    place = read(0x2011, 4) + read(0x2011, 3) / 2**32
    assert place == pytest.approx(machine.place_at(machine.now), abs=1e-4)
    units = read(0x6004, 0)
    assert read(0x6008, 0) == read(0x600C, 0) == units
    assert units == int(place * UNITS)
    assert not read(0x2011, 1) & StatusBit.EXTRAPOLATED, "that is of 2013h"


@each("kind", [1, 2])
def test_a_prediction_goes_on_from_there(kind: int) -> None:
    """6008h with its SYNC: the position at that SYNC, though its sample is of the one before."""
    machine = Machine(accelerating(40.037), lag_s=1e-4, conditioning=Conditioning(delay_s=1e-4), predict=kind)
    machine.run(600)
    (frame,) = [one for one in machine.sync() if one.can_id == 0x2A0]
    (fine,) = struct.unpack_from("<q", frame.data)
    assert fine / UNITS == pytest.approx(machine.place_at(machine.bus.now), abs=3e-3)
