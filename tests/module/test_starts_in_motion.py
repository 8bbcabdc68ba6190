"""A machine that turns already when its module starts, and sample times at a SYNC that jitters."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass

import numpy as np
import pytest

from canfb import FeedbackModule, Frame, ModuleConfig
from canfb.signal.supervision import VALID
from ideal_tracks import adc_pdo

N, PERIOD_S, JITTER_S, STARTS = 2500, 1e-3, 80e-6, 12
RAD_S2 = 2.0 * math.pi / N / PERIOD_S**2  # of one cycle per period^2


@dataclass
class Start:
    """What is known at a start, and what does not come of it: numbers of samples."""

    nominal: bool = False
    stamps: bool = False
    counter: bool = False
    heard_before: int = 0
    lost: tuple[int, ...] = ()
    flagged: tuple[int, ...] = ()


def wrong_and_right(
    start: Start, acceleration: float, seed: int, samples: int = 40
) -> tuple[list[int], bool]:
    """Samples whose position is valid and wrong, counted from 1, and whether it is right at the end."""
    rng = np.random.default_rng(seed)
    config = ModuleConfig(
        node_id=32, encoder_interface=16, times=True, max_acceleration_rad_s2=acceleration * RAD_S2
    )
    module = FeedbackModule(config)
    module.start(0.0)
    if start.nominal:  # 1006h by SDO
        module.receive(Frame(0x620, struct.pack("<BHBI", 0x23, 0x1006, 0, round(PERIOD_S * 1e6))), 0.5)
    speed = float(rng.uniform(2.0, 125.0)) * float(rng.choice((-1.0, 1.0)))
    bend = 0.5 * acceleration * float(rng.uniform(-1.0, 1.0))
    ticks_before = int(rng.integers(1 << 32))
    first, wrong, right = None, [], False
    for number in range(-start.heard_before, samples):
        at_s = 1.0 + number * PERIOD_S + float(rng.uniform(-JITTER_S, JITTER_S))
        if number == 0:
            module.receive(Frame(0x000, bytes([1, 32])), 1.0 - 0.5 * PERIOD_S)
        sampled_s = at_s + 20e-6
        time = (sampled_s - 1.0) / PERIOD_S
        position = 0.3 + speed * time + 0.5 * bend * time * time
        host_s = rng.uniform(10e-6, 80e-6, 2)
        while (due := module.deadline()) is not None and due < at_s + host_s[0]:
            module.tick(due)
        counter = bytes([number % 240 + 1]) if start.counter else b""
        module.receive(Frame(0x080, counter, timestamp=at_s if start.stamps else None), at_s + host_s[0])
        if number in start.lost or number < 0:
            continue
        size = 0.0 if number in start.flagged else 1500.0
        tracks = [size * turn(2.0 * math.pi * position) for turn in (math.sin, math.cos)]
        noisy = [round(one + rng.normal(0.0, 0.5)) for one in tracks]
        data = struct.pack("<hhI", *noisy, (int(sampled_s * 1e7) + ticks_before) % 2**32)
        came_s = sampled_s + 200e-6
        pdo = Frame(0x190, data, timestamp=came_s if start.stamps else None)
        for frame in module.receive(pdo, came_s + host_s[1]):
            if frame.can_id != 0x1A0 or not struct.unpack_from("<H", frame.data, 4)[0] & VALID:
                continue
            feedback = module.feedback
            assert feedback is not None
            off = round(feedback.cycles + feedback.phase - position)
            first = off if first is None else first
            right = off == first
            if not right:
                wrong.append(number + 1)
    return wrong, right


@pytest.mark.parametrize(
    "start",
    [
        *(Start(), Start(stamps=True), Start(nominal=True), Start(counter=True, lost=(1,))),
        *(Start(heard_before=3), Start(heard_before=20), Start(lost=(1,)), Start(lost=(2, 3))),
        *(Start(nominal=True, lost=(2, 3)), Start(nominal=True, lost=(6,))),
        *(Start(flagged=(0,)), Start(flagged=(1,))),
    ],
    ids=str,
)
def test_no_start_in_motion_is_valid_before_its_speed_is_known(start: Start) -> None:
    """The first interval is even where it is the unit of all others: it proves nothing."""
    for seed in range(STARTS):
        wrong, _ = wrong_and_right(start, (0.01, 0.05, 0.1)[seed % 3], seed)
        assert not wrong, f"start {seed}: wrong at sample {wrong[0]}"


@pytest.mark.parametrize(
    ("start", "acceleration", "least"),
    [(Start(), 0.01, STARTS), (Start(nominal=True, lost=(6,)), 0.05, STARTS - 1)],
    ids=str,
)
def test_a_start_in_motion_is_right_soon(start: Start, acceleration: float, least: int) -> None:
    """Where no period was known, and with the count of the first sample where one was missed."""
    assert sum(wrong_and_right(start, acceleration, seed, 80)[1] for seed in range(STARTS)) >= least


@pytest.mark.parametrize("speed", [0.0, 3.0])
def test_a_start_that_is_about_to_be_confirmed_is_no_emergency(speed: float) -> None:
    """Sample times contradict the start of a machine that turns: that one is reported."""
    rng = np.random.default_rng(3)
    config = ModuleConfig(
        node_id=32, encoder_interface=16, times=True, autostart=True, max_acceleration_rad_s2=0.01 * RAD_S2
    )
    module = FeedbackModule(config)
    module.start(0.0)
    emergencies, statuses = [], []
    for number in range(40):
        at_s = 1.0 + number * PERIOD_S + float(rng.uniform(-JITTER_S, JITTER_S))
        pdo = adc_pdo(0.3 + speed * at_s / PERIOD_S, time_s=at_s)
        sent = module.receive(Frame(0x080, b""), at_s) + module.receive(pdo, at_s + 1e-4)
        emergencies += [frame.data[:2] for frame in sent if frame.can_id == 0xA0]
        assert module.feedback is not None
        statuses.append(module.feedback.status)
    assert not statuses[3] & VALID
    assert statuses[-1] & VALID
    assert bool(emergencies) is (speed != 0.0)
