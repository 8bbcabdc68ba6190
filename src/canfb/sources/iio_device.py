"""What a converter of Linux IIO has, found through libiio: device, channels, formats, trigger, rate, clock.

ConfigError, which names the key, for what it does not have. Nothing here knows of a configuration.
"""

from __future__ import annotations

import contextlib
import errno
import sys
from collections.abc import Mapping
from typing import Any

from canfb.errors import BusError, CanfbError, ConfigError, reason

TIMESTAMP = "timestamp"
FIRE = "trigger_now"  # attribute of a sysfs trigger
SAMPLING_FREQUENCY = "sampling_frequency"
TIMESTAMP_CLOCK = "current_timestamp_clock"
MOST_BITS = 16  # of object 2000h
TIMEOUT_MS = 2000


class ChannelScaling:
    """From the readings of a channel to ADC counts of ``adc_bits``, 4..16.

    A converter of more than 16 bits loses the last ones. A reading at either end of its range is a
    count at the end of the range, wherever mid-scale is: it counts as clipped.
    """

    def __init__(self, bits: int, signed: bool, mid_scale: float | None) -> None:
        self.adc_bits = min(bits, MOST_BITS)
        self._lowest = -(1 << bits - 1) if signed else 0
        self._highest = self._lowest + (1 << bits) - 1
        self._mid_scale = float(0 if signed else 1 << bits - 1) if mid_scale is None else mid_scale
        self._divisor = 1 << bits - self.adc_bits
        self._full_scale = 1 << self.adc_bits - 1

    def counts(self, reading: int) -> int:
        """Counts of a reading, -2**(adc_bits - 1) to 2**(adc_bits - 1) - 1."""
        full_scale = self._full_scale
        if reading <= self._lowest:
            return -full_scale
        if reading >= self._highest:
            return full_scale - 1
        counts = round((reading - self._mid_scale) / self._divisor)
        return max(-full_scale, min(counts, full_scale - 1))


class ChannelValues:
    """Reads a channel out of a buffer; libiio makes numbers of its byte order, bits and sign."""

    def __init__(self, channel: Any) -> None:
        channel.enabled = True
        self._channel = channel
        self._bytes = channel.data_format.length // 8
        self._signed = bool(channel.data_format.is_signed)

    def last(self, buffer: Any) -> int:
        """The reading of the last scan."""
        data = self._channel.read(buffer)
        if len(data) < self._bytes:
            raise OSError(errno.EIO, "the buffer is empty")
        return int.from_bytes(data[-self._bytes :], sys.byteorder, signed=self._signed)


def binding() -> Any:
    """libiio's Python binding. BusError where it is missing, or too new."""
    try:
        import iio
    except ImportError:
        raise BusError("source kind iio needs libiio's Python binding: pip install 'canfb[iio]'") from None
    except (AttributeError, OSError):  # how the binding fails without its library
        raise BusError("source kind iio needs the library libiio: apt-get install libiio0") from None
    if iio.version[0] != 0:
        raise BusError(f"source kind iio needs libiio 0.x and pylibiio below 1, not {iio.version[2]}")
    return iio


def open_context(iio: Any, uri: str) -> Any:
    """The context, which waits two seconds at most. BusError."""
    try:
        context = iio.Context(uri)
        context.set_timeout(TIMEOUT_MS)
    except OSError as error:
        raise BusError(f"IIO context {uri!r}: {hint(error)}") from error
    return context


def find_device(iio: Any, context: Any, wanted: str, uri: str) -> Any:
    """The device with this name, id or label."""
    device = context.find_device(wanted) if wanted.isascii() else None
    if device is None or isinstance(device, iio.Trigger):
        names = [_name(one) for one in context.devices if not isinstance(one, iio.Trigger)]
        raise _missing("device", wanted, f"in {uri}", names)
    return device


def find_channel(device: Any, key: str, wanted: str) -> Any:
    """The channel with this name or id, which is that of ``key``; it has a place in the buffer."""
    channel = device.find_channel(wanted) if wanted.isascii() else None
    if channel is None or not channel.scan_element:
        names = [one.id for one in device.channels if one.scan_element and not one.output]
        found = "of a buffer " if channel is not None else ""
        raise _missing(key, wanted, f"as a channel {found}in {_name(device)}", names)
    return channel


def find_timestamp(device: Any) -> Any:
    """The channel with the kernel's time of a scan."""
    channel = device.find_channel(TIMESTAMP)
    if channel is None or not channel.scan_element:
        raise ConfigError(f"source: time_stamps: {_name(device)} has no time stamps; set time_stamps: false")
    return channel


def common_scaling(tracks: Mapping[str, Any], mid_scale: float | None) -> ChannelScaling:
    """Of both channels, by their keys; they must have one format."""
    formats = {key: (channel.id, channel.data_format) for key, channel in tracks.items()}
    for key, (name, one) in formats.items():
        if one.repeat > 1:
            raise ConfigError(f"source: {key}: {name!r} has {one.repeat} values in a scan")
        if not 4 <= one.bits <= 64:
            raise ConfigError(f"source: {key}: {name!r} has {one.bits} bits, not 4 to 64")
    (first, sine), (second, cosine) = formats.values()
    if (sine.bits, bool(sine.is_signed)) != (cosine.bits, bool(cosine.is_signed)):
        raise ConfigError(f"source: cosine: the format of {second!r} differs from that of {first!r}")
    return ChannelScaling(sine.bits, bool(sine.is_signed), mid_scale)


def give_trigger(iio: Any, context: Any, device: Any, wanted: str, uri: str) -> Any:
    """The trigger with this name or id; the device has it from now on."""
    trigger = context.find_device(wanted) if wanted.isascii() else None
    if not isinstance(trigger, iio.Trigger):
        names = [_name(one) for one in context.devices if isinstance(one, iio.Trigger)]
        raise _missing("trigger", wanted, f"in {uri}", names)
    device.trigger = trigger
    return trigger


def set_rate(trigger: Any, device: Any, rate_hz: int) -> None:
    """The sampling frequency, of the trigger (None: there is none) if it has one, else of the device."""
    for one in (trigger, device):
        if one is not None and SAMPLING_FREQUENCY in one.attrs:
            one.attrs[SAMPLING_FREQUENCY].value = str(rate_hz)
            return
    raise ConfigError(f"source: rate_hz: neither trigger nor {_name(device)} has a {SAMPLING_FREQUENCY}")


def choose_clock(device: Any) -> None:
    """A clock that is never set, where there is the choice; the default is the calendar's."""
    if TIMESTAMP_CLOCK in device.attrs:
        with contextlib.suppress(OSError):
            device.attrs[TIMESTAMP_CLOCK].value = "monotonic"


def hint(error: OSError) -> str:
    """The reason, and what to look at."""
    hints = {
        errno.ENOENT: "; is the driver of a converter loaded?",
        errno.EINVAL: "; is a trigger missing?",
        errno.EBUSY: "; another program captures it",
        errno.EACCES: "; see the permissions of /dev/iio:device*",
    }
    return f"{reason(error)}{hints.get(error.errno or 0, '')}"


def _name(device: Any) -> str:
    return f"{device.id} ({device.name})" if device.name else str(device.id)


def _missing(key: str, wanted: str, where: str, there: list[str]) -> CanfbError:
    return ConfigError(f"source: {key}: no {wanted!r} {where}; there is {', '.join(there) or 'nothing'}")
