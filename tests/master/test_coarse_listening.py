"""The coarse track for canfb commission: heard on the bus, and what limit follows."""

from __future__ import annotations

import struct
from dataclasses import replace

import numpy as np
import pytest

from canfb import objects as od
from canfb.commission.limit_choice import choose
from canfb.commission.observation import observe
from canfb.master.samples import PdoRecorder
from canfb.simulation.encoder import Encoder
from canfb.view.module_view import PdoLayout, coarse_layout
from commissioning_kit import Bench
from machine_kit import RATE_HZ, SimulatedMachine, duty

GOOD = Encoder(noise_lsb=0.5)
ERROR_REVOLUTIONS = 0.01


def with_coarse(machine: SimulatedMachine, count: int, size: float = 1500.0) -> tuple[float, str]:
    """Limit in revolutions and its reason, of a coarse track with an error of two waves per revolution."""
    readings, start_s = machine.readings(count), machine.start_s
    samples = machine.samples(count)
    revolutions = machine.motion.revolutions_at(start_s + np.arange(count) / RATE_HZ)
    angle = 2 * np.pi * (revolutions + 0.3 + ERROR_REVOLUTIONS * np.sin(4 * np.pi * revolutions))
    tracks = np.rint(size * np.sin(angle)), np.rint(size * np.cos(angle))
    observed = observe(replace(samples, coarse=tracks), machine.used, machine.limits, readings)
    choices = {one.place: one for one in choose(observed.machine, machine.limits, 2.0)}
    one = choices[od.SUPERVISION_COARSE_LIMIT]
    return one.value / 65536, one.why


def test_the_limit_is_the_range_of_the_error_times_the_margin() -> None:
    machine = SimulatedMachine(duty(120, 0.5), GOOD)
    limit, why = with_coarse(machine, 6000)
    assert 1.95 * 2 * ERROR_REVOLUTIONS < limit < 2.15 * 2 * ERROR_REVOLUTIONS
    assert "° of the shaft" in why


def test_less_than_a_revolution_and_a_dead_track_say_nothing() -> None:
    slow = SimulatedMachine(duty(20, 0.3), GOOD)
    limit, why = with_coarse(slow, 3000)
    assert limit == 2048 / 65536
    assert "less than a revolution" in why
    limit, why = with_coarse(SimulatedMachine(duty(120, 0.5), GOOD), 6000, size=100.0)
    assert limit == 2048 / 65536
    assert "no amplitude" in why


@pytest.mark.parametrize("same_pdo", [True, False])
def test_it_is_heard_with_its_sample(same_pdo: bool) -> None:
    coarse = PdoLayout(0x190, 4, 6) if same_pdo else PdoLayout(0x290)
    recorder = PdoRecorder(PdoLayout(0x190, coarse=coarse))
    for k in range(5):
        recorder.on_sync(0x80, b"", 0.001 * k)
        if k == 2:
            continue
        tracks = struct.pack("<hh", 100 + k, -100 - k)
        if same_pdo:
            data = tracks + struct.pack("<hh", k, -k)
            recorder.on_pdo(0x190, data, 0.0)
            recorder.on_coarse(0x190, data, 0.0)
        else:
            recorder.on_pdo(0x190, tracks, 0.0)
            recorder.on_coarse(0x290, struct.pack("<hh", k, -k), 0.0)
    samples = recorder.result("a test")
    assert samples.coarse is not None
    assert np.array_equal(samples.coarse[0], [0.0, 1.0, np.nan, 3.0], equal_nan=True)
    assert np.array_equal(samples.coarse[1], [0.0, -1.0, np.nan, -3.0], equal_nan=True)
    assert samples.received_s is not None
    assert samples.received_s == pytest.approx([0.0, 0.001, 0.002, 0.003])


def test_its_pdo_is_found_in_the_module() -> None:
    bench = Bench(sync=False, operational=False)
    assert coarse_layout(bench.access.read_known) is None
    write = bench.access.write
    write(0x1401, 1, "I", 0x80000290)
    write(0x1601, 0, "B", 0)
    write(0x1601, 1, "I", od.SAMPLE_COARSE_SINE.mapped(16))
    write(0x1601, 2, "I", od.SAMPLE_COARSE_COSINE.mapped(16))
    write(0x1601, 0, "B", 2)
    write(0x1401, 1, "I", 0x290)
    found = coarse_layout(bench.access.read_known)
    assert found is not None
    assert (found.can_id, found.sine_byte, found.cosine_byte) == (0x290, 0, 2)
