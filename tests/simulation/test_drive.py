"""The simulated drive: SYNC at its times, positions unwrapped."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.cia301.frame import Frame
from canfb.simulation.sync_producer import POSITION_PDO, Drive

COB_ID = 0x1A0


def pdo(position: int, status: int = 1, residual: int = 0) -> Frame:
    return Frame(COB_ID, POSITION_PDO.pack(position, status, residual))


def test_no_sync_before_it_is_asked_for() -> None:
    drive = Drive(0.001, COB_ID, 1000)
    assert drive.start(0.0) == []
    assert drive.deadline() is None
    assert drive.tick(5.0) == []


def test_the_nth_sync_comes_n_periods_after_the_start_without_drift() -> None:
    drive = Drive(0.001, COB_ID, 1000)
    drive.start_sync(2.0)
    for n in range(10_000):
        at = drive.deadline()
        assert at == 2.0 + n * 0.001
        assert drive.tick(at) == [Frame(0x80, b"")]
    assert drive.syncs == 10_000
    assert drive.tick(2.0) == []


def test_a_position_pdo_is_taken_apart() -> None:
    drive = Drive(0.001, COB_ID, 1 << 32)
    drive.start_sync(0.0)
    drive.tick(0.0)
    assert drive.receive(pdo(123456, 0x0081, 32768), 0.0) == []
    consumed = drive.consumed
    assert (consumed.sync_number, consumed.position_units) == ([1], [123456])
    assert (consumed.status, consumed.residual_cycles) == ([0x0081], [0.5])


@pytest.mark.parametrize(
    "frame",
    [Frame(COB_ID + 1, bytes(8)), Frame(COB_ID, bytes(7)), Frame(COB_ID, b""), Frame(0x80, b"")],
    ids=["another node", "short", "empty", "SYNC"],
)
def test_every_other_frame_is_none_of_its_business(frame: Frame) -> None:
    drive = Drive(0.001, COB_ID, 1000)
    assert drive.receive(frame, 0.0) == []
    assert drive.consumed.status == []


@given(st.integers(3, 2**32), st.data())
def test_positions_are_unwrapped_as_long_as_each_step_is_below_half_the_range(
    total_range: int, data: st.DataObject
) -> None:
    largest = (total_range - 1) // 2
    steps = data.draw(st.lists(st.integers(-largest, largest), max_size=50))
    start = data.draw(st.integers(0, total_range - 1))
    drive = Drive(0.001, COB_ID, total_range)
    truth = [start]
    for step in steps:
        truth.append(truth[-1] + step)
    for position in truth:
        drive.receive(pdo(position % total_range), 0.0)
    assert drive.consumed.position_units == truth
