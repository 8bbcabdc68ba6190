"""What happens is told as events, each once, with its reason; 2012:10..16: why the position was lost last."""

import struct
from collections.abc import Callable
from typing import Any

import pytest
from module_bench import SYNC, Bench

from canfb import Frame, objects as od
from canfb.device.storage.storage import MemoryStore
from canfb.module.events import Event, EventKind
from canfb.objects import LossCause, StatusBit
from canfb.signal.speeds import STILL_SAMPLES
from folding import each
from ideal_tracks import adc_pdo, wavy_table

PERIOD_S, ADC_S = 1e-3, 2e-4


class Machine(Bench):
    """A module at 1 kHz whose samples a test may spoil."""

    def __init__(self, *, detailed: bool = False, stamped: bool = True, **fields: Any) -> None:
        super().__init__(MemoryStore(), **fields)
        self.events: list[Event] = []
        self.module.events.on_event = self.events.append
        self.module.events.detailed = detailed
        self.stamped, self.cycles_s, self.off_s = stamped, 5.0, 0.0
        self.start()

    def run(self, syncs: int, *, sample: bool = True, amplitude: float = 1500.0, jump: float = 0.0) -> None:
        for _ in range(syncs):
            self.silence(PERIOD_S - ADC_S)
            now = self.bus.now
            self.sent(SYNC)
            self.silence(ADC_S)
            if sample:
                time_s = now + self.off_s if self.module.config.times else None
                self.sent(adc_pdo(self.cycles_s * now + jump, amplitude, time_s))

    def silence(self, seconds: float) -> None:
        self.bus.run_until(self.bus.now + seconds)

    def texts(self, kind: EventKind | None = None) -> list[str]:
        return [event.text for event in self.events if kind in (None, event.kind)]


def test_another_state_has_its_reason_unless_it_was_commanded() -> None:
    machine = Machine()
    machine.sdo[0x1016][1].raw = 5 << 16 | 100
    machine.sent(Frame(0x705, b"\x05"))
    machine.silence(0.2)
    machine.start()
    machine.module.bus_off(machine.bus.now)
    machine.start()
    machine.sdo[0x100C].raw, machine.sdo[0x100D].raw = 100, 2
    machine.sent(Frame(0x720, b"", rtr=True))
    machine.silence(0.5)
    machine.start()
    machine.remote.nmt.state = "PRE-OPERATIONAL"
    assert [text for text in machine.texts(EventKind.NMT) if "boot-up" not in text] == [
        "OPERATIONAL",
        "PRE-OPERATIONAL: no heartbeat of node 5",
        "OPERATIONAL",
        "PRE-OPERATIONAL: the bus is gone",
        "OPERATIONAL",
        "PRE-OPERATIONAL: the guarding master is silent",
        "OPERATIONAL",
        "PRE-OPERATIONAL",
    ]
    reasons = [event.values["reason"] for event in machine.events if event.kind is EventKind.NMT]
    assert reasons[1] == "no heartbeat of node 5"
    assert reasons[-1] is None


def test_a_start_is_told_in_its_order() -> None:
    machine = Machine()
    machine.events.clear()
    machine.start("RESET")
    machine.run(200)
    first, position = EventKind.FIRST_SAMPLE, EventKind.POSITION
    kinds = [event.kind for event in machine.events]
    assert kinds == [*[EventKind.NMT] * 3, first, position, EventKind.SYNC_FOUND], "200 SYNCs tell no more"
    assert machine.texts()[:3] == ["INITIALISING", "boot-up, PRE-OPERATIONAL", "OPERATIONAL"]
    assert machine.texts(first) == ["first sample, amplitude 1500 counts"]
    assert machine.texts(position) == ["position valid"]
    assert machine.events[-1].values["rate_hz"] == pytest.approx(1000.0, rel=1e-3)


def test_a_lost_position_names_every_cause_and_how_long_it_took() -> None:
    machine = Machine(residual_limit=0.2)
    machine.run(100)
    machine.events.clear()
    machine.run(1, jump=0.3)
    machine.run(30)
    texts = machine.texts(EventKind.POSITION)
    assert len(texts) == 2
    assert texts[0].startswith("position coasting: residual 0.29")
    assert texts[0].endswith(" over 0.200 cycle")
    assert texts[1].startswith("position valid again, after ")
    machine.events.clear()
    machine.run(1, jump=0.3)
    machine.run(10, sample=False)
    assert machine.texts(EventKind.POSITION)[-1] == (
        "position lost: sample missed, residual over its limit; "
        "more samples in a row were bad or missing than 2010:03 allows; see canfb why"
    )
    assert machine.events[-1].values["cause"] == "coasted"


def late(machine: Machine) -> None:
    machine.bus.now += 2.5 * PERIOD_S - ADC_S  # without a receive time one is missed, or was heard late
    machine.sent(SYNC)
    machine.sent(adc_pdo(machine.cycles_s * machine.bus.now))


def off_time(machine: Machine) -> None:
    machine.off_s = 0.6 * PERIOD_S
    machine.run(1)


@each("fields, cycles_s, act, words", [
    ({}, 5.0, lambda one: one.run(20, amplitude=200.0), "amplitude 200 counts outside of"),
    ({}, 5.0, lambda one: one.run(20, amplitude=2500.0), "clipped"),
    ({"stamped": False}, 180.0, late, "SYNC 1.5 ms late, one may have been missed: "),
    ({"times": True}, 300.0, off_time, "position coasting: the sample time is not where it was due"),
])  # fmt: skip
def test_what_takes_the_validity_is_named(
    fields: dict[str, Any], cycles_s: float, act: Callable[[Machine], None], words: str
) -> None:
    machine = Machine(**fields)
    machine.cycles_s = cycles_s
    machine.run(100)
    machine.events.clear()
    act(machine)
    assert any(words in text for text in machine.texts(EventKind.POSITION))
    assert len(machine.events) <= 4, "20 bad samples are no 20 events"


def test_sync_is_lost_and_found_again() -> None:
    machine = Machine()
    machine.run(100)
    machine.events.clear()
    machine.silence(0.5)
    assert machine.texts(EventKind.SYNC_LOST) == ["SYNC lost, none for 2 ms"]
    machine.run(100)
    assert machine.texts(EventKind.SYNC_FOUND) == ["SYNC found, 1000 Hz"]


def test_details_are_told_one_by_one_if_wanted() -> None:
    plain, detailed = Machine(), Machine(detailed=True)
    for machine in (plain, detailed):
        machine.run(100)
        machine.events.clear()
        machine.run(3, sample=False)
    assert plain.texts(EventKind.FAULT) == plain.texts(EventKind.EMCY) == []
    missed = detailed.texts(EventKind.FAULT)
    assert missed == [f"sample {100 + k}: sample missed" for k in (1, 2)], "the third is known with its SYNC"
    (emcy,) = (event for event in detailed.events if event.kind is EventKind.EMCY)
    assert emcy.values["code"] == 0x7300
    assert "sensor: position not valid" in emcy.text


def test_table_and_saving_are_told() -> None:
    machine = Machine()
    machine.run(10)
    machine.events.clear()
    table = wavy_table(16, 1e-3)
    dictionary = machine.module.dictionary
    dictionary.entry(*od.TABLE_STAGED).download(table.to_bytes())
    dictionary.entry(*od.TABLE_ACTIVATE).download(struct.pack("<I", table.crc32))
    assert machine.texts() == [f"table in force: 16 entries, CRC {table.crc32:08X}h"]
    dictionary.entry(*od.STORE_ALL_PARAMETERS).download(b"save")
    assert machine.texts(EventKind.SAVED) == ["parameters saved: communication, application, manufacturer"]
    dictionary.entry(*od.TABLE_ACTIVATE).download(bytes(4))
    assert machine.texts(EventKind.TABLE)[-1] == "table in force: none, the identity"
    machine.events.clear()
    machine.remote.nmt.state = "RESET"
    assert machine.texts(EventKind.TABLE) == [f"table in force: 16 entries, CRC {table.crc32:08X}h"]


EMCY = 0xA0


def loss(bench: Bench) -> list[int]:
    """2012:10..16, without the time."""
    return [int(bench.sdo[0x2012][sub].raw) for sub in (0x10, *range(0x12, 0x17))]


def test_an_interface_that_falls_silent_loses_the_position_once_and_is_named(bench: Bench) -> None:
    bench.follow(0.125, 0, 20)
    assert loss(bench) == [0] * 6, "nothing is lost at first"
    assert bench.sdo[0x2012][0x11].raw == 0
    bench.sync()
    sent = [frame.data for _ in range(10) for frame in bench.sync() if frame.can_id == 0x1A0]
    statuses = [struct.unpack("<IHH", data)[1] for data in sent]
    assert [bool(status & StatusBit.LOST) for status in statuses] == [False, False, False, True]
    cause, bad, residual, limit, speed, faults = loss(bench)
    assert cause == LossCause.COASTED
    assert bad == 4, "2010:03 is 3: the fourth is too many"
    assert residual == 32768, "there was nothing to compare"
    assert limit == 21845
    assert speed == pytest.approx(0.125 * 65536, rel=0.01)
    assert faults == StatusBit.MISSED
    emergencies = [frame.data for frame in bench.heard if frame.can_id == EMCY]
    not_valid, lost = (data[3:] for data in emergencies if data[:2] == b"\x00\x73")
    assert not_valid[2:] == bytes(3), "the cause is not known yet"
    assert struct.unpack("<H", lost[:2])[0] & StatusBit.LOST
    assert lost[2:] == bytes((LossCause.COASTED, 4, 0))
    assert (bench.sdo[0x2012][5].raw, bench.sdo[0x6503].raw, bench.sdo[0x1001].raw) == (1, 1, 0x21)
    assert not bench.at(2.5)[1] & StatusBit.VALID
    bench.start("PRE-OPERATIONAL")
    assert {bench.at(2.5)[1] for _ in range(2 * STILL_SAMPLES)} == {StatusBit.LOST}, "it turned"
    bench.start("RESET")
    assert bench.at(2.5)[1] == StatusBit.VALID
    assert loss(bench) == [0] * 6
    assert bench.emergencies() == [0x7300, 0x7300], "not valid, then lost"
    assert bench.sdo[0x6503].raw == 0


def test_a_loss_survives_the_restart_that_ends_it(bench: Bench) -> None:
    """So that it can be asked for when the machine runs again."""
    bench.at(0.3, samples=20)
    for _ in range(6):
        bench.sync()
    bench.at(0.3)
    bench.start("PRE-OPERATIONAL")
    assert bench.at(0.3)[1] & StatusBit.VALID
    assert loss(bench)[0] == LossCause.COASTED


def test_what_was_wrong_is_kept_but_not_what_was_wrong_before_the_last_valid_position(bench: Bench) -> None:
    bench.follow(0.125, 0, 20)
    bench.sync()
    bench.sync()  # one is missed
    bench.follow(0.125, 22, 50)
    bench.follow(0.125, 50, 60, amplitude=100.0)
    cause, bad, *_, faults = loss(bench)
    assert (cause, bad, faults) == (LossCause.COASTED, 4, StatusBit.AMPLITUDE)


def test_the_speed_of_a_loss_is_that_of_the_machine_and_not_of_a_jump(bench: Bench) -> None:
    bench.follow(0.125, 0, 20)
    bench.follow(0.125, 23, 33)
    cause, *_, speed, _ = loss(bench)
    assert (cause, speed) == (LossCause.JUMP, pytest.approx(0.125 * 65536, rel=0.01))


def test_a_machine_that_turns_in_a_pause_is_named(bench: Bench) -> None:
    bench.follow(0.3, 0, 50)
    bench.remote.nmt.state = "PRE-OPERATIONAL"
    bench.bus.run_until(bench.bus.now + 1.0)
    bench.start()
    bench.at(0.3)
    assert loss(bench)[0] == LossCause.PAUSE


def test_two_samples_for_one_sync_leave_the_time_in_doubt(bench: Bench) -> None:
    """Other counts in the same interval: a SYNC may have been missed, or not."""
    bench.stamped = True
    bench.follow(0.3, 1, 200)
    bench.sent(adc_pdo(0.3 * 200))
    assert loss(bench)[0] == LossCause.TIME
