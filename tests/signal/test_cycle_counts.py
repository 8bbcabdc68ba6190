from __future__ import annotations

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st

from canfb.signal.blocks import Scratch
from canfb.signal.tracker import EXACT, ROW, cycle_counts

sizes = st.sampled_from([0, 1, -1, 5, -(2**31), 2**40, EXACT - 1, EXACT, -EXACT, 2**55, -(2**60)])


@given(st.lists(st.integers(-2, 2), min_size=1, max_size=5 * ROW), sizes, sizes)
@example([2] * (5 * ROW), EXACT - 1, 0)
@example([-2, 2] * (2 * ROW), 0, EXACT // (4 * ROW) - 1)
@example([1] * ROW, 2**60 + 1, 3)
def test_the_counts_are_those_of_the_recursion(turns: list[int], cycles: int, step: int) -> None:
    if abs(cycles) + abs(step) * len(turns) > 2**62:
        step = 0
    out = np.empty(len(turns), np.int64)
    scratch = Scratch(len(turns))
    scratch.b[:] = turns
    last = cycle_counts(scratch.b, cycles, step, out, scratch)
    for turn, got in zip(turns, out.tolist(), strict=True):
        step += turn
        cycles += step
        assert got == cycles
    assert last == step
