"""The NMT state of a node that answers SDO, by heartbeat or node guarding; and a restart that is noticed."""

from __future__ import annotations

import struct

import pytest

from canfb.cia301.frame import Frame
from canfb.cia301.nmt import NmtState
from canfb.master.access import CommissioningError
from canfb.master.all_or_nothing import check_unlocked
from canfb.master.node_state import nmt_state, state_in, without_restart
from commissioning_kit import MODULE_ID, Bench, heard

ERROR_CONTROL = 0x700 + MODULE_ID


@pytest.mark.parametrize("operational", [True, False])
@pytest.mark.parametrize("heartbeat_ms", [0, 200])
def test_the_state_without_a_single_sample(operational: bool, heartbeat_ms: int) -> None:
    bench = Bench(sync=False, operational=operational)
    bench.access.write(0x1017, 0, "H", heartbeat_ms)
    frames = heard(bench)
    expected = NmtState.OPERATIONAL if operational else NmtState.PRE_OPERATIONAL
    assert nmt_state(bench.access) is expected
    assert any(frame.rtr for frame in frames) == (not heartbeat_ms), "asked only where there is no heartbeat"


def test_a_node_that_a_master_guards_is_not_asked() -> None:
    bench = Bench(sync=False)
    bench.access.write(0x100C, 0, "H", 100)
    frames = heard(bench)
    polled = [0.0]

    def guard(now: float) -> None:
        if now - polled[0] >= 0.1:
            polled[0] = now
            bench.bus.send(Frame(ERROR_CONTROL, b"", True))

    bench.master.on_wait = guard
    assert nmt_state(bench.access) is NmtState.OPERATIONAL
    assert sum(frame.rtr for frame in frames) == 1, "that of the master"


def test_a_lost_remote_frame_is_sent_again() -> None:
    bench = Bench(sync=False)
    receive, lost = bench.module.receive, [2]

    def losing(frame: Frame, now: float) -> list[Frame]:
        if frame.rtr and lost[0]:
            lost[0] -= 1
            return []
        return receive(frame, now)

    bench.module.receive = losing  # type: ignore[method-assign]
    assert nmt_state(bench.access) is NmtState.OPERATIONAL
    lost[0] = 3
    with pytest.raises(CommissioningError, match=r"NMT state is not known: neither .* \(720h\) is heard"):
        nmt_state(bench.access)


@pytest.mark.parametrize(
    ("data", "state"),
    [
        (b"\x00", NmtState.PRE_OPERATIONAL),
        (b"\x85", NmtState.OPERATIONAL),
        (b"\x04", NmtState.STOPPED),
        (b"\x33", None),
        (b"", None),
        (struct.pack("<H", 5), None),
    ],
)
def test_what_a_frame_says(data: bytes, state: NmtState | None) -> None:
    assert state_in(data) is state


def test_a_restart_is_noticed() -> None:
    bench = Bench(sync=False)
    with without_restart(bench.access):
        bench.access.write(0x1017, 0, "H", 5)
        bench.master.wait(0.1)
    with (
        pytest.raises(CommissioningError, match=r"was restarted meanwhile \(boot-up heard\)"),
        without_restart(bench.access),
    ):
        bench.bus.send(Frame(0x000, bytes((0x81, MODULE_ID))))


def test_a_lock_is_said_before_the_measurement() -> None:
    bench = Bench(sync=False, operational=False, config={"write_lock": "preop"})
    check_unlocked(bench.access)
    bench.bus.send(Frame(0x000, bytes((0x01, MODULE_ID))))
    with pytest.raises(CommissioningError, match=r"module 32 \(20h\) is locked \(2040h\)"):
        check_unlocked(bench.access)
