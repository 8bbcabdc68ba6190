"""NMT states, start-up and what a node drops; the cases State and Trans are in tests/conformance."""

from __future__ import annotations

from pathlib import Path

import pytest
from device_kit import ID, OK, Bench

from canfb.cia301.codes import AbortCode, EmergencyCode
from canfb.cia301.frame import Frame
from canfb.cia301.nmt import NmtState
from canfb.device.od.dictionary import Dictionary, Entry
from folding import each

UPLOAD = "4000100000000000"


@pytest.mark.parametrize("autostart", [True, False])
def test_autostart_is_the_default_of_1f80(sample_path: Path, autostart: bool) -> None:
    bench = Bench(Dictionary.load(sample_path, ID), autostart=autostart)
    default, other = (0, 4) if autostart else (4, 0)
    states: list[NmtState] = []
    bench.application.react(state_changed=lambda old, new, now, why: states.append(new))
    starting = [NmtState.PRE_OPERATIONAL, *[NmtState.OPERATIONAL] * autostart]
    assert bench.start() == ["720#00"]
    assert states == starting
    for command in (129, 130):
        assert bench.write(0x1F80, 0, other, 4) == OK
        assert (bench.node.autostart, bench.node.state) == (not autostart, starting[-1])
        assert bench.nmt(command) == ["720#00"]
        assert (bench.read(0x1F80), bench.node.autostart) == (default, autostart)
        assert bench.node.state is starting[-1]


def test_nothing_is_served_before_start_and_what_was_set_before_is_kept(silent: Bench) -> None:
    assert silent.nmt(1) == silent.sdo("40001000") == silent.sync() == []
    assert silent.node.state is NmtState.INITIALISING
    assert silent.node.counters.unknown_cob_ids == 3
    silent.dictionary.entry(0x2010, 7).value = 99
    silent.start()
    assert silent.application.told("reset_done") == [(False, silent.now)]
    assert silent.dictionary.entry(0x2010, 7).value == 99


def test_a_reset_has_its_order_and_one_of_communication_keeps_the_application(bench: Bench) -> None:
    bench.dictionary.entry(0x2010, 7).value = 99
    bench.write(0x1006, 0, 5000, 4)
    seen: list[object] = []
    bench.application.react(
        state_changed=lambda old, new, now, why: seen.append(new),
        reset_done=lambda only, now: seen.append((only, bench.dictionary.entry(0x1006).value)),
    )
    for command, kept in ((130, 99), (129, -5)):
        bench.nmt(command)
        assert seen == [NmtState.INITIALISING, (command == 130, 0), NmtState.PRE_OPERATIONAL]
        assert bench.dictionary.entry(0x2010, 7).value == kept
        seen.clear()


# What is dropped, what raises, and when the node wants to be called.


DROPPED = [(can_id, bytes(9)) for can_id in (0x000, 0x080, 0x190, 0x620, 0x123)]
DROPPED += [(can_id, bytes.fromhex(UPLOAD)) for can_id in (0x800, 0x1FFFFFFF, -1)]
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
