"""The phase of a sample, and which tracks the library takes and refuses."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, strategies as st

from canfb import ChainConfig, Conditioning, CorrectionTable, SignalChain, phase_in_cycle, track
from canfb.calibration.methods import calibrate_from_motion, calibrate_from_zero_crossings
from canfb.signal.stream import process, process_stream
from folding import each

values = st.floats(-1e300, 1e300, allow_subnormal=False) | st.sampled_from([math.nan, math.inf, -0.0])
counts = st.integers(-32768, 32767)


def bits(value: float) -> bytes:
    return np.float64(value).tobytes()


@given(st.one_of(values, counts), st.one_of(values, counts))
@example(math.inf, math.inf)
@example(0.0, -0.0)
def test_scalar_and_array_give_the_same_bits_and_a_phase_in_range(sine: float, cosine: float) -> None:
    one = phase_in_cycle(sine, cosine)
    many = phase_in_cycle(np.array([sine, 1.0]), np.array([cosine, 0.5]))
    assert isinstance(one, float)
    if sine == cosine == 0 or sine != sine or cosine != cosine or abs(sine) == abs(cosine) == math.inf:
        assert math.isnan(one)
        assert math.isnan(many[0])
    else:
        assert bits(one) == bits(many[0])
        assert 0.0 <= one < 1.0


@given(counts, counts, st.integers(1, 1000))
def test_a_common_amplitude_error_has_no_influence(sine: int, cosine: int, factor: int) -> None:
    if sine or cosine:
        assert phase_in_cycle(sine * factor, cosine * factor) == phase_in_cycle(sine, cosine)


@each("sine, cosine, phase", [
    (0, 5, 0.0), (1, 8, 1 / 64), (5, 5, 0.125), (5, 0, 0.25), (5, -5, 0.375), (0, -5, 0.5),
    (-5, -5, 0.625), (-5, 0, 0.75), (-5, 5, 0.875), (-1, 8, 1 - 1 / 64), (8, -1, 0.25 + 1 / 64),
])  # fmt: skip
def test_table_1_at_its_corners(sine: int, cosine: int, phase: float) -> None:
    assert phase_in_cycle(sine, cosine) == phase


def test_the_phase_is_monotonic_and_continuous_and_at_most_1_132_percent_off() -> None:
    x = np.arange(1_000_000) / 1e6
    raw = phase_in_cycle(np.sin(2 * np.pi * x), np.cos(2 * np.pi * x))
    steps = np.diff(raw)
    assert steps.min() > 0.0
    assert steps.max() < 1.6e-6
    assert np.abs(raw - x).max() == pytest.approx(0.01132, abs=2e-5)


def test_small_integers_do_not_overflow() -> None:
    s, c = np.array([-32768, 100], np.int16), np.array([32767, 32767], np.int16)
    assert phase_in_cycle(s, c)[0] == phase_in_cycle(-32768, 32767)
    assert phase_in_cycle(s[0], c[0]) == phase_in_cycle(-32768, 32767)


ANGLE = np.linspace(0.0, 40 * np.pi, 1000)
SINE, COSINE = 1500 * np.sin(ANGLE), 1500 * np.cos(ANGLE)
TAKERS = {
    "process": process,
    "process, with the identity": lambda s, c: process(s, c, conditioning=Conditioning()),
    "process_stream": lambda s, c: list(process_stream([(s, c)])),
    "calibrate_from_motion": calibrate_from_motion,
    "calibrate_from_motion, with the identity": lambda s, c: calibrate_from_motion(
        s, c, conditioning=Conditioning()
    ),
    "calibrate_from_zero_crossings": calibrate_from_zero_crossings,
}
WRONG = {
    "complex": (SINE.astype(complex), COSINE.astype(complex), "real numbers"),
    "2-D": (SINE.reshape(2, -1), COSINE.reshape(2, -1), "one dimension"),
    "scalars": (1.0, 1.0, "one dimension"),
    "ragged": ([[1.0], [1.0, 2.0]], [1.0, 2.0], "one dimension"),
    "another length": (SINE, COSINE[:-1], "one length"),
    "text": (["1"], ["2"], "real numbers"),
    "nothing": (None, None, "real numbers|one dimension"),
    "truth values": (SINE > 0, COSINE > 0, "real numbers"),
    "unsigned": ((SINE + 2048).astype(np.uint16), (COSINE + 2048).astype(np.uint16), "mid-scale"),
    "never centred": (np.rint(SINE + 2048).astype(int), np.rint(COSINE + 2048).astype(int), "mid-scale"),
    "never centred, small": (100 * np.sin(ANGLE) + 128, 100 * np.cos(ANGLE) + 128, "mid-scale"),
    "in -1..1": (np.sin(ANGLE), np.cos(ANGLE), "full scale"),
    "volts": (np.float32(0.5 * np.sin(ANGLE)), np.float32(0.5 * np.cos(ANGLE)), "full scale"),
}


@pytest.mark.parametrize("take", TAKERS.values(), ids=TAKERS)
@pytest.mark.parametrize("wrong", WRONG.values(), ids=WRONG)
def test_what_are_no_tracks_is_refused_in_one_line(
    take: Callable[[Any, Any], object], wrong: tuple[Any, Any, str]
) -> None:
    sine, cosine, words = wrong
    with pytest.raises(ValueError, match=words) as error:
        take(sine, cosine)
    assert "\n" not in str(error.value)


@each("sine, cosine", [
    (np.full(500, 900), np.full(500, 700)),  # at standstill in the first quadrant
    (np.sin(np.linspace(0.05, 1.5, 500)) * 1500, np.cos(np.linspace(0.05, 1.5, 500)) * 1500),  # slowly
    (np.zeros(500), np.zeros(500)),  # dead
    (np.random.default_rng(1).normal(0, 0.01, 500), np.random.default_rng(2).normal(0, 0.01, 500)),
    (SINE.astype(np.int16), COSINE.astype(np.int16)),
    (np.sin(ANGLE[:10]), np.cos(ANGLE[:10])),  # too few to judge
    (np.full(500, np.nan), np.full(500, np.nan)),
    (np.rint(900 + np.random.default_rng(3).normal(0, 3, 500)), np.full(500, 700.0)),
])  # fmt: skip
def test_what_may_be_tracks_is_taken(sine: np.ndarray, cosine: np.ndarray) -> None:
    assert len(process(sine, cosine, speed_cycles=0.0).ok) == len(sine)
    (result,) = process_stream([(sine, cosine)], speed_cycles=0.0)
    assert len(result.status) == len(sine)


def test_a_later_block_is_flagged_and_never_refused() -> None:
    blocks = [(SINE, COSINE), (SINE / 1500, COSINE / 1500), (SINE + 2048, COSINE + 2048)]
    good, *bad = process_stream(blocks)
    assert good.valid.all()
    assert not any(result.valid.any() for result in bad)


@pytest.mark.parametrize("table", [np.arange(256) / 256, [0.0] * 256, 3, "table"])
def test_a_table_that_is_none_is_refused(table: object) -> None:
    for run in (
        lambda: process(SINE, COSINE, table),  # type: ignore[arg-type]
        lambda: process_stream([], table=table),  # type: ignore[arg-type]
        lambda: SignalChain(ChainConfig(), table),  # type: ignore[arg-type]
    ):
        with pytest.raises(TypeError, match="CorrectionTable"):
            run()


@pytest.mark.parametrize("config", [{"adc_bits": 12}, 12, ChainConfig])
def test_a_configuration_that_is_none_is_refused(config: object) -> None:
    with pytest.raises(TypeError, match="must be a ChainConfig"):
        SignalChain(config)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="must be a ChainConfig"):
        process_stream([], config)  # type: ignore[arg-type]


@each("run", [
    lambda: track(np.array([0.5 + 0j])),
    lambda: phase_in_cycle(SINE.astype(complex), COSINE),
    lambda: phase_in_cycle(np.complex128(1j), 1.0),
    lambda: CorrectionTable(np.arange(64) / 64 + 0j),
    lambda: CorrectionTable.identity()(np.array([0.5 + 0j])),
    lambda: CorrectionTable.identity()(np.complex64(0.5)),
])  # fmt: skip
def test_complex_numbers_are_refused(run: Callable[[], object]) -> None:
    with pytest.raises(ValueError, match="real numbers"):
        run()


@pytest.mark.parametrize("block", [3, ([1.0], [1.0], [1.0])])
def test_a_block_that_is_no_pair_is_refused(block: object) -> None:
    with pytest.raises(ValueError, match="pair"):
        list(process_stream([block]))  # type: ignore[list-item]
