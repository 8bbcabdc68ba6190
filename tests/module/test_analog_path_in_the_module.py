"""2002:06 and 2002:07: the position is that of the SYNC, whatever the delays of the analog path."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from module_bench import Bench

from canfb.objects import StatusBit
from canfb.signal.conditioning import Conditioning
from canfb.signal.correction import Correction
from folding import each
from ideal_tracks import adc_pdo
from servo_kit import IDEAL_TABLE

INTERVAL_S, ADC_S = 1e-3, 2e-4
UNITS = 8192
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
