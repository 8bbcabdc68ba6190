"""Events as lines: with time and node, few of many, and as JSON for programs."""

import json
import logging
import re
from datetime import UTC, datetime

import pytest
from hypothesis import given, strategies as st

import canfb
from canfb.cia301.frame import Frame
from canfb.hosting.event_log import BURST, LONGEST_WINDOW_S, WINDOW_S, EventLog, Throttle
from canfb.module.events import Event, EventKind
from documentation import page

WALL = datetime(2026, 5, 4, 12, 30, 1, 250000, UTC)


def watched(verbose: bool = False) -> tuple[EventLog, canfb.FeedbackModule]:
    module = canfb.FeedbackModule(canfb.ModuleConfig(node_id=32))
    log = EventLog(verbose, wall=lambda: WALL)
    log.watch(module, module.events)
    return log, module


def test_a_line_has_time_node_and_text_and_a_program_gets_the_values(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level(logging.INFO, "canfb")
    log, module = watched()
    module.start(5.0)
    assert caplog.records == [], "what happens before the bus is open waits"
    log.begin()
    (record,) = caplog.records
    assert record.getMessage() == "2026-05-04 12:30:01.250 node 32 (20h): boot-up, PRE-OPERATIONAL"
    values = record.event  # type: ignore[attr-defined]
    assert values["event"] == "nmt"
    assert (values["node"], values["state"], values["monotonic_s"]) == (32, "PRE-OPERATIONAL", 5.0)
    assert datetime.fromisoformat(values["time"]) == WALL
    assert json.loads(json.dumps(values)) == values
    module.receive(Frame(0x000, b"\x01\x00"), 6.0)
    assert caplog.records == [record], "no frame waits for a line"
    log.tick(6.001)
    assert caplog.records[1].getMessage().endswith(" node 32 (20h): OPERATIONAL")


@pytest.mark.parametrize("verbose", [False, True])
def test_a_fault_at_1_khz_does_not_flood(verbose: bool, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "canfb")
    log, module = watched(verbose)
    log.begin()
    seconds = 60
    for k in range(seconds * 1000):
        now = k * 1e-3
        log.tick(now)
        assert module.events.on_event is not None
        module.events.on_event(Event(EventKind.POSITION, now, f"change {k}"))
        if module.events.detailed:
            module.events.on_event(Event(EventKind.FAULT, now, f"fault {k}"))
    log.close(float(seconds))
    lines = [record.getMessage() for record in caplog.records]
    assert len(lines) <= (2 if verbose else 1) * (BURST + 10)
    assert lines[-2 if verbose else -1].endswith(f"the last: change {seconds * 1000 - 1}"), "the end is told"
    assert any("more in the last 1 s; the last: change" in line for line in lines)
    told = [record.event for record in caplog.records]  # type: ignore[attr-defined]
    counted = sum(one.get("more", 1) for one in told if one["event"] == "position")
    assert counted == seconds * 1000, "each is told or counted"
    assert any(one["event"] == "fault" for one in told) == verbose


@given(st.lists(st.tuples(st.integers(0, 2), st.floats(0.0, 30.0)), max_size=200))
def test_everything_passes_or_is_counted(steps: list[tuple[int, float]]) -> None:
    throttle = Throttle()
    now, told, last = 0.0, 0, dict[int, tuple[int, int]]()
    for number, (key, pause_s) in enumerate(steps):
        now += pause_s
        for held, _, (of, item) in throttle.ended(now):
            told += held
            assert last[of] == (of, item)
        last[key] = key, number
        told += throttle.admits(key, last[key], now)
    told += sum(held for held, _, _ in throttle.ended(now, closing=True))
    assert told == len(steps)
    assert not throttle.ended(now, closing=True)


def test_after_a_quiet_time_the_next_one_passes_at_once() -> None:
    throttle = Throttle()
    passed = [throttle.admits("k", n, n * 1e-3) for n in range(100)]
    assert sum(passed) == BURST
    ((held, _, last),) = throttle.ended(WINDOW_S)
    assert (held, last) == (100 - BURST, 99)
    assert throttle.ended(WINDOW_S + LONGEST_WINDOW_S) == []
    assert throttle.admits("k", 100, WINDOW_S + LONGEST_WINDOW_S)


def test_the_page_has_a_row_for_every_kind() -> None:
    rows = re.findall(
        r"^\| `(\w+)` \| (.*) \|$", page("service").partition("\n## Events")[2].partition("\n## ")[0], re.M
    )
    assert [kind for kind, _ in rows] == ["event", *map(str, EventKind)]
    assert {kind for kind, text in rows if "only with `-v`" in text} == {"fault", "emcy"}
