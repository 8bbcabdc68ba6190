"""Correction tables, a whole calibration in place of its table, and tracks that begin in motion."""

import math
import zlib
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

import canfb
from canfb.signal.correction import Correction, CorrectionTable
from canfb.signal.phase import FloatArray


def wavy(n: int, size: float = 0.1, shift: float = 0.0) -> np.ndarray:
    x = np.arange(n) / n
    return x + size * np.sin(2 * np.pi * (x - shift))


@st.composite
def tables(draw: st.DrawFn) -> CorrectionTable:
    n = draw(st.sampled_from([16, 17, 200, 256, 4096]))
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


USED = canfb.Conditioning(30.0, -20.0, 1.02, 0.98, 0.03)
RAW = np.arange(64) / 64
CORRECTION = Correction(canfb.CorrectionTable(RAW + 0.01 * np.sin(2 * np.pi * RAW)).made_for(USED), USED)


class Calibrated:
    correction = CORRECTION


def counts(position: FloatArray) -> tuple[FloatArray, FloatArray]:
    return np.rint(1500 * np.sin(2 * np.pi * position)), np.rint(1500 * np.cos(2 * np.pi * position))


TRACKS = counts(np.cumsum(np.linspace(0.0, 0.3, 500)))
TABLE: Any = CORRECTION.table
CONFIG = canfb.ChainConfig(conditioning=USED)


def one_by_one(config: canfb.ChainConfig, table: Any) -> list[float]:
    chain = canfb.SignalChain(config, table)
    got = [chain.step(canfb.Sample(s, c)) for s, c in zip(*(track.tolist() for track in TRACKS), strict=True)]
    return [one.cycles + one.phase for one in got]


def over_arrays(config: canfb.ChainConfig, table: Any) -> list[float]:
    known = None if config.conditioning.is_identity else config.conditioning
    (block,) = canfb.process_stream([TRACKS], config, table)
    got = canfb.process(*TRACKS, table, conditioning=known)
    assert (block.cycles == got.cycles).all()
    return list(got.cycles + got.phase)


@pytest.mark.parametrize("run", [over_arrays, one_by_one])
def test_a_calibration_brings_its_conditioning(run: Callable[..., list[float]]) -> None:
    wanted = run(CONFIG, TABLE)
    for whole in (CORRECTION, Calibrated()):
        assert run(canfb.ChainConfig(), whole) == wanted
        assert run(CONFIG, whole) == wanted
        with pytest.raises(ValueError, match="another one already"):
            run(canfb.ChainConfig(conditioning=canfb.Conditioning(1.0)), whole)
    with pytest.raises(ValueError, match="pass the whole calibration"):
        run(canfb.ChainConfig(), TABLE)
    assert run(canfb.ChainConfig(), canfb.CorrectionTable(TABLE.entries)) != wanted


@given(st.integers(-1000, 1000), st.floats(0.16, 0.32), st.sampled_from([0, 2]))
def test_a_missing_sample_at_the_start_is_no_standstill(whole: int, part: float, missing: int) -> None:
    sine, cosine = counts((whole + part) * np.arange(40.0) + 0.3)
    sine[missing] = np.nan
    with pytest.warns(UserWarning, match="speed_cycles"):
        assert not canfb.process(sine, cosine).ok.any()


@given(st.integers(-1000, 1000), st.floats(0.13, 0.32), st.sampled_from([1, 2, 100]))
def test_several_starts_that_fit_are_not_ok(whole: int, part: float, length: int) -> None:
    tracks = counts((whole + part) * np.arange(40.0) + 0.3)
    blocks = [tuple(track[at : at + length] for track in tracks) for at in range(0, 40, length)]
    with pytest.warns(UserWarning, match="speed_cycles"):
        assert not canfb.process(*tracks).ok.any()
    with pytest.warns(UserWarning, match="speed_cycles"):
        results = list(canfb.process_stream(blocks))  # type: ignore[arg-type]
    # The first two samples show no motion yet.
    assert not np.concatenate([one.valid for one in results])[2 // length * length :].any()
    for result in (canfb.process(*tracks, speed_cycles=whole + part + 0.1),):
        assert result.ok.all()
        assert result.cycles[-1] - result.cycles[0] == pytest.approx((whole + part) * 39, abs=1.0)


@given(st.floats(-0.09, 0.09), st.floats(0.0, 1.0))
def test_a_start_from_standstill_is_ok(acceleration: float, part: float) -> None:
    time = np.maximum(np.arange(12) - part, 0.0)
    assert canfb.process(*counts(acceleration * time**2 / 2 + 0.1)).ok[:2].all()
