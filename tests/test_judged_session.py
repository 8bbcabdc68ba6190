"""The judge of a session: it finds what is wrong or lost, and nothing else."""

import struct

import pytest

from canfb.cli.config_file import EXAMPLE
from canfb.configuration import parse_config
from canfb.objects import StatusBit
from judged_session import Judge, TrueMotion

TRUTH = TrueMotion(parse_config(EXAMPLE))
PERIOD_TICKS = 100_000  # at 100 Hz
FIRST_TICKS = 2**32 - 5_000_000  # the clock of the interface begins anywhere, and wraps
VALID = StatusBit.VALID


def played(
    judge: Judge, numbers: range, *, shift_cycles: float = 0.0, status: int = VALID, late: int = 0
) -> None:
    """Samples with these numbers at 100 Hz, and the positions of the module, so many samples later."""
    units = TRUTH.units_per_cycle
    for number in numbers:
        ticks = (FIRST_TICKS + number * PERIOD_TICKS) % 2**32
        judge.take(0x190, struct.pack("<hhI", 0, 0, ticks), 0.01 * number)
        if number - late in numbers:
            position = TRUTH.at(0.01 * (number - late)) + shift_cycles * units
            data = struct.pack("<IHH", round(position) % 2**32, status, 0)
            judge.take(0x1A0, data, 0.01 * number + 0.001)


@pytest.mark.parametrize("late", [0, 3])
def test_right_positions_are_right_from_standstill_to_full_speed(late: int) -> None:
    judge = Judge(TRUTH)
    played(judge, range(4000), late=late)
    assert (judge.samples, judge.valid, judge.wrong, judge.lost) == (4000, 4000 - late, 0, False)
    assert judge.longest_interval_s == pytest.approx(0.01)


@pytest.mark.parametrize(
    ("shift_cycles", "status", "wrong"),
    [(1.0, VALID, 10), (-1.0, VALID, 10), (0.6, VALID, 10), (1.0, StatusBit.LOST, 0)],
)
def test_a_wrong_count_is_wrong_where_it_is_valid(shift_cycles: float, status: int, wrong: int) -> None:
    judge = Judge(TRUTH)
    played(judge, range(1000))
    played(judge, range(1000, 1010), shift_cycles=shift_cycles, status=status)
    assert (judge.wrong, judge.lost) == (wrong, not wrong)
