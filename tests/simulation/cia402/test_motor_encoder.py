"""A drive with an encoder on its motor, and a coupling to the machine that slips."""

from __future__ import annotations

import itertools
import math
import struct

import pytest

from canfb.cia301.frame import Frame
from canfb.simulation.cia402.drive import ServoDrive
from canfb.simulation.cia402.plant import (
    SLIP_S,
    Coupling,
    DriveConfig,
    Motor,
    MotorConfig,
    Plant,
    PlantSource,
)
from canfb.simulation.encoder import Encoder, ShaftEncoder
from folding import each

SYNC = Frame(0x80, b"")


def turning(rev_s: float, start: float = 0.0) -> Plant:
    motor = Motor(MotorConfig(coulomb_friction_nm=0.0, viscous_friction_nm_s=0.0), start)
    motor.speed_rad_s, motor.braked = 2.0 * math.pi * rev_s, False
    return Plant(motor)


def test_6063h_is_the_motor_at_the_sync() -> None:
    """Sent with the SYNC itself, not one later; it wraps."""
    plant = turning(40.0, 2047.9)
    drive = ServoDrive(0x30, plant, motor_increments=1 << 20, autostart=True)
    for subindex, entry in ((1, 0x60630020), (0, 1)):
        drive.dictionary.entry(0x1A02, subindex).value = entry
    drive.dictionary.entry(0x1802, 1).value = 0x3B0
    plant.start(0.0)
    drive.start(0.0)
    for k in range(20):
        now = 1.0 + k * 1e-3
        plant.receive(SYNC, now)
        sent = [frame.data for frame in drive.receive(SYNC, now) if frame.can_id == 0x3B0]
        (value,) = struct.unpack("<i", sent[0])
        truth = (2047.9 + 40.0 * k * 1e-3) * (1 << 20)
        assert (value - truth + (1 << 31)) % (1 << 32) - (1 << 31) == pytest.approx(0, abs=1.5)


def test_the_encoder_falls_behind_where_the_coupling_slips() -> None:
    plant = turning(1.0)
    source = PlantSource(ShaftEncoder(Encoder(), 1000), plant, Coupling(0.25, 0.5))
    plant.receive(SYNC, 0.0)
    behind = []
    for k in range(1300):
        plant.receive(SYNC, k * 1e-3)
        source.sample_at(k * 1e-3)
        behind.append(plant.motor.revolutions * 1000 - source.position_cycles)
    assert behind[:500] == pytest.approx([0.0] * 500, abs=1e-6)
    assert behind[501 + round(SLIP_S * 1000) :] == pytest.approx([250.0] * len(behind[1001:]), abs=1e-6)
    assert all(after >= before - 1e-6 for before, after in itertools.pairwise(behind))


def test_a_coupling_holds_unless_told_otherwise() -> None:
    assert Coupling().slipped(1e9) == 0.0
    assert Coupling(2.0, 10.0).slipped(10.0 + SLIP_S / 2.0) == pytest.approx(1.0)


@each("key, value", [
    ("motor_increments", -1), ("motor_increments", 2**32), ("slip_revolutions", 1001.0),
    ("slip_revolutions", math.nan), ("slip_at_s", -1.0),
])  # fmt: skip
def test_values_that_are_not_good(key: str, value: float) -> None:
    with pytest.raises(ValueError, match=key):
        DriveConfig(**{key: value})  # type: ignore[arg-type]
