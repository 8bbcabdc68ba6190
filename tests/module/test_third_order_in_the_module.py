"""2010:07 and 2010:08 through the module: limits, the change while it runs, the prediction to the SYNC."""

from __future__ import annotations

import math
from itertools import accumulate

import pytest
from canopen import SdoAbortedError
from module_bench import Bench

from canfb.module.module_config import ModuleConfig
from canfb.objects import StatusBit
from folding import each

ACCELERATION = 2 * math.pi / 2500 * 1e6  # rad/s^2 that are one cycle per interval squared at 1 kHz
JERK = 2 * math.pi / 2500 * 1e9


def ramp(top: float, step: float, samples: int) -> list[float]:
    """Positions whose acceleration grows to ``top`` by ``step`` each interval, after ten at standstill."""
    rates = [0.0] * 10 + [min(step * k, top) for k in range(samples)]
    return list(accumulate(accumulate(rates)))


def test_as_delivered_it_is_the_second_order(bench: Bench) -> None:
    assert (bench.sdo[0x2010][7].raw, bench.sdo[0x2010][8].raw) == (2, 0.0)
    statuses = [bench.at(x)[1] for x in ramp(3.0, 0.2, 20)]
    assert any(status & StatusBit.RESIDUAL for status in statuses)


def test_with_the_third_an_acceleration_of_cycles_is_followed(make_bench: type[Bench]) -> None:
    bench = make_bench(prediction_order=3, max_jerk_rad_s3=0.2 * JERK)
    bench.start()
    assert (bench.sdo[0x2010][7].raw, bench.sdo[0x2010][8].raw) == (3, pytest.approx(0.2 * JERK))
    positions = ramp(3.0, 0.2, 25)
    for x in positions:
        got, status, _ = bench.at(x)
        assert status == StatusBit.VALID
    assert got == pytest.approx(positions[-1] * 8192, abs=40)
    assert bench.sdo[0x2011][9].raw == pytest.approx(3.0 * ACCELERATION, rel=0.01)
    bench.sdo[0x2010][8].raw = 0.01 * JERK  # and now a jerk of 0.2 is too much
    assert bench.at(positions[-1] + (positions[-1] - positions[-2]) + 3.2)[1] & StatusBit.RESIDUAL


def test_the_order_is_written_while_the_machine_turns(bench: Bench) -> None:
    positions = [0.25 * k for k in range(40)]
    for k, x in enumerate(positions):
        if k in (10, 30):
            bench.sdo[0x2010][7].raw = 3 if k == 10 else 2
        got, status, _ = bench.at(x)
        assert (got, status) == (pytest.approx(x * 8192, abs=40), StatusBit.VALID)


@each("subindex, value", [(7, 1), (7, 4), (8, -1.0), (8, math.nan), (8, 2e15)])
def test_values_that_are_not_good_are_refused(bench: Bench, subindex: int, value: float) -> None:
    before = bench.sdo[0x2010][subindex].raw
    with pytest.raises(SdoAbortedError):
        bench.sdo[0x2010][subindex].raw = value
    assert bench.sdo[0x2010][subindex].raw == before


@each("key, value", [("prediction_order", 1), ("prediction_order", 2.0), ("max_jerk_rad_s3", -1.0)])
def test_a_configuration_that_is_not_good_is_refused(key: str, value: object) -> None:
    with pytest.raises(ValueError, match=key):
        ModuleConfig(node_id=3, **{key: value})  # type: ignore[arg-type]


def test_a_position_ahead_of_an_unknown_acceleration_is_not_valid(make_bench: type[Bench]) -> None:
    """One lost ADC PDO at two cycles per interval squared: no extrapolated position is valid and wrong."""
    bench = make_bench(prediction_order=3, max_jerk_rad_s3=0.05 * JERK, predict=1)
    bench.sdo[0x1800][2].raw = 1
    bench.start()
    positions = ramp(2.0, 0.04, 120)
    valid = []
    for k, x in enumerate(positions[:-1]):
        sent = bench.sync()
        if k:  # the position of this very SYNC
            units, status, _ = bench.position(sent)
            valid.append(bool(status & StatusBit.VALID))
            error = (units - x * 8192 + 2**31) % 2**32 - 2**31
            assert not (valid[-1] and abs(error) > 0.5 * 8192), (k, error / 8192, hex(status))
        if k != 80:
            bench.counts(round(1500 * math.sin(2 * math.pi * x)), round(1500 * math.cos(2 * math.pi * x)))
    assert not all(valid[80:84])
    assert all(valid[90:])
