"""A converter that repeats itself, at the limits of speed, shift and repeats."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from witness_kit import Machine, above, at, below, flags, has, moving

from canfb.objects import StatusBit
from canfb.signal.sample import Sample
from canfb.signal.supervision import FrozenInput, repeats
from folding import each

NEVER = 600


def first_proof(frozen_samples: int, speed: float, limit: float = 1 / 3) -> int:
    """The repeat that is called frozen."""
    frozen = FrozenInput(frozen_samples, limit)
    answers = [frozen.repeated(speed) for _ in range(NEVER)]
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
@pytest.mark.parametrize(
    ("speed", "frozen_samples"), [(0.4, 16), (0.5, 2), (3.2, 16), (3.2, 255), (3.0, 1), (3.0, 5), (83.0, 255)]
)
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


@pytest.mark.parametrize("glitch", [0.3, -0.3, 0.2, 0.1])
@pytest.mark.parametrize("length", [1, 2, 3])
def test_a_glitch_at_rest_is_no_reason_to_call_the_next_samples_frozen(glitch: float, length: int) -> None:
    drive = moving(0.0, frozen_samples=2)
    drive.step()
    for k in range(length):
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
    flagged = [frozen.repeated(speed)]
    assert frozen.stands is stands
    flagged += [frozen.repeated(speed) for _ in range(20)]
    assert any(flagged) is not stands
    frozen.moved()
    assert not frozen.stands
    assert frozen.repeats == 0
