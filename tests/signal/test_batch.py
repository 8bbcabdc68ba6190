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

from canfb.objects import StatusBit
from canfb.signal import blocks, stream
from canfb.signal.correction import CorrectionTable
from canfb.signal.estimator import Estimator
from canfb.signal.limits import Declared
from canfb.signal.phase import phase_in_cycle
from canfb.signal.stream import process, process_stream
from canfb.signal.tracker import Tracker, TrackResult, track
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
odd = st.sampled_from([0.0, -0.0, 1e-300, -1e-300, 5e-324, 1e149, 1e150, -math.inf, math.nan])
values = st.one_of(counts.map(float), st.floats(-2e3, 2e3), odd)


@contextmanager
def blocks_of(samples: int) -> Iterator[None]:
    with patch.object(blocks, "BLOCK_SAMPLES", samples), patch.object(stream, "BLOCK_SAMPLES", samples):
        yield


def bits(result: TrackResult) -> list[bytes]:
    return [array.tobytes() for array in (result.cycles, result.phase, result.residual, result.ok)]


def columns(rows: list[tuple[int, float, float, bool]]) -> list[bytes]:
    kinds = (np.int64, np.float64, np.float64, np.bool_)
    each = zip(*rows, strict=True) if rows else ([], [], [], [])
    return [np.array(list(column), kind).tobytes() for column, kind in zip(each, kinds, strict=True)]


def one_by_one(sines: list[float], cosines: list[float], table: CorrectionTable | None) -> list[bytes]:
    """Any floats, also those that no converter gives."""
    recovery, rows = Estimator(Declared()), []
    for sine, cosine in zip(sines, cosines, strict=True):
        is_count = abs(sine) < 1e150 and abs(cosine) < 1e150
        raw = phase_in_cycle(sine, cosine) if is_count else math.nan
        phase = raw if table is None else table(raw)
        track, status = recovery.bad(1.0) if math.isnan(phase) else recovery.good(phase, 1.0)
        rows.append((track.cycles, track.phase, track.residual, bool(status & StatusBit.VALID)))
    return columns(rows)


@pytest.mark.parametrize("table", TABLES.values(), ids=TABLES)
@given(st.lists(st.tuples(values, values), max_size=40), st.integers(1, 9))
@example(
    [(0.0, 0.0)] * 3 + [(1.0, 2.0), (2.0, 1.0), (2.0, -1.0), (1.0, 5.0)], 4
)  # the first phase ends a block
@example([(1.0, 2.0), (0.0, 0.0), (2.0, 1.0), (2.0, -1.0), (1.0, 5.0), (1.0, 9.0)], 3)  # a gap does
@example([(-1e-300, 1.0), (-1e-300, 1e149), (-0.0, 1.0), (5e-324, 3.0)], 2)  # raw phase 1.0 is 0.0
def test_process_gives_the_bits_of_the_scalar_path(
    table: CorrectionTable | None, pairs: list[tuple[float, float]], samples: int
) -> None:
    sines, cosines = [pair[0] for pair in pairs], [pair[1] for pair in pairs]
    with blocks_of(samples):
        assert bits(process(sines, cosines, table, speed_cycles=0.0)) == one_by_one(sines, cosines, table)


@pytest.mark.parametrize("speed", [math.nan, math.inf, 1e10, "83", None, 1j, True])
def test_a_speed_that_is_none_is_refused(speed: object) -> None:
    for run in (
        lambda: process([1.0], [1.0], speed_cycles="83" if speed is None else speed),  # type: ignore[arg-type]
        lambda: track([0.5], speed_cycles=speed),  # type: ignore[arg-type]
        lambda: Tracker(speed_cycles=speed),  # type: ignore[arg-type]
        lambda: process_stream([], speed_cycles="83" if speed is None else speed),  # type: ignore[arg-type]
    ):
        with pytest.raises(ValueError, match="speed_cycles"):
            run()


PHASES = st.floats(0, 1, exclude_max=True)


@given(
    st.lists(st.one_of(PHASES, PHASES, st.just(math.nan)), max_size=60),
    st.floats(0.01, 0.5),
    st.integers(1, 9),
)
def test_track_gives_the_bits_of_a_tracker(phases: list[float], limit: float, samples: int) -> None:
    tracker = Tracker(limit)
    with blocks_of(samples):
        assert bits(track(phases, limit)) == columns([(*tracker.update(phase),) for phase in phases])


@each("table", TABLES.values())
@each("kind", ["int8", "int16", ">i2", "int32", "int64", "float32", "float64", "object"])
def test_any_kind_of_number_gives_the_bits_of_its_float64(kind: str, table: CorrectionTable | None) -> None:
    low, high = (-128, 127) if kind == "int8" else (-32768, 32767)
    numbers = np.random.default_rng(1).integers(low, high, (2, 500), endpoint=True)
    numbers[:, :3] = [[low, low, high], [low, high, low]]
    sines, cosines = numbers.astype(kind)
    want = bits(process(sines.astype(np.float64), cosines.astype(np.float64), table, speed_cycles=0.0))
    assert bits(process(sines, cosines, table, speed_cycles=0.0)) == want
    assert bits(process(sines[::-1], cosines[::-1], table, speed_cycles=0.0)) == bits(
        process(sines[::-1].astype(np.float64), cosines[::-1].astype(np.float64), table, speed_cycles=0.0)
    )


@given(st.floats(0, 1), st.sampled_from([name for name in TABLES if name != "none"]))
@example(1.0, "starts a hair above 0")
def test_raw_phase_1_is_raw_phase_0_for_a_table(raw: float, name: str) -> None:
    table = TABLES[name]
    assert table is not None
    many = table.correct_array(np.array([[raw, 1.0, 0.0]]))
    assert many.shape == (1, 3)
    assert many[0].tolist() == [table(raw), table(0.0), table(0.0)]
    assert table.correct(1.0) == table.correct(0.0)


def test_an_option_that_it_does_not_have_is_named() -> None:
    with pytest.raises(TypeError, match="no option 'coast'; it takes max_acceleration_cycles"):
        process([1.0, 2.0], [1.0, 2.0], coast=1)
    with pytest.raises(ValueError, match="phase_error_cycles"):
        process([100.0, 200.0], [100.0, 200.0], phase_error_cycles=0.0)
