"""The NMT state of a node that answers SDO, its restart; and `canfb node reset`, at standstill only."""

import re
import struct
from collections.abc import Callable

import pytest

from canfb.cia301.codes import NmtState
from canfb.cia301.frame import Frame
from canfb.cli import printing
from canfb.master.access import CommissioningError, nmt_state, state_in, without_restart
from canfb.master.all_or_nothing import check_unlocked
from canfb.simulation.embedded_bus import REGULAR, SyncProducer
from canfb.simulation.encoder import Motion, Ramp, Ripple
from commissioning_kit import CYCLES, MODULE_ID, RATE_HZ, Bench, heard, lose, running
from folding import each
from node_commands import Commands, between


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
            bench.bus.send(Frame(0x700 + MODULE_ID, b"", True))

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


@each("data, state", [
    (b"\x00", NmtState.PRE_OPERATIONAL),
    (b"\x85", NmtState.OPERATIONAL),
    (b"\x04", NmtState.STOPPED),
    (b"\x33", None),
    (b"", None),
    (struct.pack("<H", 5), None),
])  # fmt: skip
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


NODE = hex(MODULE_ID)
STILL = Motion((), ())


def test_a_lost_position_comes_back_at_standstill(canfb: Commands, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(printing, "LINE_EVERY_S", 0.0)
    bench = lose(running(motion=STILL))
    out, err = canfb(bench, "node", "reset", NODE)
    parts = [int(part) for part in re.findall(r"(\d+) %", err)]
    assert (parts, parts[0], parts[-1]) == (sorted(parts), 0, 99), "it says how far it has watched"
    assert out.startswith("node 32 (20h): reset and started; position valid, machine still, within 0.00")
    assert bench.value(0x2011, 1) & 1
    figures = canfb(bench, "node", "reset", NODE, "--json").json
    assert figures["position"] == "valid"
    assert figures["forced"] is False
    assert 0.0 < figures["spread_cycles"] < 0.01


@pytest.mark.parametrize("rpm", [0.6, 61.0, -610.0])
def test_a_machine_that_turns_is_refused_whether_it_is_lost_or_not(canfb: Commands, rpm: float) -> None:
    bench = running(motion=Motion((), (), rpm))
    frames = heard(bench)
    for _ in range(2):
        _, err = canfb(bench, "node", "reset", NODE, code=1)
        assert "the machine moves" in err
        lose(bench)
    assert 0x720 not in [frame.can_id for frame in frames], "nothing was reset"


def silent() -> Bench:
    """A missed sample is no sample."""
    bench = running(motion=STILL)
    bench.source.change = lambda counts: None
    return bench


def at_a_whole_cycle() -> Bench:
    """For each sample: its phase stands still, and the count does not."""
    bench = running(motion=Motion((Ramp(1.0, 60.0 * RATE_HZ / CYCLES),)))
    bench.bus.run_until(3.0)
    return bench


def slow(rate_hz: float) -> Bench:
    """Lost in motion; it stands still for 60 samples."""
    bench = Bench(motion=Motion((Ramp(0.05, 7.0), Ramp(0.05, 0.0))), sync=False)
    bench.bus.attach(SyncProducer(1.0 / rate_hz, REGULAR))
    bench.source.change = lambda counts: None if 40.0 < bench.bus.now * rate_hz < 50.0 else counts
    bench.bus.run_until(160.0 / rate_hz)
    assert bench.value(0x2011, 1) & 4
    return bench


def deaf_once_it_is_reset() -> Bench:
    bench = running(motion=STILL)
    frames = heard(bench)
    between(bench, lambda frame: [] if 0x720 in [one.can_id for one in frames] else None)
    return bench


def unplugged_by_the_reset() -> Bench:
    bench = running(motion=STILL)
    receive = bench.module.receive
    bench.module.receive = lambda frame, now: receive(frame, now) if frame.can_id else []  # type: ignore[method-assign]
    return bench


# A millicycle to and fro, around a place where the phase wraps.
HELD = Motion((), (Ripple(60.0 * 0.001 * 6.28 * 5.0 / CYCLES, 5.0),))
TURNS, STARTS = Motion((), (), 0.6), Motion((Ramp(1.2, 0.0), Ramp(0.3, 20.0)))


@pytest.mark.parametrize(("made", "options", "words"), [
    (lambda: running(motion=HELD), (), "position valid"),
    (lambda: running(motion=STILL), ("--force",), "machine not looked at"),
    (lambda: running(motion=TURNS), ("--force",), "reset and started, but its position is lost"),
    (lambda: running(motion=STARTS), (), "began to move while it was reset"),
    (lambda: slow(5.0), (), "position valid"),
    (lambda: slow(100.0), (), "position valid"),
    (lambda: running(motion=STILL, sync=False), (), "so it is not known whether the machine stands still"),
    (deaf_once_it_is_reset, (), "done: node 32 (20h) is reset and started; but then node 32"),
    (unplugged_by_the_reset, (), "done: the reset of node 32 (20h) is sent; but then no boot-up within 5 s"),
    (silent, (), "so it is not known whether the machine stands still"),
    (at_a_whole_cycle, (), "the machine moves, it has moved by +"),
])  # fmt: skip
def test_what_is_said_of_a_reset(
    canfb: Commands, made: Callable[[], Bench], options: tuple[str, ...], words: str
) -> None:
    succeeds, bench = words in ("position valid", "machine not looked at"), made()
    frames = heard(bench)
    assert words in "".join(canfb(bench, "node", "reset", NODE, *options, code=0 if succeeds else 1))
    assert sum(frame.can_id == 0x600 + MODULE_ID for frame in frames) < 5000, "a slow SYNC is not hurried"


def test_a_position_that_is_lost_again_at_once_is_told(canfb: Commands) -> None:
    bench = running(motion=STILL)
    bench.module.dictionary.entry(0x2001, 3).value = 410
    reset_from = bench.bus.now

    def weak(counts: tuple[float, float]) -> tuple[float, float]:
        late = bench.bus.now > reset_from + 0.3
        return (counts[0] // 9, counts[1] // 9) if late else counts

    bench.source.change = weak
    _, err = canfb(bench, "node", "reset", NODE, code=1)
    assert "reset and started, but its position is" in err
    assert "canfb why 0x20" in err
