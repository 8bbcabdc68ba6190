"""The model that test_module_machine compares with is right where the truth is known."""

from __future__ import annotations

import pytest
from reference_model import RANGE, ReferenceModel

from canfb.objects import StatusBit as Bit
from ideal_tracks import counts_at

MOST_ACCELERATION = 0.06  # cycles per interval^2


@pytest.mark.parametrize("speed", [0.0, 0.2, 7.25])
def test_the_model_follows_the_machine(speed: float) -> None:
    """No fault, and a gap that is bridged."""
    model = ReferenceModel()
    position = step = 0.0
    for k in range(400):
        step += max(-MOST_ACCELERATION, min(speed - step, MOST_ACCELERATION))
        position += step
        if k in (200, 201):
            missed = model.missed()
            assert missed is not None
            assert missed.status == Bit.COASTING | Bit.MISSED
            continue
        published = model.sample(*counts_at(position))
        assert published.status == Bit.VALID
        assert abs((published.position - position * 8192 + RANGE // 2) % RANGE - RANGE // 2) < 0.0125 * 8192
