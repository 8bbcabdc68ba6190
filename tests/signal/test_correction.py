from __future__ import annotations

import math
import zlib
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.signal.correction import CorrectionTable

SIZES = [16, 17, 200, 256, 4096]


def wavy(n: int, size: float = 0.1, shift: float = 0.0) -> np.ndarray:
    x = np.arange(n) / n
    return x + size * np.sin(2 * np.pi * (x - shift))


@st.composite
def tables(draw: st.DrawFn) -> CorrectionTable:
    n = draw(st.sampled_from(SIZES))
    return CorrectionTable(wavy(n, draw(st.floats(-0.15, 0.15)), draw(st.floats(0, 1))))


@given(tables(), st.floats(0, 1, exclude_max=True))
def test_scalar_array_and_hot_path_give_the_same_bits(table: CorrectionTable, raw: float) -> None:
    one = table(raw)
    assert 0.0 <= one < 1.0
    assert np.float64(one).tobytes() == table(np.array([0.3, raw]))[1].tobytes()
    assert np.float64(table.correct(raw)).tobytes() == np.float64(one).tobytes()


@given(tables(), st.floats(0, 1), st.floats(1e-7, 1e-3))
def test_it_is_increasing_around_the_circle(table: CorrectionTable, raw: float, step: float) -> None:
    way = (table(raw + step) - table(raw)) % 1.0
    assert 0.0 < way < 0.1


@given(st.sampled_from([16, 256, 4096]), st.floats(0, 1, exclude_max=True))
def test_the_identity_changes_no_bit(n: int, raw: float) -> None:
    assert CorrectionTable.identity(n)(raw) == raw


@given(tables())
def test_interpolation_against_numpy(table: CorrectionTable) -> None:
    n = len(table)
    raw = np.random.default_rng(1).random(500)
    known = np.append(table.entries, table.entries[0] + 1.0)
    expected = np.interp(raw, np.arange(n + 1) / n, known) % 1.0
    error = (table(raw) - expected + 0.5) % 1.0 - 0.5
    assert np.abs(error).max() < 1e-12


@given(tables())
def test_bytes_there_and_back(table: CorrectionTable) -> None:
    again = CorrectionTable.from_bytes(table.to_bytes())
    assert again == table
    assert again.crc32 == table.crc32 == zlib.crc32(np.asarray(table.entries, "<f4").tobytes())


def test_arguments_are_taken_modulo_one_and_nan_stays_nan() -> None:
    table = CorrectionTable(wavy(200))
    assert table(1.25) == table(0.25) == table(-0.75)
    assert table(-1e-20) == table(0.0)
    assert math.isnan(table(math.nan))
    assert np.isnan(table(np.array([0.5, math.nan]))).tolist() == [False, True]


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda e: e[:15], "16 to 4096 entries, not 15"),
        (lambda e: np.arange(4097) / 4097, "16 to 4096 entries, not 4097"),
        (lambda e: np.where(np.arange(len(e)) == 7, np.nan, e), "entry 7 is not a finite number"),
        (lambda e: np.where(np.arange(len(e)) == 7, np.inf, e), "entry 7 is not a finite number"),
        (lambda e: np.where(np.arange(len(e)) == 7, e[6], e), "not strictly increasing from entry 6 to 7"),
        (lambda e: e + 0.26, "entry 0 is further than 0.25 cycle"),
        (lambda e: e * 0.7, "further than 0.25 cycle"),
        (lambda e: np.where(np.arange(len(e)) == 63, 1.0, e), "not strictly increasing from entry 63 to 0"),
        (lambda e: e.reshape(8, 8), "one dimension"),
        (lambda e: ["a"] * 64, "sequence of numbers"),
        (lambda e: 1e60 * e, "not a finite number"),
    ],
)
@pytest.mark.filterwarnings("ignore:overflow encountered in cast:RuntimeWarning")
def test_bad_tables_are_refused_with_the_reason(change: Callable[[Any], Any], reason: str) -> None:
    good = np.arange(64) / 64
    with pytest.raises(ValueError, match=reason):
        CorrectionTable(change(good))
