"""One bus, several users: who hears what, and what is not sent."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from uuid import uuid4

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.bus.bus_master import BusMaster
from canfb.bus.shared_bus import SharedBus, only_reads
from canfb.errors import BusError
from fake_bus import message

AT_ONCE_S, PATIENCE_S = 0.0, 30.0
UPLOAD = b"\x40" + bytes(7)


@pytest.fixture
def channel() -> str:
    return f"shared {uuid4()}"


@pytest.fixture
def other(channel: str) -> Iterator[can.BusABC]:
    with can.Bus(interface="virtual", channel=channel) as bus:
        yield bus


@pytest.fixture
def shared(channel: str) -> Iterator[SharedBus]:
    with SharedBus(can.Bus(interface="virtual", channel=channel)) as bus:
        yield bus


def test_all_hear_and_all_send(shared: SharedBus, other: can.BusABC) -> None:
    branch = shared.branch()
    other.send(message(0x1A0))
    for bus in (shared, branch):
        heard = bus.recv(PATIENCE_S)
        assert heard is not None
        assert heard.arbitration_id == 0x1A0
        bus.send(message(0x601, UPLOAD))
        sent = other.recv(PATIENCE_S)
        assert sent is not None
        assert sent.arbitration_id == 0x601
    branch.shutdown()
    other.send(message(0x1A1))
    assert shared.recv(PATIENCE_S) is not None  # it still runs
    assert branch.recv(AT_ONCE_S) is None


def test_a_branch_has_filters_of_its_own(shared: SharedBus, other: can.BusABC) -> None:
    branch = shared.branch()
    branch.set_filters([{"can_id": 0x5A0, "can_mask": 0x7FF, "extended": False}])
    for can_id in (0x1A0, 0x5A0):
        other.send(message(can_id))
        assert shared.recv(PATIENCE_S) is not None
    heard = branch.recv(PATIENCE_S)
    assert heard is not None
    assert heard.arbitration_id == 0x5A0
    assert branch.recv(AT_ONCE_S) is None
    branch.shutdown()


def test_what_is_no_upload_is_not_sent(shared: SharedBus, other: can.BusABC) -> None:
    for bus in (shared, shared.branch()):
        with pytest.raises(can.CanOperationError, match="SDO uploads alone"):
            bus.send(message(0x601, b"\x23" + UPLOAD[1:]))
    assert other.recv(AT_ONCE_S) is None


FRAMES = st.builds(
    can.Message,
    arbitration_id=st.one_of(st.integers(0, 0x7FF), st.integers(0x600, 0x680)),
    data=st.binary(max_size=8),
    is_extended_id=st.booleans(),
    is_remote_frame=st.booleans(),
)


@given(FRAMES)
def test_only_uploads_may_be_sent(sent: can.Message) -> None:
    upload = (
        0x601 <= sent.arbitration_id <= 0x67F
        and len(sent.data) == 8
        and sent.data[0] >> 5 in (2, 3, 4, 5)
        and not sent.is_extended_id
        and not sent.is_remote_frame
    )
    assert only_reads(sent) is upload


def test_a_bus_that_fails_fails_for_all(channel: str, monkeypatch: pytest.MonkeyPatch) -> None:
    inner = can.Bus(interface="virtual", channel=channel)

    def gone(timeout: float | None) -> None:
        raise can.CanOperationError("the adapter is gone")

    monkeypatch.setattr(inner, "recv", gone)
    with SharedBus(inner) as shared, BusMaster(shared.branch()) as master:
        with pytest.raises(can.CanOperationError):
            shared.recv(AT_ONCE_S)
        with pytest.raises(BusError, match="the adapter is gone"):
            master.wait(PATIENCE_S)


def test_a_master_reads_while_another_thread_receives(shared: SharedBus, other: can.BusABC) -> None:
    """An SDO upload over a branch, answered by the other end; the frames arrive in the other thread."""
    done = threading.Event()

    def receive() -> None:
        while not done.is_set():
            shared.recv(0.05)

    def answer() -> None:
        while not done.is_set():
            asked = other.recv(0.05)
            if asked is not None:
                other.send(message(0x5A0, b"\x43" + bytes(asked.data[1:4]) + b"\x78\x56\x34\x12"))

    threads = [threading.Thread(target=one) for one in (receive, answer)]
    for one in threads:
        one.start()
    try:
        with BusMaster(shared.branch(), PATIENCE_S) as master:
            assert master.sdo(0x20) is master.sdo(0x20)
            assert master.sdo(0x20).upload(0x1000, 0) == b"\x78\x56\x34\x12"
    finally:
        done.set()
        for one in threads:
            one.join()
