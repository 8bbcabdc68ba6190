"""2002:06, 2002:07 and 2001:05: what the analog path does at speed, over the objects of the module."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from canfb.cia301.frame import Frame
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig
from canfb.objects import StatusBit
from canfb.signal.conditioning import Conditioning
from canfb.signal.correction import Correction
from folding import each
from servo_kit import IDEAL_TABLE

SYNC, ADC_PDO, POSITION_PDO = 0x80, 0x190, 0x1A0
INTERVAL_S = 1e-3
UNITS = 8192  # of 6004h in a cycle
QUANTUM = 1.5 / UNITS + 1e-4  # of the position, and of a converter of 16 bits at 0.7 of its range
Motion = Callable[[float], float]


class Machine:
    """A module and its encoder; the analog path is a delay of both tracks, and one between them."""

    def __init__(
        self, position: Motion, cosine_delay_s: float = 0.0, lag_s: float = 0.0, **fields: Any
    ) -> None:
        self.position, self.cosine_delay_s, self.lag_s = position, cosine_delay_s, lag_s
        config = ModuleConfig(node_id=32, encoder_interface=16, autostart=True, adc_bits=16, **fields)
        self.module = FeedbackModule(config)
        self.module.start(0.0)
        self.module.use_correction(Correction(IDEAL_TABLE, config.conditioning))
        self.times = config.times
        self.now = 0.0
        self.amplitude = 23000.0
        self.corner_hz = 0.0

    def sample(self) -> tuple[float, int]:
        """One SYNC and its sample: error of 6004h against the position at the SYNC, cycles; status."""
        self.now = now = self.now + INTERVAL_S
        sent = self.module.receive(Frame(SYNC, b""), now)
        at_sine, at_cosine = (
            2.0 * math.pi * (self.position(now - late) % 1.0)
            for late in (self.lag_s, self.lag_s - self.cosine_delay_s)
        )
        hertz = (self.position(now) - self.position(now - 1e-6)) / 1e-6
        size = self.amplitude / (math.hypot(1.0, hertz / self.corner_hz) if self.corner_hz else 1.0)
        data = struct.pack("<hh", round(size * math.sin(at_sine)), round(size * math.cos(at_cosine)))
        if self.times:
            data += struct.pack("<I", round(now * 1e7))
        sent += self.module.receive(Frame(ADC_PDO, data), now + 2e-4)
        (frame,) = [one for one in sent if one.can_id == POSITION_PDO]
        units, status, _ = struct.unpack("<IHH", frame.data)
        away = units / UNITS - self.position(now)
        turns = 2500 * 209
        return (away + turns / 2) % turns - turns / 2, status

    def read(self, index: int, subindex: int) -> Any:
        return self.module.dictionary.entry(index, subindex).current()

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
@each("fields", [{}, {"times": True}])
def test_the_position_is_that_of_the_sync(fields: dict[str, Any], lag_s: float) -> None:
    """Also while the machine accelerates, but for the interval in which that begins or ends."""
    used = Conditioning(delay_s=lag_s)
    machine = Machine(accelerating(40.037), lag_s=lag_s, conditioning=used, **fields)
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
    read = machine.read
    place = read(0x2011, 4) + read(0x2011, 3) / 2**32
    assert place == pytest.approx(machine.position(machine.now), abs=1e-4)
    units = read(0x6004, 0)
    assert read(0x6008, 0) == read(0x600C, 0) == units
    assert units == int(place * UNITS)
    assert not read(0x2011, 1) & StatusBit.EXTRAPOLATED, "that is of 2013h"


@each("kind", [1, 2])
def test_a_prediction_goes_on_from_there(kind: int) -> None:
    """6008h with its SYNC: the position at that SYNC, though its sample is of the one before."""
    used = Conditioning(delay_s=1e-4)
    machine = Machine(accelerating(40.037), lag_s=1e-4, conditioning=used, predict=kind)
    machine.run(600)
    machine.now += INTERVAL_S
    (frame,) = [one for one in machine.module.receive(Frame(SYNC, b""), machine.now) if one.can_id == 0x2A0]
    (fine,) = struct.unpack_from("<q", frame.data)
    assert fine / UNITS == pytest.approx(machine.position(machine.now), abs=3e-3)


# The objects.
