from __future__ import annotations

import numpy as np
import pytest

from canfb.calibration.motion_blocks import cut

NO_BREAKS = np.zeros(0, np.int64)


def _all(n: int) -> np.ndarray:
    return np.ones(n, np.bool_)


@pytest.mark.parametrize(("n", "length"), [(100, 16), (97, 16), (16, 16), (1000, 64), (7, 32)])
def test_every_sample_is_in_one_block(n, length):
    blocks = cut(np.arange(n, dtype=float), _all(n), NO_BREAKS, length)
    assert sorted(blocks.index[blocks.used]) == list(range(n))
    assert blocks.samples == n
    assert blocks.freedom == n - 4 * len(blocks)


def test_no_block_reaches_over_a_break():
    breaks = np.array([33, 40, 42])
    blocks = cut(np.arange(100.0), _all(100), breaks, 16)
    for index, used in zip(blocks.index, blocks.used, strict=True):
        inside = index[used]
        assert not any(inside.min() < at <= inside.max() for at in breaks)
    # Two samples between 40 and 42 are too few for a block.
    assert blocks.samples == 98


def test_invalid_samples_and_blocks_without_enough_are_left_out():
    valid = _all(64)
    valid[3], valid[16:28] = False, False
    blocks = cut(np.arange(64.0), valid, NO_BREAKS, 16)
    assert len(blocks) == 3
    assert 3 not in blocks.index[blocks.used]
    assert blocks.samples == 47


@pytest.mark.parametrize("terms", [4, 12])
def test_polynomials_of_uneven_times_are_followed(terms):
    rng = np.random.default_rng(1)
    time = np.cumsum(rng.uniform(0.5, 2.0, 640))
    blocks = cut(time, _all(640), NO_BREAKS, 32, terms)
    curve = np.polynomial.Polynomial(rng.normal(0.0, 1.0, terms))
    inside = np.array([2.0 * (t - t[0]) / (t[-1] - t[0]) - 1.0 for t in time[blocks.index]])
    values = curve(inside)
    found = blocks.evaluate(blocks.smooth(values))
    np.testing.assert_allclose(found, values, atol=1e-8)
    more = curve * np.polynomial.Polynomial([0.0, 1.0])
    rough = more(inside)
    assert np.abs(blocks.evaluate(blocks.smooth(rough)) - rough).max() > 1e-4


def test_informative_blocks_meet_half_of_the_eighths():
    at = np.arange(16.0)
    position = np.array([0.0 * at, at / 2.0, at / 4.0, at / 40.0 + 5.2, at / 16.0])
    blocks = cut(np.arange(80.0), _all(80), NO_BREAKS, 16)
    assert blocks.informative(position).tolist() == [False, False, True, True, True]
