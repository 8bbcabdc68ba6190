"""A device with the mandatory objects only: every other service does without its objects."""

from __future__ import annotations

from device_kit import ID, Bench

from canfb.cia301.codes import EmergencyCode
from canfb.device.od.dictionary import Dictionary, Entry


def minimal() -> Bench:
    bench = Bench(Dictionary([Entry(0x1000, 0, 7, access="ro"), Entry(0x1001, 0, 5, access="ro")]))
    bench.start()
    return bench


def test_emergencies_use_the_default_can_id() -> None:
    bench = minimal()
    bench.node.emergency(EmergencyCode.SENSOR, 0x20, now=0.0)
    assert bench.tick() == [f"{0x80 + ID:03X}#0073210000000000"]
    assert bench.read(0x1001) == 0x21


def test_without_even_an_error_register() -> None:
    bench = Bench(Dictionary([Entry(0x1000, 0, 7, access="ro")]))
    bench.start()
    bench.node.emergency(EmergencyCode.SENSOR, 0x20, now=0.0)
    assert bench.tick() == ["0A0#0073210000000000"]


def test_half_a_second_channel_is_none() -> None:
    entries = [Entry(0x1201, 1, 7, default=0x680)]
    bench = Bench(Dictionary(entries))
    bench.start()
    assert bench.send(0x680, "4001120100000000") == []
    assert bench.read(0x1201, 1) == 0x680
