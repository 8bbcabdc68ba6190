"""2000:0E and 2014h through the module: pairing by SYNC, status bit, counter, EMCY, event."""

import math
import struct
from typing import Any

import pytest
from module_bench import SYNC, Bench

from canfb import Frame, SecondPositionConfig, StatusBit
from canfb.module.events import Event, EventKind
from folding import each
from ideal_tracks import counts_at

N, INCREMENTS = 2500, 1 << 20
VALUE_ID = 0x1B0
DISAGREES = StatusBit.SECOND_POSITION
EMERGENCY = 0xFF1C


def second(**fields: Any) -> SecondPositionConfig:
    fields = {"increments": INCREMENTS, "tolerance_revolutions": 0.01, "cob_id": VALUE_ID} | fields
    return SecondPositionConfig(**fields)


class Axis(Bench):
    """An encoder interface and a drive, both played by hand."""

    def __init__(self, late: bool = False, values: int = 1, pairs: int = 1, **fields: Any) -> None:
        words: dict[str, Any] = {"second_position": second(before_bytes=3), "samples_per_sync": pairs}
        super().__init__(**words | fields)
        self.events: list[Event] = []
        self.module.events.on_event = self.events.append
        self.late, self.pairs, self.amplitude = late, pairs, 1500.0
        self.place = self.slip = 0.0
        self.start()
        self.run(30, values=values)

    def cycle(self, speed: float = 0.0, values: int = 1) -> int:
        """A SYNC, then the sample and the value in either order; the status word."""
        self.place += speed
        self.sync()
        drive = self.module.config.second_position
        assert drive is not None
        increments = math.floor((self.place + self.slip) / N * drive.increments)
        data = struct.pack("<HBi", 0x1234, 8, increments)[3 - drive.before_bytes :]
        if not self.late:
            self._values(data, values)
        tracks = [counts_at(self.place - speed * j / self.pairs, self.amplitude) for j in range(self.pairs)]
        flat, sent = [track for pair in tracks for track in pair], []
        for n in range(0, len(flat), 4):
            part = flat[n : n + 4]
            sent += self.sent(Frame(0x190 + 0x40 * n, struct.pack(f"<{len(part)}h", *part)))
        if self.late:
            self._values(data, values)
        return self.position(sent)[1]

    def _values(self, data: bytes, values: int) -> None:
        for _ in range(values):
            self.sent(Frame(VALUE_ID, data))

    def run(self, cycles: int, speed: float = 0.0, values: int = 1) -> list[int]:
        return [self.cycle(speed, values) for _ in range(cycles)]

    def texts(self) -> list[str]:
        return [event.text for event in self.events if event.kind is EventKind.SECOND_POSITION]


@each("late", [False, True])
def test_a_slipping_coupling(late: bool) -> None:
    """The value may come before the sample or after it."""
    axis = Axis(late)
    for k in range(100):
        axis.cycle(min(0.2 * k, 15.0))
    assert axis.run(50, 15.0)[-1] == StatusBit.VALID
    statuses = []
    for _ in range(60):
        axis.slip -= 0.7
        statuses.append(axis.cycle(15.0))
    first = statuses.index(StatusBit.VALID | DISAGREES)
    assert 0.7 * (first + 1) == pytest.approx(0.01 * N + 3 * 0.7, abs=1.5)
    assert all(status == StatusBit.VALID | DISAGREES for status in statuses[first:])
    assert axis.sdo[0x2012][15].raw == 60 - first
    assert axis.sdo[0x2014][6].raw == pytest.approx(-59 * 0.7 / N, abs=1e-5)
    assert axis.sdo[0x6505].raw == 1 << 12
    assert axis.emergencies().count(EMERGENCY) == 1
    (text,) = axis.texts()
    assert text == f"second position disagrees: -{0.7 * first / N:.4g} revolutions, tolerance 0.01"
    axis.slip = 0.0
    assert axis.run(1100, 15.0)[-1] == StatusBit.VALID
    assert (axis.texts()[1:], axis.sdo[0x1001].raw) == (["second position disagrees no longer"], 0)


@each("kind", ["synchronous", "in one PDO with another", "mapped by a master"])
def test_other_ways_to_bring_the_value(kind: str) -> None:
    axis = Axis()
    if kind == "synchronous":
        axis.sdo[0x1401][2].raw = 1
    if kind == "mapped by a master":
        axis = Axis(second_position=second(cob_id=None, before_bytes=3))
        assert axis.module.chain.second is None
        axis.sdo[0x1601][1].raw, axis.sdo[0x1601][2].raw = 0x00060010, 0x00050008
        axis.sdo[0x1601][3].raw = 0x20000E20
        axis.sdo[0x1601][0].raw = 3
        axis.sdo[0x1401][1].raw = VALUE_ID
        axis.run(30)
    assert axis.run(200, 0.1)[-1] == StatusBit.VALID
    axis.slip = 27.0
    assert axis.run(6, 0.1)[-1] & DISAGREES


@each("values", [0, 2, 3])
def test_what_does_not_belong_to_one_sync_is_no_opinion(values: int) -> None:
    axis = Axis()
    axis.slip = 400.0
    assert axis.run(40, 0.1, values)[-1] == StatusBit.VALID
    assert axis.run(5, 0.1)[-1] & DISAGREES


def test_a_write_to_2014h_learns_the_offset_again() -> None:
    axis = Axis()
    axis.slip = 100.0
    assert axis.run(6)[-1] & DISAGREES
    axis.sdo[0x2014][4].raw = 0.02
    assert axis.run(30)[-1] == StatusBit.VALID
    axis.slip += 0.021 * N
    assert axis.run(6)[-1] & DISAGREES
    axis.sdo[0x2014][4].raw = 0.0  # off
    assert axis.run(6)[-1] == StatusBit.VALID
    assert axis.module.chain.second is None


@each("n, index, subindex, value", [(N, 0x2014, 4, 0.6 / N), (1250, 0x2001, 1, N)])
@each("samples", [1, 2])
def test_an_open_start_stays_open_for_another_sensor(
    n: int, index: int, subindex: int, value: float, samples: int
) -> None:
    """What is written says nothing of the speed, which the sensor has yet to confirm."""
    drive = second(before_bytes=3, tolerance_revolutions=0.3 / N, increments=1 << 24)
    axis, away = Axis(second_position=drive, cycles_per_revolution=n), []
    axis.remote.nmt.send_command(0x81)
    axis.start()
    axis.run(samples, 1.72)
    axis.sdo[index][subindex].raw = value
    for _ in range(60):
        status, feedback = axis.cycle(1.72), axis.module.feedback
        assert feedback is not None
        if status & StatusBit.VALID:
            away.append(feedback.cycles + feedback.phase - axis.place)
    assert len(away) > 20
    assert away == pytest.approx([round(away[0])] * len(away), abs=0.1)


def test_it_may_end_the_validity() -> None:
    axis = Axis(second_position=second(before_bytes=3, invalidates=True))
    axis.slip = 100.0
    before = axis.emergencies().count(0x7300)
    assert axis.run(6)[-1] == DISAGREES | StatusBit.COASTING
    assert axis.emergencies().count(0x7300) == before + 1
    assert "position coasting: second position disagrees" in [event.text for event in axis.events]


@each("what", ["a SYNC too many", "a sample missed"])
def test_no_value_is_paired_with_the_sample_of_another_sync(what: str) -> None:
    axis = Axis()
    axis.stamped = True
    for k in range(200):
        axis.cycle(min(0.2 * k, 30.0))
    for _ in range(10):
        if what == "a sample missed":
            axis.place += 30.0
            axis.sync()
            axis.sent(Frame(VALUE_ID, struct.pack("<HBi", 0, 0, math.floor(axis.place / N * INCREMENTS))))
        else:
            axis.bus.run_until(axis.bus.now + 1e-4)
            axis.sent(SYNC)
            axis.interval_s = 9e-4
            axis.cycle(30.0)
            axis.interval_s = 1e-3
        assert not any(status & DISAGREES for status in axis.run(12, 30.0))
    assert axis.sdo[0x2012][15].raw == 0
    axis.slip = 100.0
    assert axis.run(10, 30.0)[-1] & DISAGREES


@each("before, after, entries", [
    (0, 0, []), (3, 0, [0x00060010, 0x00050008]), (4, 0, [0x00070020]), (1, 2, [0x00050008, 0x00060010]),
])  # fmt: skip
def test_the_mapping_of_rpdo2(before: int, after: int, entries: list[int]) -> None:
    bench = Bench(second_position=second(before_bytes=before, after_bytes=after))
    mapped = [bench.sdo[0x1601][n].raw for n in range(1, bench.sdo[0x1601][0].raw + 1)]
    assert sorted(mapped) == sorted([*entries, 0x20000E20])
    assert sum(entry & 0xFF for entry in mapped[: mapped.index(0x20000E20)]) == 8 * before
    assert bench.sdo[0x1401][1].raw == VALUE_ID


@each("pairs", [2, 4, 6])
def test_with_several_samples_in_one_sync(pairs: int) -> None:
    """The value belongs to the newest of them, and comes in the first RPDO that is left."""
    axis = Axis(pairs=pairs, second_position=second(tolerance_revolutions=0.3 / N, increments=1 << 24))
    assert axis.cycle() == StatusBit.VALID
    assert axis.sdo[0x1400 + pairs // 2][1].raw == VALUE_ID
    assert {axis.cycle(min(0.3 * k, 60.0)) for k in range(220)} == {StatusBit.VALID}
    opinion = axis.module.chain.second
    assert opinion is not None
    assert opinion.difference_cycles == pytest.approx(0.0, abs=0.03)
    axis.amplitude = 0.0
    assert axis.run(10, 61.0)[-1] & StatusBit.LOST
    axis.amplitude = 1500.0
    assert axis.run(60, 61.5)[-1] == StatusBit.VALID
    assert opinion.difference_cycles == pytest.approx(0.0, abs=0.03)
    axis.slip = 1.0
    assert axis.run(6, 61.5)[-1] == StatusBit.VALID | DISAGREES
