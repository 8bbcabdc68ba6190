from __future__ import annotations

import pytest
from device_kit import OK, Bench

OFF_1, ON_1 = 0xC00001A0, 0x400001A0
OFF_2, ON_2 = 0x800002A0, 0x000002A0


def set_up(bench: Bench, *, kind: int, inhibit: int = 0, timer: int = 0, start: int = 0) -> None:
    """TPDO2 with remote frames allowed, one U32."""
    assert bench.write(0x1801, 1, OFF_2, 4) == OK
    for subindex, value, size in ((2, kind, 1), (3, inhibit, 2), (5, timer, 2), (6, start, 1)):
        assert bench.write(0x1801, subindex, value, size) == OK
    assert bench.write(0x1801, 1, ON_2, 4) == OK


def set_value(bench: Bench, value: int) -> None:
    bench.dictionary.entry(0x2010, 1).value = value


def test_an_event_within_a_call(bench: Bench) -> None:
    bench.operational()

    def rpdo_received(number: int, now: float) -> None:
        for subindex in (1, 2, 3):
            bench.dictionary.entry(0x2010, subindex).value = subindex
        bench.node.trigger_tpdo(1, now)

    bench.application.react(rpdo_received=rpdo_received)
    assert bench.send(0x190, "01000200") == ["1A0#0100000002000300"]
    assert bench.node.deadline() is None


@pytest.mark.parametrize("kind", [254, 255])
def test_an_event_outside_of_a_call(bench: Bench, kind: int) -> None:
    bench.write(0x1800, 2, kind, 1)
    bench.operational()
    bench.node.trigger_tpdo(1, 4.25)
    assert bench.node.deadline() == 4.25
    assert bench.tick() == ["1A0#0000000000000000"]
    assert bench.node.deadline() is None


@pytest.mark.parametrize("kind", [0, 1, 254, 255])
@pytest.mark.parametrize("command", [128, 2])
def test_never_outside_of_operational(bench: Bench, kind: int, command: int) -> None:
    set_up(bench, kind=kind, timer=100)
    bench.operational()
    bench.nmt(command)
    bench.node.trigger_tpdo(2, bench.now)
    assert bench.sync() == []
    assert bench.send(0x2A0, rtr=True) == []
    assert bench.run(1.0) == []
    assert bench.node.counters.remote_frames == 1


def test_an_event_in_pre_operational_is_forgotten(bench: Bench) -> None:
    set_up(bench, kind=0)
    bench.node.trigger_tpdo(2, 0.0)
    bench.operational()
    assert bench.sync() == []


def test_without_an_event_nothing_comes(bench: Bench) -> None:
    set_up(bench, kind=254)
    bench.operational()
    assert bench.sync() == []
    assert bench.run(10.0) == []


def test_the_start_value(bench: Bench) -> None:
    bench.write(0x1019, 0, 10, 1)
    set_up(bench, kind=3, start=4)
    bench.operational()
    counters = [number % 10 + 1 for number in range(20)]
    sent = [place for place, counter in enumerate(counters) if bench.sync(counter)]
    assert sent == [3, 6, 9, 12, 15, 18]


def test_the_start_value_needs_a_counter(bench: Bench) -> None:
    set_up(bench, kind=1, start=4)
    bench.operational()
    assert bench.sync() == ["2A0#00000000"]


def test_the_event_timer_restarts_when_written(bench: Bench) -> None:
    set_up(bench, kind=254, timer=100)
    bench.operational()
    bench.run(0.05)
    assert bench.write(0x1801, 5, 200, 2) == OK
    assert bench.run(0.3) == [(0.25, "2A0#00000000")]
    assert bench.write(0x1801, 5, 0, 2) == OK
    assert bench.run(10.0) == []


def test_the_inhibit_time_sends_the_newest_data(bench: Bench) -> None:
    set_up(bench, kind=255, inhibit=100)
    bench.operational()
    for number in range(1, 6):
        set_value(bench, number)
        bench.node.trigger_tpdo(2, bench.now)
    assert bench.run(1.0) == [(0.0, "2A0#01000000"), (0.01, "2A0#05000000")]


def test_the_event_timer_waits_for_the_inhibit_time(bench: Bench) -> None:
    set_up(bench, kind=255, inhibit=3000, timer=100)
    bench.operational()
    times = [time for time, _ in bench.run(1.0)]
    assert times == [0.1, 0.4, 0.7, 1.0]


def test_the_inhibit_time_does_not_hold_synchronous_ones(bench: Bench) -> None:
    set_up(bench, kind=1, inhibit=10000)
    bench.operational()
    assert bench.sync() == bench.sync() == ["2A0#00000000"]


def test_the_inhibit_time_can_be_taken_away(bench: Bench) -> None:
    set_up(bench, kind=255, inhibit=10000)
    bench.operational()
    bench.node.trigger_tpdo(2, 0.0)
    bench.tick()
    set_up(bench, kind=255)
    bench.node.trigger_tpdo(2, 0.0)
    assert bench.tick() == ["2A0#00000000"]


@pytest.mark.parametrize("kind", [0, 1, 0xFD, 254, 255])
def test_a_remote_frame(bench: Bench, kind: int) -> None:
    set_up(bench, kind=kind)
    bench.operational()
    set_value(bench, 9)
    assert bench.send(0x2A0, rtr=True) == ["2A0#09000000"]


def test_a_remote_frame_keeps_the_inhibit_time(bench: Bench) -> None:
    set_up(bench, kind=254, inhibit=100)
    bench.operational()
    assert bench.send(0x2A0, rtr=True) == ["2A0#00000000"]
    bench.now = 0.004
    set_value(bench, 1)
    assert bench.send(0x2A0, rtr=True) == []
    set_value(bench, 2)
    assert bench.send(0x2A0, rtr=True) == []
    assert bench.run(1.0) == [(0.01, "2A0#02000000")]


def test_a_remote_frame_restarts_the_event_timer(bench: Bench) -> None:
    set_up(bench, kind=254, timer=100)
    bench.operational()
    bench.run(0.05)
    assert bench.send(0x2A0, rtr=True) == ["2A0#00000000"]
    assert bench.run(0.12) == [(0.15, "2A0#00000000")]


@pytest.mark.parametrize("kind", [0, 1, 240])
def test_the_synchronous_window_holds_for_tpdos(bench: Bench, kind: int) -> None:
    """They go out with the SYNC itself, however long the pause before it was."""
    bench.write(0x1007, 0, 1, 4)
    set_up(bench, kind=kind)
    bench.operational()
    for _ in range(3):
        bench.node.trigger_tpdo(2, bench.now)
        sent = [bench.sync() for _ in range(max(kind, 1))]
        assert sent[-1] == ["2A0#00000000"]
        assert bench.node.deadline() is None
        bench.now += 5.0


def test_a_remote_frame_where_none_is_allowed(bench: Bench) -> None:
    bench.operational()
    assert bench.send(0x1A0, rtr=True) == []
    assert bench.node.counters.remote_frames == 1


def test_sampled_at_the_sync_and_sent_on_a_remote_frame(bench: Bench) -> None:
    set_up(bench, kind=0xFC)
    bench.operational()
    set_value(bench, 9)
    assert bench.send(0x2A0, rtr=True) == []
    assert bench.sync() == []
    set_value(bench, 10)
    assert bench.send(0x2A0, rtr=True) == ["2A0#09000000"]
    bench.sync()
    assert bench.send(0x2A0, rtr=True) == ["2A0#0A000000"]


def test_remote_only_is_not_sent_by_events(bench: Bench) -> None:
    set_up(bench, kind=0xFD, timer=10)
    bench.operational()
    bench.node.trigger_tpdo(2, 0.0)
    assert bench.sync() == []
    assert bench.run(1.0) == []


def test_an_invalid_tpdo_is_silent(bench: Bench) -> None:
    bench.write(0x1800, 1, OFF_1, 4)
    bench.operational()
    bench.node.trigger_tpdo(1, 0.0)
    assert bench.tick() == []
    bench.write(0x1800, 1, ON_1, 4)
    bench.node.trigger_tpdo(1, 0.0)
    assert bench.tick() == ["1A0#0000000000000000"]


def test_trigger_of_a_tpdo_that_is_not_there(bench: Bench) -> None:
    with pytest.raises(ValueError, match=r"no TPDO 3.*\[1, 2\]"):
        bench.node.trigger_tpdo(3, 0.0)
