"""The array path against the scalar path, bit for bit, with blocks so short that every seam is met."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from canfb.signal import blocks
from canfb.signal.batch import process
from canfb.signal.conditioning import Conditioning
from canfb.signal.correction import CorrectionTable
from canfb.signal.phase import phase_in_cycle
from canfb.signal.tracker import Track, Tracker, TrackResult, track
from folding import each

PLACES = np.arange(64) / 64
TABLES = {
    "none": None,
    "starts above 0": CorrectionTable(PLACES + 0.01 * np.sin(2 * np.pi * (PLACES + 0.1))),
    "starts below 0": CorrectionTable(PLACES + 0.01 * np.sin(2 * np.pi * (PLACES - 0.1))),
    "starts a hair above 0": CorrectionTable(np.where(PLACES == 0.0, 1e-10, PLACES)),
    "starts a hair below 0": CorrectionTable(np.where(PLACES == 0.0, -1e-30, PLACES)),
}
counts = st.integers(-32768, 32767)
odd = st.sampled_from([0.0, -0.0, 1e-300, -1e-300, 5e-324, 1e300, math.inf, -math.inf, math.nan])
values = st.one_of(counts.map(float), st.floats(-2e3, 2e3), odd)


@contextmanager
def blocks_of(samples: int) -> Iterator[None]:
    with patch.object(blocks, "BLOCK_SAMPLES", samples):
        yield


def bits(result: TrackResult) -> list[bytes]:
    return [array.tobytes() for array in (result.cycles, result.phase, result.residual, result.ok)]


def one_by_one(sines: list[float], cosines: list[float], table: CorrectionTable | None) -> list[bytes]:
    tracker, tracks = Tracker(), list[Track]()
    for sine, cosine in zip(sines, cosines, strict=True):
        phase = phase_in_cycle(sine, cosine)
        tracks.append(tracker.update(phase if table is None else table(phase)))
    columns = zip(*tracks, strict=True) if tracks else ([], [], [], [])
    kinds = (np.int64, np.float64, np.float64, np.bool_)
    return [np.array(list(column), kind).tobytes() for column, kind in zip(columns, kinds, strict=True)]


@pytest.mark.parametrize("table", TABLES.values(), ids=TABLES)
@given(st.lists(st.tuples(values, values), max_size=40), st.integers(1, 9))
@example(
    [(0.0, 0.0)] * 3 + [(1.0, 2.0), (2.0, 1.0), (2.0, -1.0), (1.0, 5.0)], 4
)  # the first phase ends a block
@example([(1.0, 2.0), (0.0, 0.0), (2.0, 1.0), (2.0, -1.0), (1.0, 5.0), (1.0, 9.0)], 3)  # a gap does
@example([(-1e-300, 1.0), (-1e-300, 1e300), (-0.0, 1.0), (5e-324, 3.0)], 2)  # raw phase 1.0 is 0.0
def test_process_gives_the_bits_of_the_scalar_path(
    table: CorrectionTable | None, pairs: list[tuple[float, float]], samples: int
) -> None:
    sines, cosines = [pair[0] for pair in pairs], [pair[1] for pair in pairs]
    with blocks_of(samples):
        assert bits(process(sines, cosines, table)) == one_by_one(sines, cosines, table)


@given(
    st.lists(st.one_of(st.floats(0, 1, exclude_max=True), st.just(math.nan)), max_size=40), st.integers(1, 9)
)
def test_track_does_not_depend_on_the_blocks(phases: list[float], samples: int) -> None:
    whole = track(phases)
    with blocks_of(samples):
        assert bits(track(phases)) == bits(whole)


@each("table", TABLES.values())
@each("kind", ["int8", "int16", ">i2", "int32", "int64", "uint16", "float32", "float64", "object"])
def test_any_kind_of_number_gives_the_bits_of_its_float64(kind: str, table: CorrectionTable | None) -> None:
    low, high = (-128, 127) if kind == "int8" else (0, 32767) if kind == "uint16" else (-32768, 32767)
    numbers = np.random.default_rng(1).integers(low, high, (2, 500), endpoint=True)
    numbers[:, :3] = [[low, low, high], [low, high, low]]
    sines, cosines = numbers.astype(kind)
    want = bits(process(sines.astype(np.float64), cosines.astype(np.float64), table))
    assert bits(process(sines, cosines, table)) == want
    assert bits(process(sines[::-1], cosines[::-1], table)) == bits(
        process(sines[::-1].astype(np.float64), cosines[::-1].astype(np.float64), table)
    )


def test_conditioning_is_computed_in_float64() -> None:
    conditioning = Conditioning(0.1, -0.3, 1.01, 0.99, 0.05)
    numbers = np.random.default_rng(2).integers(-2000, 2000, (2, 500))
    want = bits(process(*numbers.astype(np.float64), conditioning=conditioning))
    for kind in (np.int16, np.float32):
        assert bits(process(*numbers.astype(kind), conditioning=conditioning)) == want


def test_the_arguments_are_left_as_they_are() -> None:
    sines, cosines = np.array([1.0, -2.0, 3.0]), np.array([-1.0, 2.0, 0.5])
    phases = np.array([0.25, math.nan, 0.5])
    process(sines, cosines, TABLES["starts below 0"])
    track(phases)
    assert (sines.tolist(), cosines.tolist()) == ([1.0, -2.0, 3.0], [-1.0, 2.0, 0.5])
    assert np.isnan(phases).tolist() == [False, True, False]


@given(st.floats(0, 1), st.sampled_from([name for name in TABLES if name != "none"]))
@example(1.0, "starts a hair above 0")
def test_raw_phase_1_is_raw_phase_0_for_a_table(raw: float, name: str) -> None:
    table = TABLES[name]
    assert table is not None
    many = table.correct_array(np.array([[raw, 1.0, 0.0]]))
    assert many.shape == (1, 3)
    assert many[0].tolist() == [table(raw), table(0.0), table(0.0)]
    assert table.correct(1.0) == table.correct(0.0)


def test_phases_of_arrays_of_any_shape() -> None:
    sines, cosines = np.array([[1.0], [-3.0]]), np.array([2.0, -2.0, 1.0])
    got = phase_in_cycle(sines, cosines)
    assert got.tolist() == [[phase_in_cycle(s, c) for c in cosines.tolist()] for s in (1.0, -3.0)]
    assert phase_in_cycle(np.array(1.0), np.array(1.0)) == 0.125
