"""The checks of samples at their limits, and that each fault shows where it is and nowhere else."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given, strategies as st
from witness_kit import Machine, above, at, below, flags, has, moving

from canfb import ChainConfig, Sample, SignalChain, StatusBit
from canfb.signal import supervision
from canfb.signal.supervision import FrozenInput, SampleLimits, Supervision, repeats
from folding import each

LIMITS = SampleLimits(2048, 400, 2400)
OK, AMPLITUDE_BIT, CLIPPED_BIT = 0, 1 << 4, 1 << 5
BOTH = AMPLITUDE_BIT | CLIPPED_BIT


def test_the_bits_are_those_of_the_object() -> None:
    names = ["VALID", "COASTING", "LOST", "RESIDUAL", "AMPLITUDE", "CLIPPED", "MISSED", "TABLE_ACTIVE"]
    names += ["REFERENCED", "COARSE", "CALIBRATING", "FROZEN", "EXTRAPOLATED", "SECOND_POSITION"]
    assert {bit.name: bit.value for bit in StatusBit} == {name: 1 << n for n, name in enumerate(names)}
    for name in names:
        plain = getattr(supervision, name, None)
        assert plain is None or (type(plain) is int and plain == StatusBit[name])


CLIPPING = [
    (-2049, CLIPPED_BIT), (-2048, CLIPPED_BIT), (above(-2048), OK), (-2047, OK), (0, OK), (2046, OK),
    (below(2047), OK), (2047, CLIPPED_BIT), (2048, CLIPPED_BIT), (math.inf, CLIPPED_BIT),
]  # fmt: skip
CLIPPING_AFTER_FAULT = [
    (-2048, CLIPPED_BIT), (-2047, CLIPPED_BIT), (-2046, CLIPPED_BIT), (above(-2046), OK), (-2045, OK),
    (0, OK), (2044, OK), (below(2045), OK), (2045, CLIPPED_BIT), (2046, CLIPPED_BIT), (2047, CLIPPED_BIT),
]  # fmt: skip


@each("track", [0, 1])
@each("fault, table", [
    (None, CLIPPING),
    *((fault, CLIPPING_AFTER_FAULT) for fault in ((0.0, 2047.0, 1e3), (-2048.0, 0.0, 1e3), (0.0, 0.0, 0.0))),
])  # fmt: skip
def test_either_end_of_the_converter_is_clipped_and_two_counts_earlier_after_a_fault(
    fault: tuple[float, float, float] | None, table: list[tuple[float, int]], track: int
) -> None:
    for counts, bits in table:
        checks = Supervision(LIMITS)
        assert fault is None or checks.faults(*fault)
        pair = (counts, 0.0) if track == 0 else (0.0, counts)
        assert checks.faults(*pair, 1000.0) == bits, counts
        assert checks.faults(0.0, 0.0, 1000.0) == checks.faults(2046.0, 0.0, 1000.0) == OK


@each("full, margin", [(8, 0), (63, 0), (64, 1), (127, 1), (128, 2), (129, 2), (192, 2), (32768, 2)])
def test_a_small_converter_keeps_its_range(full: int, margin: int) -> None:
    for counts, bits in ((margin, CLIPPED_BIT), (margin + 0.01, OK)):
        for at_end in (-full + counts, full - 1 - counts):
            checks = Supervision(SampleLimits(full, 1, 2))
            assert checks.faults(-full, 0, 1.5) == CLIPPED_BIT
            assert checks.faults(at_end, 0, 1.5) == bits


@each("low, high, narrow_low, narrow_high", [
    (3200, 3627, 3300.0, 3520.25),  # a quarter of the window, 106.75, is less than 1/32 of its upper end
    (3200, 3604, 3300.0, 3503.0),
    (3200, 3596, 3299.0, 3497.0),  # ... and here, 99, also than 1/32 of its lower end
    (1000, 1050, 1012.5, 1037.5),
    (7, 8, 7.21875, 7.75),
    (0, 4, 0.0, 3.875),
])  # fmt: skip
def test_a_narrow_window_of_the_amplitude_stays_open(
    low: int, high: int, narrow_low: float, narrow_high: float
) -> None:
    wanted = [
        (below(narrow_low), False),
        (narrow_low, True),
        (narrow_high, True),
        (above(narrow_high), False),
    ]
    for amplitude, good in wanted:
        checks = Supervision(SampleLimits(2048, low, high))
        assert checks.faults(0.0, 0.0, -1.0)
        assert (checks.faults(0.0, 0.0, amplitude) == OK) == good, amplitude


counts = st.one_of(
    st.integers(-2050, 2050),
    st.sampled_from([-2048, -2047, -2046, -2045, 2044, 2045, 2046, 2047, 400, 412, 413, math.nan, math.inf]),
)


@given(st.lists(st.tuples(counts, counts), min_size=1, max_size=30))
def test_the_chain_checks_as_the_supervision_does(pairs: list[tuple[float, float]]) -> None:
    chain = SignalChain(ChainConfig(amplitude_low_counts=400, amplitude_high_counts=2400, frozen_samples=0))
    checks = Supervision(LIMITS)
    for sine, cosine in pairs:
        got = chain.step(Sample(sine, cosine))
        assert got.status & BOTH == checks.faults(sine, cosine, got.amplitude)
        assert not (got.status & BOTH and got.valid)


# Table 1 gives exactly 1/8 where both tracks are equal: an eighth for the limit makes its edge exact.
@each("sine, bits", [
    (below(1000.0), StatusBit.VALID),
    (1000.0, StatusBit.RESIDUAL | StatusBit.COASTING),
    (above(1000.0), StatusBit.RESIDUAL | StatusBit.COASTING),
    (-1000.0 * (1.0 - 2.0**-40), StatusBit.VALID),
    (-1000.0, StatusBit.RESIDUAL | StatusBit.COASTING),
    (below(-1000.0), StatusBit.RESIDUAL | StatusBit.COASTING),
])  # fmt: skip
@each("coast_samples", [1, 3])
def test_a_residual_of_the_limit_is_a_fault(sine: float, bits: StatusBit, coast_samples: int) -> None:
    chain = SignalChain(ChainConfig(residual_limit=0.125, coast_samples=coast_samples))
    for _ in range(10):
        assert flags(chain.step(Sample(0.0, 1000.0))) == StatusBit.VALID
    got = chain.step(Sample(sine, 1000.0))
    assert flags(got) == bits
    assert got.residual == pytest.approx(0.125)


def test_while_the_speed_is_not_known_a_quarter_of_the_amplitude_is_enough() -> None:
    limits = SampleLimits(2048, 400.0, 1800.0)
    quarter = SampleLimits(2048, 100.0, 1800.0)
    supervision = Supervision(limits)
    supervision.amplitude_known(False)
    assert supervision.bounds == quarter.bounds()
    assert supervision.faults(0.0, 90.0, 90.0) == AMPLITUDE_BIT
    assert supervision.bounds == quarter.bounds(after_fault=True)
    supervision.amplitude_known(True)
    assert supervision.bounds == limits.bounds(after_fault=True)
    supervision.amplitude_known(False)
    assert supervision.bounds == quarter.bounds(after_fault=True)
    assert supervision.faults(0.0, 900.0, 900.0) == 0
    assert supervision.bounds == quarter.bounds()
    supervision.set_limits(limits)
    assert supervision.bounds == limits.bounds()
    supervision.amplitude_known(True)
    assert supervision.bounds == limits.bounds()
    supervision.amplitude_known(False)
    assert supervision.bounds == quarter.bounds()


# A converter that repeats itself, at the limits of speed, shift and repeats.

NEVER = 600


def first_proof(frozen_samples: int, speed: float, limit: float = 1 / 3) -> int:
    """The repeat that is called frozen."""
    frozen = FrozenInput(frozen_samples, limit)
    frozen.speed_cycles = speed
    answers = [frozen.take(True) for _ in range(NEVER)]
    assert set(answers) <= {False, True}
    first = answers.index(True) + 1 if True in answers else NEVER
    assert all(answers[first - 1 :]) or first == NEVER
    return first


@each("sign", [1, -1])
@each("samples", [1, 2, 3, 16, 255])
@each("limit", [1 / 3, 0.125, 0.5])
def test_below_the_residual_limit_a_machine_may_have_stopped(limit: float, samples: int, sign: int) -> None:
    for speed in (0.0, 0.02, limit / 2, below(limit)):
        assert first_proof(samples, sign * speed, limit) == NEVER
    for speed in (limit, above(limit), 0.51, 0.99, 1.0, 1.01, 3.2, 5.0, 83.0, 83.37):
        assert first_proof(samples, sign * speed, limit) == samples


@given(st.lists(st.booleans()), st.integers(1, 5))
@example([False, True, True, False, True], 3)
def test_a_run_ends_before_the_first_row_that_may_freeze(samples: list[bool], frozen_samples: int) -> None:
    taken = FrozenInput(frozen_samples, 0.125).before_row(np.array(samples, bool))
    rows = "".join("=" if equal else "." for equal in samples)
    assert "=" * frozen_samples not in rows[:taken]
    assert not rows[:taken].endswith("=")
    assert rows[taken:].startswith("=" * frozen_samples) or not rows[taken:].strip("=")


def converter_dies(machine: Machine) -> Sample:
    """One more good sample, which is what it repeats."""
    # At whole cycles per interval rounding would decide whether it equals the one before.
    machine.position += machine.speed + 1e-4
    last = at(machine.position)
    machine.chain.step(last)
    return last


@pytest.mark.parametrize("sign", [1, -1])
@each("speed, frozen_samples", [(0.4, 16), (0.5, 2), (3.2, 16), (3.2, 255), (3.0, 1), (3.0, 5), (83.0, 255)])
def test_the_bit_is_set_from_the_proof_on_and_only_while_the_counts_repeat(
    speed: float, frozen_samples: int, sign: int
) -> None:
    drive = moving(sign * speed, frozen_samples=frozen_samples, coast_samples=255)
    repeats, last = frozen_samples, converter_dies(drive)
    still = [drive.spoil(last) for _ in range(repeats + 20)]
    assert has(still, StatusBit.FROZEN) == [k + 1 >= repeats for k in range(repeats + 20)]
    assert not any(flags(got) & StatusBit.VALID for got in still[repeats - 1 :])
    assert not any(has(drive.run(5), StatusBit.FROZEN)), "the converter lives again"


@pytest.mark.parametrize("bad", [1, 2, 3])
@pytest.mark.parametrize("speed", [5.0, 83.0, -5.0])
def test_a_converter_that_dies_with_garbage_before_is_found_too(speed: float, bad: int) -> None:
    drive = moving(speed, frozen_samples=16)
    for _ in range(bad):
        drive.spoil()
    last = converter_dies(drive)
    assert StatusBit.FROZEN in [bit for got in (drive.spoil(last) for _ in range(40)) for bit in flags(got)]


# As many bad samples as 2010:02 allows in a row, cycles per interval^2 (0.0: not known), or fewer.
@given(st.floats(-0.5, 0.5), st.sampled_from([(1, 0.2), (2, 0.0), (2, 0.1), (3, 0.01)]), st.integers(1, 3))
@example(0.3, (3, 0.0), 3)
@example(-0.3, (3, 0.0), 3)
@example(0.2, (3, 0.0), 3)
@example(0.1, (3, 0.0), 3)
def test_bad_samples_at_rest_cost_nothing(glitch: float, most: tuple[int, float], length: int) -> None:
    drive = moving(0.0, frozen_samples=2, max_acceleration_cycles=most[1])
    for k in range(min(length, most[0])):
        drive.chain.step(at(glitch + 0.001 * k))
    after = drive.run(40)
    assert not any(has(after, StatusBit.FROZEN))
    assert after[-1].valid
    assert abs(drive.error(after[-1])) < 1e-9


@given(
    st.lists(st.tuples(st.integers(0, 2), st.integers(0, 2)), min_size=1, max_size=12),
    st.tuples(st.integers(0, 2), st.integers(0, 2)),
)
def test_repeats_are_pairs_like_the_one_before(pairs: list[tuple[int, int]], before: tuple[int, int]) -> None:
    sine, cosine = np.array(pairs, np.int16).T
    wanted = [new == old for old, new in pairwise([before, *pairs])]
    found = repeats(sine, cosine, before, np.ones(len(pairs) + 2, np.bool_))
    assert ([False] * len(pairs) if found is None else found.tolist()) == wanted
    assert (found is None) == (not any(wanted))


@each("samples, speed, stands", [(4, 0.1, True), (4, -0.9, False), (4, 0.3, False), (0, 0.9, True)])
def test_a_machine_stands_where_no_number_of_repeats_is_a_fault(
    samples: int, speed: float, stands: bool
) -> None:
    frozen = FrozenInput(samples, 0.3)
    assert not frozen.stands
    frozen.speed_cycles = speed
    assert not frozen.stands
    flagged = [frozen.take(True)]
    assert frozen.stands is stands
    flagged += [frozen.take(True) for _ in range(20)]
    assert any(flagged) is not stands
    assert not frozen.take(False)
    assert not frozen.stands
    assert frozen.repeats == 0
