from __future__ import annotations

import pytest
from device_kit import Bench

from canfb.cia301.codes import EmergencyCode

SENSOR, DATA_SET = EmergencyCode.SENSOR, EmergencyCode.DATA_SET


def sent(bench: Bench) -> list[str]:
    """What an error outside of a call left to send; the deadline must say so."""
    assert bench.node.deadline() == bench.now
    return bench.tick()


def test_frame_register_and_history(bench: Bench) -> None:
    bench.now = 3.0
    bench.node.emergency(SENSOR, 0x20, b"\x01\x02\x03\x04\x05", bench.now)
    assert sent(bench) == ["0A0#0073210102030405"]
    assert bench.read(0x1001) == 0x21
    assert bench.read(0x1003) == 1
    assert bench.read(0x1003, 1) == 0x02017300
    bench.node.clear_emergency(SENSOR, bench.now)
    assert sent(bench) == ["0A0#0000000000000000"]
    assert bench.read(0x1001) == 0
    assert bench.read(0x1003) == 1


def test_the_history_is_newest_first_and_bounded(bench: Bench) -> None:
    for number in range(6):
        bench.node.emergency(0x1000 + number, 0, now=0.0)
    assert len(sent(bench)) == 6
    assert bench.read(0x1003) == 4
    assert [bench.read(0x1003, sub) for sub in range(1, 5)] == [0x1005, 0x1004, 0x1003, 0x1002]


def test_waiting_frames_are_bounded(bench: Bench) -> None:
    bench.write(0x1015, 0, 1000, 2)
    for number in range(1, 21):
        bench.node.emergency(0x1000 + number, 0, now=0.0)
    times, frames = zip(*bench.run(10.0), strict=True)
    assert times == pytest.approx([0.1 * number for number in range(9)])
    assert frames[-1].startswith("0A0#1410")
    assert bench.node.counters.lost_emergencies == 11


def test_an_error_raised_at_reset_follows_the_boot_up(bench: Bench) -> None:
    bench.application.react(reset_done=lambda only, now: bench.node.emergency(SENSOR, 0x20, now=now))
    assert bench.nmt(129) == ["720#00", "0A0#0073210000000000"]


def test_wrong_arguments(bench: Bench) -> None:
    with pytest.raises(ValueError, match="1001h"):
        bench.node.emergency(SENSOR, 0x100, now=0.0)
    with pytest.raises(ValueError, match="5 manufacturer bytes"):
        bench.node.emergency(SENSOR, 0, bytes(6), 0.0)
    with pytest.raises(ValueError, match="clear_emergency"):
        bench.node.emergency(EmergencyCode.NO_ERROR, 0, now=0.0)


def test_what_waits_does_not_survive_a_reset(bench: Bench) -> None:
    bench.write(0x1015, 0, 10000, 2)
    bench.node.emergency(SENSOR, 0x20, now=0.0)
    bench.node.emergency(DATA_SET, 0x20, now=0.0)
    bench.run(0.0)
    assert bench.nmt(129) == ["720#00"]
    assert bench.run(10.0) == []
    bench.node.emergency(SENSOR, 0x20, now=bench.now)
    assert len(sent(bench)) == 1


def test_an_active_error_is_told_again_if_its_details_have_changed(bench: Bench) -> None:
    for detail, again in ((b"\x01", False), (b"\x02", False), (b"\x03", True)):
        bench.node.emergency(SENSOR, 0x20, detail, now=0.0, again=again)
    bench.node.clear_emergency(SENSOR, 0.0)
    assert [text[4:10] + text[10:12] for text in sent(bench)] == ["00732101", "00732103", "00000000"]
