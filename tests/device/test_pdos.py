"""PDOs: lengths, time-out, mapping; what an event, a remote frame and the timers send, against a model."""

from math import inf
from pathlib import Path

import pytest
import sample_eds
from device_kit import ID, OK, Bench
from hypothesis import example, given, strategies as st

from canfb.cia301.codes import AbortCode, SdoAbort
from canfb.device.node import Node
from canfb.device.od.dictionary import Dictionary
from folding import each

RPDO = 0x190
OFF = {0x1400: 0x80000190, 0x1401: 0x80000320, 0x1800: 0xC00001A0, 0x1801: 0x800002A0}
FREE = 0x80000000
TOO_SHORT, TOO_LONG, TIMED_OUT = 0x8210, 0x8220, 0x8250


def remap(bench: Bench, index: int, mappings: list[int]) -> list[AbortCode | str]:
    """The procedure of CiA 301, 7.5.2.36, with the answer to each step."""
    number_of = index + 0x200
    answers = [bench.write(index, 1, OFF[index], 4), bench.write(number_of, 0, 0, 1)]
    answers += [bench.write(number_of, sub, value, 4) for sub, value in enumerate(mappings, 1)]
    answers.append(bench.write(number_of, 0, len(mappings), 1))
    answers.append(bench.write(index, 1, OFF[index] & ~FREE, 4))
    return answers


def value(bench: Bench, subindex: int = 1) -> object:
    return bench.dictionary.entry(0x2000, subindex).value


class Errors:
    """EMCY of one RPDO: each error once until it is over (CiA 301, 7.2.7)."""

    def __init__(self) -> None:
        self.active, self.sent, self.last = set[int](), list[str](), 0

    def report(self, code: int, *detail: int) -> None:
        if code not in self.active:
            self.active.add(code)
            data = code.to_bytes(2, "little") + b"\x11" + bytes(detail).ljust(5, b"\0")
            self.sent.append(f"0A0#{data.hex().upper()}")
            self.last = code | int.from_bytes(bytes(detail[:2]), "little") << 16

    def clear(self, *codes: int) -> None:
        for code in codes:
            if code in self.active:
                self.active.discard(code)
                self.sent.append(f"0A0#0000{0x11 if self.active else 0:02X}0000000000")


@given(
    st.sampled_from([255, 255, 0, 1, 240]),
    st.booleans(),
    st.sampled_from([0, 50]),
    st.lists(st.tuples(st.integers(0, 70), st.sampled_from([0, 1, 3, 4, 4, 5, 8])), max_size=25),
)
@example(255, True, 50, [(0, 4), (60, 3), (0, 4)])
def test_lengths_and_the_time_out(
    sample_path: Path, kind: int, late: bool, timeout_ms: int, frames: list[tuple[int, int]]
) -> None:
    """Less is refused and does not stop the time-out; more is an error, too, but taken and in time.

    It is taken at once, or the last one at the next SYNC: here after every second frame.
    """
    bench = Bench(Dictionary.load(sample_path, ID))
    bench.start()
    synchronous = kind != 255
    bench.write(0x1400, 2, kind, 1)
    bench.nmt(1 if late else 128)
    bench.write(0x1400, 5, timeout_ms, 2)
    bench.operational()
    errors, seen, end, counts = Errors(), list[str](), float("inf"), {"short": 0, "long": 0}
    held, taken = 0, [0]
    for number, (wait_ms, length) in enumerate(frames, 1):
        seen += [text for _, text in bench.run(wait_ms / 1000)]
        if end <= bench.now:
            errors.report(TIMED_OUT, 1)
            end = float("inf")
        seen += bench.send(RPDO, (number.to_bytes(2, "little") + bytes(6))[:length])
        if length < 4:
            counts["short"] += 1
            errors.report(TOO_SHORT, 1, length, 4)
            errors.clear(TOO_LONG)
            assert bench.application.told("rpdo_too_short")[-1] == (1, length, 4, bench.now)
        else:
            if length > 4:
                counts["long"] += 1
                errors.report(TOO_LONG, 1, length, 4)
                errors.clear(TOO_SHORT, TIMED_OUT)
            errors.clear(*({TOO_SHORT, TOO_LONG, TIMED_OUT} if length == 4 else ()))
            end = bench.now + timeout_ms / 1000 if timeout_ms else end
            held = number
        if synchronous:
            assert value(bench) == taken[-1]
            if number % 2:
                bench.sync()
        if held != taken[-1] and (number % 2 or not synchronous):
            taken.append(held)
        assert value(bench) == taken[-1]
    assert len(bench.application.told("rpdo_received")) == len(taken) - 1
    assert seen == errors.sent
    counters = bench.node.counters
    assert {"short": counters.short_rpdos, "long": counters.long_rpdos} == counts
    assert len(bench.application.told("rpdo_too_short")) == counts["short"]
    assert bench.read(0x1001) == (0x11 if errors.active else 0)
    assert not errors.last or bench.read(0x1003, 1) == errors.last
    assert bench.nmt(128) == bench.run(1.0) == []  # no time-out there


def refuse(value: int) -> None:
    raise SdoAbort(AbortCode.INVALID_VALUE)


@pytest.mark.parametrize("limit", [{"high": 100}, {"on_check": refuse}])
@pytest.mark.parametrize("shift", [0, 1], ids=["a struct", "by bits"])
def test_values_that_are_refused_are_kept_out(bench: Bench, limit: dict[str, object], shift: int) -> None:
    if shift:
        remap(bench, 0x1400, [0x20000301, 0x20000110, 0x20000210])
    first, second = (bench.dictionary.entry(0x2000, subindex) for subindex in (1, 2))
    written: list[object] = []
    first.on_written = second.on_written = lambda: written.append(second.value)
    for name, what in limit.items():
        setattr(first, name, what)
    bench.operational()
    bench.send(RPDO, (0x00070065 << shift).to_bytes(4 + shift, "little"))
    assert bench.application.told("rpdo_received") == [(1, 0.0)]
    assert (first.value, second.value, written) == (0, 7, [7])
    assert bench.node.counters.refused_rpdo_values == 1


def test_mixed_mapping_with_dummies(bench: Bench) -> None:
    assert remap(bench, 0x1401, [0x00050008, 0x20000301, 0x20000518, 0x20000408]) == [OK] * 8
    bench.write(0x1401, 2, 255, 1)
    bench.operational()
    word = 0xAA | 1 << 8 | 0x123456 << 9 | 0x5A << 33
    bench.send(0x320, word.to_bytes(6, "little"))
    assert [value(bench, sub) for sub in (3, 4, 5)] == [True, 0x5A, 0x123456]


def test_two_rpdos_on_one_can_id_and_one_without_mapping(bench: Bench) -> None:
    bench.write(0x1401, 1, 0x320, 4)
    bench.operational()
    bench.send(0x320, "00")
    assert bench.node.counters.unknown_cob_ids == 1
    remap(bench, 0x1401, [0x20000408])
    bench.write(0x1401, 2, 255, 1)
    bench.write(0x1401, 1, 0x80000190, 4)
    assert bench.write(0x1401, 1, RPDO, 4) == OK
    bench.send(RPDO, "05000600")
    assert (value(bench, 1), value(bench, 4)) == (5, 5)


def test_the_whole_procedure_takes_effect_in_operational_too(bench: Bench) -> None:
    bench.operational()
    assert remap(bench, 0x1800, [0x20100210]) == [OK] * 5
    bench.dictionary.entry(0x2010, 2).value = 0x1234
    bench.node.trigger_tpdo(1, bench.now)
    assert bench.tick() == ["1A0#3412"]
    assert remap(bench, 0x1400, [0x20000210, 0x20000110]) == [OK] * 6
    bench.send(RPDO, "01000200")
    assert (value(bench, 2), value(bench, 1)) == (1, 2)
    assert bench.write(0x1801, 1, 0x800002A0, 4) == OK
    assert bench.write(0x1801, 6, 241, 1) == AbortCode.INVALID_VALUE
    assert bench.sync() == bench.send(0x2A0, rtr=True) == []  # TPDO2 is not valid


MAPPABLE = {
    (0x1400, OK): [0x20000110, 0x20000720, 0x20100720, 0x00020008, 0x00070020, 0x00010001],
    (0x1400, AbortCode.NOT_MAPPABLE): [
        *(0x00020010, 0x00020108, 0x10010008, 0x20100401, 0x10170010, 0x20000108, 0x20000100)
    ],
    (0x1400, AbortCode.NO_OBJECT): [0x00080020, 0x20001010, 0x2FFF0010],
    (0x1800, OK): [0x10010008, 0x20100401, 0x20100720],
    (0x1800, AbortCode.NOT_MAPPABLE): [0x20000110, 0x20000720, 0x10000020, 0x20200000],
    (0x1800, AbortCode.NO_OBJECT): [0x00020008],
}


@each("index, expected, mapping", [(*case, one) for case, mapped in MAPPABLE.items() for one in mapped])
def test_what_can_be_mapped(bench: Bench, index: int, expected: AbortCode | str, mapping: int) -> None:
    bench.write(index, 1, OFF[index], 4)
    bench.write(index + 0x200, 0, 0, 1)
    before = bench.read(index + 0x200, 1)
    assert bench.write(index + 0x200, 1, mapping, 4) == expected
    assert bench.read(index + 0x200, 1) == (mapping if expected == OK else before)


@each("rows", [
    sample_eds.rpdo(1, "0x190", 255, [0x2FFF0110]),
    sample_eds.rpdo(1, "0x190", 255, [0x20100120]),
    sample_eds.tpdo(1, "0x1A0", 255, [0x20100120] * 3),
    [row for row in sample_eds.rpdo(1, "0x190", 255, [0x20000110] * 2) if row[:2] != (0x1600, 2)][:-6],
])  # fmt: skip
def test_an_impossible_default_mapping(tmp_path: Path, rows: list[sample_eds.Row]) -> None:
    others = [row for row in sample_eds.ROWS if row[0] >= 0x2000]
    path = sample_eds.write(tmp_path / "sample.eds", rows + others)
    with pytest.raises(ValueError, match=r"mapping 1[6A]00h"):
        Node(Dictionary.load(path, ID), ID)


def set_up(bench: Bench, *, kind: int, inhibit: int = 0, timer: int = 0, start: int = 0) -> Bench:
    """TPDO2 with remote frames allowed, one U32."""
    writes = [(1, OFF[0x1801], 4), (2, kind, 1), (3, inhibit, 2), (5, timer, 2), (6, start, 1)]
    for subindex, value, size in [*writes, (1, OFF[0x1801] & ~FREE, 4)]:
        assert bench.write(0x1801, subindex, value, size) == OK
    return bench


def set_value(bench: Bench, value: int) -> None:
    bench.dictionary.entry(0x2010, 1).value = value


@pytest.mark.parametrize("option", [{"start": 4}, {"inhibit": 10000}])
def test_what_is_not_for_synchronous_ones_without_a_counter(bench: Bench, option: dict[str, int]) -> None:
    set_up(bench, kind=1, **option).operational()
    assert bench.sync() == bench.sync() == ["2A0#00000000"]


@pytest.mark.parametrize("kind", [0, 1, 0xFD, 254, 255])
def test_a_remote_frame(bench: Bench, kind: int) -> None:
    set_up(bench, kind=kind).operational()
    set_value(bench, 9)
    assert bench.send(0x2A0, rtr=True) == ["2A0#09000000"]
    assert bench.send(0x1A0, rtr=True) == [], "not allowed"
    assert bench.node.counters.remote_frames == 1


def test_sampled_at_the_sync_and_sent_on_a_remote_frame(bench: Bench) -> None:
    set_up(bench, kind=0xFC).operational()
    set_value(bench, 9)
    assert bench.send(0x2A0, rtr=True) == bench.sync() == []
    set_value(bench, 10)
    assert bench.send(0x2A0, rtr=True) == ["2A0#09000000"]
    bench.sync()
    assert bench.send(0x2A0, rtr=True) == ["2A0#0A000000"]


def test_an_invalid_tpdo_is_silent_and_one_that_is_not_there_cannot_be_sent(bench: Bench) -> None:
    bench.write(0x1800, 1, OFF[0x1800], 4)
    bench.operational()
    bench.node.trigger_tpdo(1, 0.0)
    assert bench.tick() == []
    bench.write(0x1800, 1, OFF[0x1800] & ~FREE, 4)
    bench.node.trigger_tpdo(1, 0.0)
    assert bench.tick() == ["1A0#0000000000000000"]
    with pytest.raises(ValueError, match=r"no TPDO 3.*\[1, 2\]"):
        bench.node.trigger_tpdo(3, 0.0)


class TimerModel:
    """When an event-driven TPDO is sent (CiA 301, 7.2.2): inhibit time and event timer, seconds; 0: none."""

    def __init__(self, inhibit_s: float, timer_s: float) -> None:
        self.inhibit_s, self.timer_s = inhibit_s, timer_s or inf
        self.sent: list[float] = []
        self.waits, self.last, self.timer_end = False, -inf, self.timer_s

    def ask(self, now: float) -> None:
        self.waits = now < self.last + self.inhibit_s
        if not self.waits:
            self.sent.append(now)
            self.last, self.timer_end = now if self.inhibit_s else self.last, now + self.timer_s

    def advance(self, end: float) -> None:
        while (due := min(self.last + self.inhibit_s if self.waits else inf, self.timer_end)) <= end:
            if due >= self.timer_end:
                self.timer_end = inf
            self.ask(due)


def test_an_event_that_waits_for_a_sync_is_sent_once_by_another_type(bench: Bench) -> None:
    set_up(bench, kind=0).operational()
    bench.node.trigger_tpdo(2, bench.now)
    assert bench.write(0x1801, 2, 254, 1) == OK
    assert len(bench.run(1.0)) == 1


WHAT = ["event", "rtr", "timer", "", 0, 5, 30]  # numbers: another inhibit time, ms
STEPS = st.lists(st.tuples(st.integers(0, 40), st.sampled_from(WHAT)), max_size=25)


@given(st.integers(0, 30), st.integers(0, 50), STEPS)
def test_any_events_are_sent_as_the_model_says(
    sample_path: Path, inhibit_ms: int, timer_ms: int, steps: list[tuple[int, str | int]]
) -> None:
    bench = Bench(Dictionary.load(sample_path, 32))
    bench.start()
    set_up(bench, kind=254, inhibit=10 * inhibit_ms, timer=timer_ms).operational()
    model, seen = TimerModel(inhibit_ms / 1000, timer_ms / 1000), list[float]()
    for wait_ms, what in steps:
        seen += [at for at, _ in bench.run(wait_ms / 1000)]
        model.advance(bench.now)
        if isinstance(what, int):  # the PDO is switched off: an event that waits is dropped
            set_up(bench, kind=254, inhibit=10 * what, timer=timer_ms)
            model.inhibit_s, model.waits, model.timer_end = what / 1000, False, bench.now + model.timer_s
        elif what == "timer":  # written again: it begins, and an event that waits still waits
            assert bench.write(0x1801, 5, timer_ms, 2) == OK
            model.timer_end = bench.now + model.timer_s
        elif what:
            model.ask(bench.now)
            if what == "event":
                bench.node.trigger_tpdo(2, bench.now)
            frames = bench.tick() if what == "event" else bench.send(0x2A0, rtr=True)
            seen += [bench.now] * len(frames)
    assert seen == pytest.approx(model.sent)
