"""The objects that are computed when they are read, and the arithmetic of the position."""

from __future__ import annotations

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from module_bench import Bench

from canfb.module.cia406.position import PHASE_UNITS, PositionScale
from canfb.objects import StatusBit


def test_before_the_first_sample_they_are_zero(bench: Bench) -> None:
    sdo = bench.sdo
    assert [sdo[0x2011][5].raw, sdo[0x2011][7].raw, sdo[0x600C].raw, sdo[0x6505].raw] == [0, 0.0, 0, 0]


def test_the_raw_position_knows_no_scaling_no_preset_and_no_code_sequence(bench: Bench) -> None:
    for _ in range(3):
        bench.at(0.25)
    bench.sdo[0x6003].raw = 77
    bench.sdo[0x6001].raw = 10_000
    bench.sdo[0x6000].raw = 0b101
    assert bench.at(0.25)[0] != 2048
    assert bench.sdo[0x600C].raw == 2048


def test_they_can_be_mapped_into_a_pdo(bench: Bench) -> None:
    parameters, mapping = bench.sdo[0x1802], bench.sdo[0x1A02]
    parameters[2].raw = 1
    mapping[0].raw = 0
    for place, value in enumerate((0x20110510, 0x20110720, 0x65050010), start=1):
        mapping[place].raw = value
    mapping[0].raw = 3
    parameters[1].raw = 0x3A0
    for n in range(12):
        bench.at(n * 0.25, amplitude=440)
    (data,) = [frame.data for frame in bench.sync() if frame.can_id == 0x3A0]
    amplitude, velocity, warnings = struct.unpack("<HfH", data)
    assert (amplitude, warnings) == (440, 2)
    assert velocity == pytest.approx(2 * math.pi * 0.25 / 2500 / bench.interval_s, rel=1e-3)


def test_which_tpdos_go_out_with_a_sample_is_up_to_their_parameters(bench: Bench) -> None:
    parameters = bench.sdo[0x1801]

    def sent() -> list[list[int]]:
        return [[frame.can_id for frame in frames] for frames in (bench.sync(), bench.counts(0, 1500))]

    sent()
    assert sent() == [[0x2A0], [0x1A0]]
    parameters[2].raw = 254
    assert sent() == [[], [0x1A0, 0x2A0]]
    parameters[1].raw = 0x800002A0
    assert sent() == [[], [0x1A0]]
    parameters[2].raw = 0
    parameters[1].raw = 0x2A0
    assert sent() == [[], [0x1A0]]
    assert sent() == [[0x2A0], [0x1A0]]


def test_a_velocity_beyond_real32_is_the_largest_one(bench: Bench) -> None:
    bench.interval_s = 1e-300
    bench.bus.now = 0.0
    for n in range(4):
        bench.at(n * 0.25)
    assert bench.sdo[0x2011][7].raw == pytest.approx(3.4e38, rel=1e-3)


def test_a_residual_limit_that_follows_the_acceleration_follows_the_encoder_too(bench: Bench) -> None:
    bench.sdo[0x2010][2].raw = 100.0  # 0.04 cycle at 2500 cycles and 1 kHz, 16 cycles at a million
    for _ in range(10):  # until the period is known
        bench.at(0.0)
    assert bench.at(0.2)[1] & StatusBit.RESIDUAL
    for _ in range(6):
        bench.at(0.0)
    bench.sdo[0x2001][1].raw = 1_000_000
    assert bench.at(0.2)[1] == StatusBit.VALID


@given(
    st.integers(1, 1048576), st.integers(1, 2**32 - 1), st.booleans(),
    st.integers(-(2**62), 2**62), st.integers(0, PHASE_UNITS - 1),
)  # fmt: skip
def test_the_scaling_is_exact(per_turn: int, units: int, reverse: bool, cycles: int, phase: int) -> None:
    scale = PositionScale(per_turn, units, 2**32, reverse, 0)
    exact = (cycles * PHASE_UNITS + phase) * (-units if reverse else units)
    assert scale.units(cycles, phase / PHASE_UNITS) == exact // (per_turn * PHASE_UNITS)
