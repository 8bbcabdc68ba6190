from __future__ import annotations

from canfb.calibration.result import Reason


def test_reasons_keep_their_numbers():
    # Object 2030:07 holds the number.
    names = "accepted samples clipped ellipse coverage cycles locked noise monotonic speed interrupted failed"
    assert " ".join(Reason) == f"{names} changed"
    assert [Reason.of_number(n) for n in range(len(Reason))] == list(Reason)
    assert [reason.number for reason in Reason] == list(range(len(Reason)))
    assert Reason.of_number(len(Reason)) is Reason.FAILED
