from __future__ import annotations

import numpy as np
import pytest

from canfb.calibration.figures import error_harmonics
from canfb.calibration.result import Reason


def test_reasons_keep_their_numbers():
    # Object 2030:07 holds the number.
    assert list(Reason) == [
        "accepted",
        "samples",
        "clipped",
        "ellipse",
        "coverage",
        "cycles",
        "locked",
        "noise",
        "monotonic",
        "speed",
        "interrupted",
        "failed",
        "changed",
    ]
    assert [Reason.of_number(n) for n in range(len(Reason))] == list(Reason)
    assert [reason.number for reason in Reason] == list(range(len(Reason)))
    assert Reason.of_number(len(Reason)) is Reason.FAILED


def test_harmonics_of_the_error_are_found_and_sorted():
    phase = np.arange(1024) / 1024
    angle = phase + 0.003 * np.cos(4.0 * np.pi * phase + 0.5) + 0.01 * np.cos(6.0 * np.pi * phase - 2.0) + 0.2
    found = error_harmonics(phase, angle, 1e-4)
    assert [h.order for h in found] == [3, 2]
    assert found[0].amplitude_cycles == pytest.approx(0.01, rel=1e-6)
    assert found[0].angle_rad == pytest.approx(-2.0, abs=1e-6)
    assert found[1].amplitude_cycles == pytest.approx(0.003, rel=1e-6)
    assert error_harmonics(phase, angle, 0.005) == found[:1]
