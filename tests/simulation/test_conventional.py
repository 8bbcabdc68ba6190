"""The conventional method where two examples show it; the claims of the paper count its wrong positions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.simulation.conventional import conventional_position, hardware_counter, quadrant
from canfb.simulation.encoder import Encoder

IDEAL = Encoder()


def test_quadrants_follow_the_cycle() -> None:
    middle = 2.0 * np.pi * np.array([0.125, 0.375, 0.625, 0.875])
    assert quadrant(np.sin(middle), np.cos(middle)).tolist() == [0, 1, 2, 3]
    assert quadrant(0.0, 1.0) == 0, "the positive zero crossing begins the cycle"


@given(st.floats(-1e6, 1e6))
def test_counter_counts_positive_zero_crossings(position: float) -> None:
    cycles, _ = hardware_counter(IDEAL, position)
    away = abs(position - round(position)) > 1e-8
    assert not away or cycles == np.floor(position)


def test_the_fix_corrects_a_count_that_was_read_at_another_instant() -> None:
    found = conventional_position(IDEAL, [4.99], [5.01], fix=False)
    assert (found.cycles[0], found.counter_quadrant[0], found.adc_quadrant[0]) == (5, 0, 3)
    assert 0.98 < found.phase[0] < 1.0
    assert conventional_position(IDEAL, [4.99], [5.01]).cycles[0] == 4
    assert conventional_position(IDEAL, [5.01], [4.99]).cycles[0] == 5
    with pytest.raises(ValueError, match="one shape"):
        conventional_position(IDEAL, [1.0, 2.0], [1.0])
