"""How old a position is when it is sent, for every pair of transmission types; and what the rest is worth."""

from __future__ import annotations

import math

import pytest
from latency_bench import ADC_DELAY, REMOTE_DELAY, Timeline

from canfb.objects import StatusBit

STEP = 0.25  # cycles from sample to sample: the position tells which sample it is of
AT_ONCE, AT_SYNC = (254, 255), (0, 1, 2)


def steady(k: int) -> float:
    return STEP * k


def expected_age(rpdo: int, tpdo: int) -> float:
    """Age of a position PDO in SYNC periods, from the instant at which the tracks were sampled."""
    if tpdo in AT_ONCE:
        return ADC_DELAY if rpdo in AT_ONCE else 1.0
    if tpdo == 253:  # the newest when the remote frame comes
        return REMOTE_DELAY if rpdo in AT_ONCE else 1.0 + REMOTE_DELAY
    return 1.0 + REMOTE_DELAY if tpdo == 252 else 1.0


@pytest.mark.parametrize("tpdo", [0, 1, 2, 240, 252, 253, 254, 255])
@pytest.mark.parametrize("rpdo", [0, 1, 2, 240, 254, 255])
def test_age_by_transmission_types(rpdo: int, tpdo: int) -> None:
    timeline = Timeline(steady)
    timeline.types(rpdo, tpdo)
    timeline.start()
    remote = tpdo in (252, 253)
    timeline.run(4, remote=remote)
    periods = 480 if tpdo == 240 else 12
    sent = timeline.run(periods, remote=remote)
    assert len(sent) == {2: periods // 2, 240: 2}.get(tpdo, periods)
    for one in sent:
        assert one.status == StatusBit.VALID
        assert one.at - round(one.cycles / STEP) == pytest.approx(expected_age(rpdo, tpdo), abs=1e-6)


@pytest.mark.parametrize("rpdo", [1, 255])
@pytest.mark.parametrize("tpdo", [0, 1, 254])
def test_a_missed_sample_is_told_at_the_sync_after_it(rpdo: int, tpdo: int) -> None:
    timeline = Timeline(steady)
    timeline.types(rpdo, tpdo)
    timeline.missing = {20}
    timeline.start()
    sent = timeline.run(25)
    told = [one.at for one in sent if one.status & StatusBit.MISSED]
    assert told == pytest.approx([21.0], abs=1e-6)
    assert timeline.bench.sdo[0x2012][1].raw == 1


# Speed and acceleration are differences of positions: they have an age of their own.

JERK, START = 0.001, 0.2  # cycles per period cubed; cycles per period


def jerky(k: float) -> float:
    return START * k + JERK * k**3 / 6.0


def test_speed_is_that_of_half_an_interval_before_its_sample_and_acceleration_of_one() -> None:
    timeline = Timeline(jerky)
    timeline.start()
    timeline.run(40)
    last = timeline.syncs - 1
    sdo, rad = timeline.bench.sdo, 2 * math.pi

    def speed(k: float) -> float:
        return START + JERK * k**2 / 2.0

    per_s = 1.0 / timeline.period_s
    assert sdo[0x2011][7].raw == pytest.approx(rad * speed(last - 0.5) * per_s, rel=2e-4)
    assert abs(sdo[0x2011][7].raw - rad * speed(last) * per_s) > 0.01 * rad * speed(last) * per_s
    assert sdo[0x2011][9].raw == pytest.approx(rad * JERK * (last - 1) * per_s**2, rel=2e-3)
    assert sdo[0x6030][1].raw == round(speed(last - 0.5) * per_s * 60) or sdo[0x6030][1].raw == 0x7FFF
    # The residual is the size of the same second difference.
    assert sdo[0x2011][2].raw / 65536 == pytest.approx(JERK * (last - 1), abs=1e-4)
