"""NMT states, start-up and what a node drops; the cases State and Trans are in tests/conformance."""

from collections import deque
from math import inf, nan
from pathlib import Path

import pytest
from device_kit import ID, OK, Bench, hexes
from hypothesis import example, given, strategies as st

from canfb.cia301.codes import AbortCode, EmergencyCode, NmtState
from canfb.cia301.frame import Frame
from canfb.device.od.dictionary import Dictionary, Entry
from folding import each

UPLOAD = "4000100000000000"


@pytest.mark.parametrize("autostart", [True, False])
def test_autostart_is_the_default_of_1f80(sample_path: Path, autostart: bool) -> None:
    bench = Bench(Dictionary.load(sample_path, ID), autostart=autostart)
    default, other = (0, 4) if autostart else (4, 0)
    starting = [NmtState.PRE_OPERATIONAL, *[NmtState.OPERATIONAL] * autostart]
    assert bench.start() == ["720#00"]
    assert [new for _, new, *_ in bench.application.told("state_changed")] == starting
    for command in (129, 130):
        assert bench.write(0x1F80, 0, other, 4) == OK
        assert (bench.read(0x1F80), bench.node.state) == (other, starting[-1])
        assert bench.nmt(command) == ["720#00"]
        assert bench.read(0x1F80) == default
        assert bench.node.state is starting[-1]


DROPPED = [(can_id, bytes(9)) for can_id in (0x000, 0x080, 0x190, 0x620, 0x123)]
DROPPED += [(can_id, bytes.fromhex(UPLOAD)) for can_id in (0x800, 0x1FFFFFFF, -1)]
DROPPED += [(0x7E5, b"\x04\x01")]  # LSS has 8 bytes
UNKNOWN = (0x123, 0x621, 0x5A1, 0x721, 0x1A1)


def test_frames_that_are_none_or_of_others_are_dropped_and_counted(bench: Bench) -> None:
    bench.operational()
    for number, (can_id, data) in enumerate(DROPPED, 1):
        assert bench.send(can_id, data) == []
        assert (bench.node.counters.malformed_frames, bench.node.counters.unknown_cob_ids) == (number, 0)
    for number, can_id in enumerate(UNKNOWN, 1):
        assert bench.send(can_id, UPLOAD) == []
        assert bench.node.counters.unknown_cob_ids == number
    assert bench.node.counters.malformed_frames == len(DROPPED)
    assert len(bench.node.receive(Frame(0x620, bytes.fromhex(UPLOAD), False, -1e30), 0.0)) == 1


def test_an_exception_of_the_program_loses_no_frame(bench: Bench) -> None:
    bench.operational()

    def broken(number: int, now: float) -> None:
        bench.node.trigger_tpdo(1, now)
        raise RuntimeError("a mistake in the program")

    bench.application.react(rpdo_received=broken)
    with pytest.raises(RuntimeError):
        bench.send(0x190, "01000200")
    assert bench.tick() == ["1A0#0000000000000000"]


@pytest.mark.parametrize("timeout_s", [1.0, 0.25])
def test_the_sdo_timeout(sample_path: Path, timeout_s: float) -> None:
    bench = Bench(Dictionary.load(sample_path, ID), sdo_timeout_s=timeout_s)
    bench.start()
    assert bench.write(0x1201, 2, 0x6D1, 4) == OK
    assert bench.write(0x1201, 1, 0x6D0, 4) == OK
    for channel in (0x620, 0x6D0):
        bench.send(channel, "4008100000000000")
        start = bench.now
        ((time, text),) = bench.run(10.0)
        assert time - start == pytest.approx(timeout_s)
        assert text.endswith("#8008100000000405")


def test_a_channel_that_is_switched_off_over_itself_answers_once_more(bench: Bench) -> None:
    assert [bench.write(0x1201, 2, 0x6D1, 4), bench.write(0x1201, 1, 0x6D0, 4)] == [OK, OK]
    assert bench.send(0x6D0, "2301120200000080") == ["6D1#6001120200000000"], "CAN-ID 000h is NMT"
    assert bench.send(0x6D0, "4001120200000000") == []


def test_a_change_of_other_parameters_is_no_new_configuration(bench: Bench) -> None:
    bench.operational()
    bench.application.calls.clear()
    for index, value, size in ((0x1017, 500, 2), (0x1012, 0x80000100, 4), (0x1005, 0x81, 4)):
        assert bench.write(index, 0, value, size) == OK
    assert bench.write(0x1016, 1, 0x00470100, 4) == OK
    assert bench.application.told("configuration_changed") == []
    assert bench.write(0x1400, 2, 1, 1) == OK
    assert bench.application.told("configuration_changed") == [()]


@each("words, message", [
    *(({"node_id": node_id}, "1 to 127") for node_id in (0, 128)),
    *(({"sdo_timeout_s": wrong}, "sdo_timeout_s") for wrong in (0, -1.0, float("inf"), float("nan"))),
])  # fmt: skip
def test_wrong_arguments(silent: Bench, words: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        type(silent.node)(silent.dictionary, **{"node_id": ID, **words})  # type: ignore[arg-type]


@each("now", [inf, -inf, nan])
def test_a_tick_at_no_time(bench: Bench, now: float) -> None:
    with pytest.raises(ValueError, match=f"now must be a finite number, not {now}"):
        bench.node.tick(now)
    assert bench.node.now == bench.now


# A device with the mandatory objects only: every other service does without its objects.


@pytest.mark.parametrize("register", [True, False])
def test_without_optional_objects(register: bool) -> None:
    entries = [Entry(0x1000, 0, 7, access="ro"), Entry(0x1201, 1, 7, default=0x680)]
    bench = Bench(Dictionary([*entries, *[Entry(0x1001, 0, 5, access="ro")] * register], ()))
    bench.start()
    bench.node.emergency(EmergencyCode.SENSOR, 0x20, now=0.0)
    assert bench.tick() == [f"{0x80 + ID:03X}#0073210000000000"]
    assert bench.read(0x1001) == (0x21 if register else AbortCode.NO_OBJECT)
    assert bench.send(0x700 + ID, rtr=True) == [], "no guarding"
    assert bench.send(0x680, "4001120100000000") == [], "half a second channel is none"
    assert bench.read(0x1201, 1) == 0x680
    assert bench.send(0x600 + ID, "4001120100000000") == [f"{0x580 + ID:03X}#4301120180060000"]


WATCHED = 0x47
LOST, GUARD_LOST, GOOD = "0A0#3081114700000000", "0A0#3081110000000000", "0A0#0000000000000000"
BUS_BACK = ["0A0#4081110000000000", GOOD]


def guard(bench: Bench) -> list[str]:
    return bench.send(0x700 + ID, rtr=True)


def beat(bench: Bench) -> list[str]:
    return bench.send(0x700 + WATCHED, "05")


def watching(bench: Bench, milliseconds: int) -> None:
    bench.write(0x1016, 1, WATCHED << 16 | milliseconds, 4)


class ErrorControlModel:
    """Two watchers, seconds from sign to loss, and what the node sends; it is PRE-OPERATIONAL at first."""

    def __init__(self, limits_s: dict[int, float], stays: bool) -> None:
        self.limits_s, self.stays = limits_s, stays
        self.sent: list[tuple[float, str]] = []
        self.held = deque[str](maxlen=8)  # in STOPPED
        self.reset()

    def reset(self) -> None:
        self.ends, self.lost = dict.fromkeys(self.limits_s, inf), set[int]()
        self.held.clear()
        self.state, self.toggle = 0x7F, 0x00

    def advance(self, now: float) -> None:
        while min(self.ends.values()) <= now:
            at, node = min((end, node) for node, end in self.ends.items())
            self.ends[node] = inf
            self.lost.add(node)
            self.tell(at, f"308111{node:02X}00000000")
            self.state = 0x7F if self.state == 0x05 and not self.stays else self.state

    def sign(self, node: int, now: float) -> None:
        """A heartbeat of a node, or a remote frame of the master (0), which is answered."""
        if not node:
            self.sent.append((now, f"720#{self.state | self.toggle:02X}"))
            self.toggle ^= 0x80
        self.ends[node] = now + self.limits_s[node] if self.limits_s[node] else inf
        if node in self.lost:
            self.lost.discard(node)
            self.tell(now, f"0000{0x11 if self.lost else 0:02X}0000000000")

    def command(self, command: int, now: float) -> None:
        """An NMT command; after a reset each watcher waits for its first sign."""
        if command in (129, 130):
            self.reset()
            self.sent.append((now, "720#00"))
        self.state = {1: 0x05, 2: 0x04}.get(command, 0x7F)
        while self.held and self.state != 0x04:
            self.tell(now, self.held.popleft())

    def tell(self, now: float, emergency: str) -> None:
        if self.state == 0x04:
            self.held.append(emergency)
        else:
            self.sent.append((now, f"0A0#{emergency}"))


SIGN = st.sampled_from(["none", "beat", "guard"]) | st.sampled_from([1, 1, 2, 128, 129, 130])
SIGNS = st.lists(st.tuples(st.integers(0, 150), SIGN), max_size=25)


@given(st.integers(1, 120), st.integers(0, 60), st.integers(0, 3), st.booleans(), SIGNS)
@example(50, 0, 0, False, [(0, "beat"), (0, 130), (100, "none")])
def test_whatever_comes_and_does_not_come(
    sample_path: Path,
    beat_ms: int,
    guard_ms: int,
    factor: int,
    stays: bool,
    signs: list[tuple[int, str | int]],
) -> None:
    dictionary = Dictionary.load(sample_path, ID)
    places = (0x100C, 0), (0x100D, 0), (0x1016, 1), (0x1029, 1)
    for place, value in zip(places, (guard_ms, factor, WATCHED << 16 | beat_ms, int(stays)), strict=True):
        entry = dictionary.entry(*place)
        entry.default = entry.value = value  # as saved: it is there after a reset
    bench = Bench(dictionary)
    bench.start()
    model = ErrorControlModel({WATCHED: beat_ms / 1000, 0: guard_ms * factor / 1000}, stays)
    seen: list[tuple[float, str]] = []
    for wait_ms, sign in signs:
        seen += bench.run(wait_ms / 1000)
        model.advance(bench.now)
        frames: list[str] = []
        if isinstance(sign, int):
            model.command(sign, bench.now)
            frames = bench.nmt(sign)
        elif sign != "none":
            model.sign(0 if sign == "guard" else WATCHED, bench.now)
            frames = guard(bench) if sign == "guard" else beat(bench)
        seen += [(bench.now, text) for text in frames]
    rounded = [[(round(at, 5), text) for at, text in frames] for frames in (seen, model.sent)]
    assert sorted(rounded[0]) == sorted(rounded[1])
    assert bench.node.state == model.state
    assert dictionary.entry(0x1001).value == (0x11 if model.lost else 0)


def test_a_new_life_time_runs_from_the_write_on_and_ends_no_error(bench: Bench) -> None:
    guard(bench)
    bench.nmt(130)  # the master has to ask again
    assert (bench.write(0x100C, 0, 100, 2), bench.write(0x100D, 0, 3, 1)) == (OK, OK)
    assert (bench.node.deadline(), guard(bench)) == (None, ["720#7F"])
    bench.run(0.2)
    assert bench.write(0x100C, 0, 200, 2) == OK
    assert bench.run(10.0) == [(0.8, GUARD_LOST)]
    assert bench.write(0x100C, 0, 100, 2) == OK
    assert bench.read(0x1001) == 0x11
    assert bench.node.deadline() is None
    assert guard(bench) == ["720#FF", GOOD]
    for off in ((0x100C, 0, 0, 2), (0x1017, 0, 100, 2)):
        bench.write(0x100C, 0, 100, 2)
        guard(bench)
        bench.run(10.0)
        assert (bench.read(0x1001), bench.write(*off), bench.read(0x1001)) == (0x11, OK, 0)


def test_heartbeats_neither_drift_nor_catch_up(bench: Bench) -> None:
    bench.write(0x1017, 0, 100, 2)
    bench.run(0.0)
    for late in [*(number * 0.1 + 0.03 for number in range(1, 20)), 5.03]:
        bench.now = late
        assert bench.tick() == ["720#7F"]
        assert bench.node.deadline() == pytest.approx(5.13 if late == 5.03 else late + 0.07)


def test_a_late_caller_does_what_was_due_before_the_frames_that_wait(bench: Bench) -> None:
    """Its own heartbeat, once; that of node 5 may wait."""
    assert bench.write(0x1017, 0, 200, 2) == OK
    assert bench.write(0x1016, 1, 5 << 16 | 500, 4) == OK
    bench.tick()
    bench.send(0x705, "05")
    start = bench.now
    assert hexes(bench.node.tick(start + 2.0, start + 0.25)) == ["720#7F"]
    assert bench.node.tick(start + 2.0, start + 0.25) == []
    assert [text[:8] for text in hexes(bench.node.tick(start + 2.0))] == ["0A0#3081"]


def test_the_program_hears_of_a_loss_before_the_state_changes(bench: Bench) -> None:
    heard: list[tuple[float, NmtState]] = []
    bench.application.react(communication_failed=lambda now: heard.append((now, bench.node.state)))
    watching(bench, 1000)
    bench.operational()
    beat(bench)
    assert bench.run(3.0) == [(1.0, LOST)]
    assert (heard, bench.read(0x1003, 1)) == ([(1.0, NmtState.OPERATIONAL)], 0x00478130)
    bench.node.bus_off(bench.now)
    assert heard[1:] == [(bench.now, NmtState.PRE_OPERATIONAL)]


def test_a_malformed_heartbeat_does_not_count_and_a_watch_that_ends_ends_its_error(bench: Bench) -> None:
    watching(bench, 100)
    for data in ("", "0505"):
        bench.send(0x700 + WATCHED, data)
    assert bench.node.counters.malformed_frames == 2
    assert bench.node.deadline() is None
    beat(bench)
    assert len(bench.run(1.0)) == 1
    assert GOOD in bench.send(0x620, "2316100100000000")
    assert bench.read(0x1001) == 0


@pytest.mark.parametrize(
    ("behaviour", "before", "after"),
    [
        (0, 1, NmtState.PRE_OPERATIONAL),
        (0, 2, NmtState.STOPPED),
        (1, 1, NmtState.OPERATIONAL),
        (2, 1, NmtState.STOPPED),
        (2, 128, NmtState.STOPPED),
    ],
)
def test_bus_off_is_a_communication_error_and_its_end_is_told(
    bench: Bench, behaviour: int, before: int, after: NmtState
) -> None:
    assert bench.write(0x1029, 1, behaviour, 1) is OK
    bench.nmt(before)
    for now in (1.0, 1.1):
        assert bench.node.bus_off(now) == []
        assert bench.node.state is after
    told = [] if after is NmtState.STOPPED else BUS_BACK
    assert hexes(bench.node.bus_back(2.0)) == told
    assert bench.node.state is after, "a master starts it again"
    if told:
        assert (bench.read(0x1001), bench.read(0x1003, 1)) == (0, 0x8140)
    bench.node.bus_off(4.0)
    assert hexes(bench.node.bus_back(5.0)) == told
    assert bench.run(10.0) == []


SENSOR, DATA_SET = EmergencyCode.SENSOR, EmergencyCode.DATA_SET


def sent(bench: Bench) -> list[str]:
    """What an error outside of a call left to send; the deadline must say so."""
    assert bench.node.deadline() == bench.now
    return bench.tick()


def test_frame_register_and_history(bench: Bench) -> None:
    bench.now = 3.0
    bench.node.emergency(SENSOR, 0x20, b"\x01\x02\x03\x04\x05", bench.now)
    assert sent(bench) == ["0A0#0073210102030405"]
    assert (bench.read(0x1001), bench.read(0x1003), bench.read(0x1003, 1)) == (0x21, 1, 0x02017300)
    bench.node.clear_emergency(SENSOR, bench.now)
    assert sent(bench) == ["0A0#0000000000000000"]
    assert (bench.read(0x1001), bench.read(0x1003)) == (0, 1)


def test_the_history_is_newest_first_and_bounded(bench: Bench) -> None:
    for number in range(6):
        bench.node.emergency(0x1000 + number, 0, now=0.0)
    assert len(sent(bench)) == 6
    assert [bench.read(0x1003, sub) for sub in range(5)] == [4, 0x1005, 0x1004, 0x1003, 0x1002]


def test_waiting_frames_are_bounded_and_another_inhibit_time_holds_for_them(bench: Bench) -> None:
    bench.write(0x1015, 0, 0xFFFF, 2)
    for number in range(1, 21):
        bench.node.emergency(0x1000 + number, 0, now=0.0)
    bench.write(0x1015, 0, 1000, 2)
    times, frames = zip(*bench.run(10.0), strict=True)
    assert times == pytest.approx([0.1 * number for number in range(1, 9)])
    assert frames[-1].startswith("0A0#1410")
    assert bench.node.counters.lost_emergencies == 11


def test_an_error_raised_at_reset_follows_the_boot_up(bench: Bench) -> None:
    bench.application.react(reset_done=lambda only, now: bench.node.emergency(SENSOR, 0x20, now=now))
    assert bench.nmt(129) == ["720#00", "0A0#0073210000000000"]


def test_wrong_emergencies(bench: Bench) -> None:
    with pytest.raises(ValueError, match="1001h"):
        bench.node.emergency(SENSOR, 0x100, now=0.0)
    with pytest.raises(ValueError, match="5 manufacturer bytes"):
        bench.node.emergency(SENSOR, 0, bytes(6), 0.0)
    with pytest.raises(ValueError, match="clear_emergency"):
        bench.node.emergency(EmergencyCode.NO_ERROR, 0, now=0.0)


def test_an_active_error_is_told_again_if_its_details_have_changed(bench: Bench) -> None:
    for detail, again in ((b"\x01", False), (b"\x02", False), (b"\x03", True)):
        bench.node.emergency(SENSOR, 0x20, detail, now=0.0, again=again)
    bench.node.clear_emergency(SENSOR, 0.0)
    assert [text[4:10] + text[10:12] for text in sent(bench)] == ["00732101", "00732103", "00000000"]
