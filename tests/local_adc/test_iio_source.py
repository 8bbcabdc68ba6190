"""The source of kind iio: libiio and its Python binding, with an emulated ADC behind them."""

import errno
import re
import threading
from collections.abc import Callable
from typing import Any

import pytest
from emulated_iiod import (
    Channel,
    EmulatedAdc,
    EmulatedIiod,
    deliver,
    iio_source,
    reading,
    sample,
    time_stamp,
    until,
    voltage,
)

from canfb.errors import BusError, ConfigError
from canfb.hosting.captured_source import CapturedSource
from canfb.sources.iio_source import IioSourceConfig
from canfb.sources.protocol import SourceError
from folding import each

Iiod = Callable[..., EmulatedIiod]
Opened = Callable[..., tuple[EmulatedIiod, CapturedSource]]


def adc(first: str, second: str | None = None) -> EmulatedAdc:
    return EmulatedAdc(channels=[voltage(0, first), voltage(1, second or first), time_stamp(2)])


def test_a_sync_takes_the_newest_scan_and_takes_it_once(opened: Opened) -> None:
    server, source = opened()
    assert source.next() is None
    deliver(server, source, reading(2048, 4000, 1_000_000))
    assert source.next() == sample(0, 1952, 10_000)
    assert source.next() is None
    deliver(server, source, *[reading(2048 + n, 1000, 2_000_000 + n * 100) for n in range(10)])
    assert source.next() == sample(9, -1048, 20_009)
    assert source.next() is None


def test_only_sine_cosine_and_time_are_captured_and_the_buffer_is_small(opened: Opened) -> None:
    server, _ = opened(buffer_scans=8)
    assert "OPEN iio:device0 1 0000000b" in server.commands
    assert "SET iio:device0 BUFFERS_COUNT 8" in server.commands
    assert server.adc.attributes["current_timestamp_clock"] == "monotonic"


def test_channels_may_be_any_of_a_device_by_its_id(opened: Opened) -> None:
    server, source = opened(device="iio:device0", sine="voltage2", cosine="voltage0", time_stamps=False)
    deliver(server, source, reading(2050, 0, 5))
    assert source.next() == sample(77 - 2048, 2, None)


# Format, readings that come, counts that are wanted, bits of a count.
FORMATS = {
    "le:u12/16>>0": ((0, 2049), (-2048, 1), 12),
    "be:u12/16>>0": ((4095, 2047), (2047, -1), 12),
    "le:u12/16>>4": ((1, 4000), (-2047, 1952), 12),
    "be:u12/16>>4": ((2048, 77), (0, 77 - 2048), 12),
    "le:s12/16>>4": ((-2048, -1), (-2048, -1), 12),
    "be:s12/16>>2": ((-700, 1400), (-700, 1400), 12),
    "le:s16/16>>0": ((-32768, 32767), (-32768, 32767), 16),
    "be:U16/16>>0": ((40000, 0), (40000 - 32768, -32768), 16),
    "le:u10/16>>0": ((0x200, 0x3FF), (0, 511), 10),
    "le:u8/8>>0": ((0, 200), (-128, 72), 8),
    "be:s24/32>>8": ((-(1 << 23), 256 * 100), (-32768, 100), 16),
    "le:u24/32>>0": ((1 << 23, (1 << 23) - 256), (0, -1), 16),
    "le:s32/32>>0": ((1 << 30, -65536), (16384, -1), 16),
}


@pytest.mark.parametrize("format", FORMATS)
def test_readings_of_any_format_become_counts(format: str, opened: Opened) -> None:
    (sine, cosine), counts, bits = FORMATS[format]
    server, source = opened(adc(format))
    deliver(server, source, reading(sine, cosine, 100))
    assert source.next() == sample(*counts, 1)
    assert source.adc_bits == bits


def test_mid_scale_is_subtracted_and_a_reading_at_the_end_stays_at_the_end(opened: Opened) -> None:
    server, source = opened(mid_scale=2000.5, time_stamps=False)
    for readings, counts in (
        ((2000, 2001), (0, 0)),
        ((1, 4094), (-2000, 2047)),
        ((0, 4095), (-2048, 2047)),
        ((1000, 3000), (-1000, 1000)),
    ):
        deliver(server, source, reading(*readings))
        assert source.next() == sample(*counts, None)


def test_a_scan_that_is_not_later_than_the_one_before_is_invalid(opened: Opened) -> None:
    server, source = opened()
    wraps_ns = (1 << 32) * 100
    for time_ns, invalid in (
        *((5_000, False), (5_000, True), (4_000, True), (4_100, False)),
        (wraps_ns + 799, False),
    ):
        deliver(server, source, reading(2048, 2048, time_ns))
        time_100ns = time_ns % wraps_ns // 100
        assert source.next() == sample(0, 0, time_100ns)._replace(invalid=invalid)


def test_stated_bits_are_those_of_the_converter(opened: Opened) -> None:
    assert opened(adc("be:s24/32>>8"), adc_bits=16)[1].adc_bits == 16
    with pytest.raises(ConfigError, match=r"^adc_bits is 12, but the converter of 'ads7950' has 24$"):
        opened(adc("be:s24/32>>8"), adc_bits=12)


REFUSED: dict[str, tuple[EmulatedAdc, dict[str, Any], str]] = {
    "device": (EmulatedAdc(), {"device": "max11"}, "source: device: no 'max11' in ip:"),
    "device that is a trigger": (
        EmulatedAdc(), {"device": "tick"}, "there is iio:device0 (ads7950)"),
    "device not in ascii": (EmulatedAdc(), {"device": "µ"}, "source: device: no 'µ' in ip:"),
    "sine": (
        EmulatedAdc(), {"sine": "voltage9"},
        "source: sine: no 'voltage9' as a channel in iio:device0 (ads7950); "
        "there is timestamp, voltage0, voltage1, voltage2"),
    "cosine without a place in the buffer": (
        EmulatedAdc(channels=[voltage(0), Channel("voltage1", -1, ""), time_stamp(1)]), {},
        "source: cosine: no 'voltage1' as a channel of a buffer in iio:device0"),
    "output": (
        EmulatedAdc(channels=[voltage(0), Channel("voltage1", 1, "le:u12/16>>0", output=True)]), {},
        "source: cosine: no 'voltage1' as a channel in"),
    "no time stamps": (
        EmulatedAdc(channels=[voltage(0), voltage(1)]), {},
        "source: time_stamps: iio:device0 (ads7950) has no time stamps; set time_stamps: false"),
    "trigger": (
        EmulatedAdc(), {"trigger": "tock"},
        "there is trigger0 (sysfstrig7), trigger1 (tick)"),
    "trigger that is a device": (
        EmulatedAdc(triggers={}), {"trigger": "ads7950"}, "source: trigger: no 'ads7950' in ip:"),
    "clock of a fired trigger": (
        EmulatedAdc(), {"trigger": "sysfstrig7", "scans_per_sync": 4},
        "source: trigger: 'sysfstrig7' is fired once for each SYNC; scans_per_sync"),
    "two formats": (
        adc("le:u12/16>>0", "le:u10/16>>0"), {},
        "source: cosine: the format of 'voltage1' differs from that of 'voltage0'"),
    "signed and not": (
        adc("le:u12/16>>0", "le:s12/16>>0"), {},
        "source: cosine: the format of 'voltage1' differs from that of 'voltage0'"),
    "several values": (
        adc("le:u12/16X2>>0"), {}, "source: sine: 'voltage0' has 2 values in a scan"),
    "few bits": (adc("le:u3/8>>0"), {}, "source: sine: 'voltage0' has 3 bits, not 4 to 64"),
    "rate": (
        EmulatedAdc(attributes={}), {"rate_hz": 5},
        "source: rate_hz: neither trigger nor iio:device0 (ads7950) has a sampling_frequency"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_the_device_does_not_have_is_told_with_its_key(case: str, opened: Opened) -> None:
    adc, keys, words = REFUSED[case]
    with pytest.raises(ConfigError, match=re.escape(words)) as caught:
        opened(adc, **keys)
    assert "\n" not in str(caught.value)


@each("number, words", [
    (errno.EBUSY, "another program captures it"),
    (errno.EINVAL, "is a trigger missing?"),
    (errno.EACCES, "permissions"),
    (errno.ENODEV, "No such device"),
])  # fmt: skip
def test_a_device_that_cannot_be_opened_is_told(number: int, words: str, opened: Opened) -> None:
    with pytest.raises(BusError, match=rf"^IIO device 'ads7950' of ip:.*{re.escape(words)}") as caught:
        opened(EmulatedAdc(open_error=number))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("uri", ["ip:127.0.0.1:9", "nonsense", "local:"])
def test_a_context_that_is_not_there_is_told(uri: str) -> None:
    with pytest.raises((BusError, ConfigError), match=re.escape(uri)):
        iio_source(IioSourceConfig(device="nowhere", uri=uri))


@pytest.mark.parametrize(("trigger", "where"), [("tick", "trigger"), (None, "device")])
def test_the_rate_is_set_where_it_can_be(trigger: str | None, where: str, opened: Opened) -> None:
    server, _ = opened(trigger=trigger, rate_hz=4000)
    adc = server.adc
    rates = {"trigger": adc.triggers["tick"], "device": adc.attributes}
    assert rates[where]["sampling_frequency"] == "4000"
    assert adc.trigger == trigger


def test_a_trigger_is_fired_at_the_sync_and_its_scan_is_the_sample(opened: Opened) -> None:
    server, source = opened(trigger="sysfstrig7", wait_us=1_000_000)
    left = iter([reading(2048 + n, 0, n * 1000) for n in range(5)])
    server.adc.on_fire = lambda: server.deliver(next(left))
    assert server.adc.trigger == "sysfstrig7"
    assert source.scans == 0, "nothing is sampled before the first SYNC"
    for n in range(5):
        assert source.next() == sample(n, -2048, n * 10)


def test_a_scan_that_comes_too_late_is_missed_and_not_taken_for_the_next(opened: Opened) -> None:
    server, source = opened(trigger="sysfstrig7", wait_us=200_000)
    assert source.next() is None
    server.adc.on_fire = lambda: server.deliver(reading(2049, 2050, 100))
    assert source.next() is None, "what comes now may be the scan of the SYNC before"
    deliver(server, source, reading(1, 1, 0))
    assert source.next() == sample(1, 2, 1)


def test_a_trigger_that_cannot_be_fired_is_a_failure(opened: Opened) -> None:
    server, source = opened(EmulatedAdc(fire_error=errno.EIO), trigger="sysfstrig7")
    with pytest.raises(SourceError, match="the trigger cannot be fired: Input/output error"):
        source.next()
    server.adc.fire_error = 0
    server.adc.on_fire = lambda: server.deliver(reading(2048, 2048, 0))
    until(lambda: source.next() is not None, "works again")


def failing(source: CapturedSource, words: str = "") -> bool:
    try:
        source.next()
    except SourceError as error:
        return words in str(error)
    return False


@pytest.mark.parametrize("number", [errno.EPIPE, errno.EOVERFLOW, errno.ENODEV, errno.EIO])
def test_a_capture_that_ends_is_begun_again(number: int, opened: Opened) -> None:
    server, source = opened()
    deliver(server, source, reading(1, 2))
    server.adc.open_error = errno.ENODEV
    server.deliver(number)
    until(lambda: failing(source), "failing")
    server.adc.open_error = 0
    assert server.opened.wait(10.0)
    until(lambda: not failing(source), "opened again")
    deliver(server, source, reading(2049, 2050))
    assert source.next() == sample(1, 2, 0)


def test_another_converter_in_its_place_is_not_taken(opened: Opened) -> None:
    server, source = opened()
    server.adc.channels = adc("le:s16/16>>0").channels
    server.cut()
    until(lambda: failing(source, "the converter has 16 bits now, not 12"), "refused")


def test_a_device_without_scans_is_no_failure(opened: Opened) -> None:
    """The server says after a while that there was nothing, and is asked again."""
    server, source = opened()
    until(lambda: server.commands.count("READBUF iio:device0 16") > 1, "asked again")
    assert source.next() is None
    deliver(server, source, reading(2048, 2048))
    assert source.next() == sample(0, 0, 0)


def test_closing_ends_the_thread_and_lets_the_device_go(iiod: Iiod) -> None:
    server = iiod()
    before = threading.active_count()
    for _ in range(3):
        source = iio_source(IioSourceConfig(device="ads7950", uri=server.uri))
        assert server.opened.wait(10.0)
        source.close()
        assert not [thread for thread in threading.enumerate() if thread.name == "iio ads7950"]
        until(lambda: not server.captures, "let go")
    until(lambda: threading.active_count() <= before, "as many threads as before")


def test_closing_while_it_waits_to_open_again(iiod: Iiod) -> None:
    server = iiod()
    source = iio_source(IioSourceConfig(device="ads7950", uri=server.uri), reopen_s=1000.0)
    assert server.opened.wait(10.0)
    server.close()
    until(lambda: failing(source), "failing")
    source.close()
    assert not [thread for thread in threading.enumerate() if thread.name == "iio ads7950"]
