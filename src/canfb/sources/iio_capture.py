"""Scans of a local ADC through libiio: opening the device, and one scan after the other.

Nothing here has a thread or a clock; :class:`canfb.bus.captured_source.CapturedSource` waits for the scans.
"""

from __future__ import annotations

import contextlib
import errno
import sys
from typing import TYPE_CHECKING, Any

from canfb.errors import BusError, CanfbError, ConfigError, reason
from canfb.signal.sample import Sample

if TYPE_CHECKING:
    from canfb.sources.iio_source import IioSourceConfig

TIMESTAMP = "timestamp"
FIRE = "trigger_now"  # attribute of a sysfs trigger
SAMPLING_FREQUENCY = "sampling_frequency"
TIMESTAMP_CLOCK = "current_timestamp_clock"
MOST_BITS = 16  # of object 2000h
TIMEOUT_MS = 2000
NS_PER_100NS = 100


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


class IioCapture:
    """A :class:`canfb.sources.surroundings.Capture`: an open device, whose kernel buffers both channels.

    ConfigError, which names the key, for what the device does not have; BusError for what does not
    work. :meth:`refill` may be called in another thread than :meth:`fire` and :meth:`cancel`.
    """

    def __init__(self, config: IioSourceConfig) -> None:
        iio = _binding()
        self._context = _opened(iio, config.uri)
        try:
            self._context.set_timeout(TIMEOUT_MS)
            self._open(iio, config)
        except OSError as error:
            raise BusError(f"IIO device {config.device!r} of {config.uri}: {_hint(error)}") from error

    def _open(self, iio: Any, config: IioSourceConfig) -> None:
        device = self._device = _device(iio, self._context, config)
        sine, cosine = (_channel(device, config, key) for key in ("sine", "cosine"))
        stamp = _timestamp(device) if config.time_stamps else None
        self._scaling = _scaling(sine, cosine, config)
        self._trigger = _trigger(iio, self._context, device, config)
        _set_rate(self._trigger, device, config)
        _choose_clock(device)
        for channel in device.channels:
            channel.enabled = False
        self._channels = [_Values(channel) for channel in (sine, cosine, stamp) if channel is not None]
        device.set_kernel_buffers_count(config.buffer_scans)
        self._buffer = iio.Buffer(device, 1)

    @property
    def adc_bits(self) -> int:
        """Bits of a count, 4..16."""
        return self._scaling.adc_bits

    @property
    def is_fired(self) -> bool:
        """The trigger waits for :meth:`fire`."""
        return self._trigger is not None and FIRE in self._trigger.attrs

    def fire(self) -> None:
        """Have one scan taken. OSError if that fails."""
        assert self._trigger is not None
        self._trigger.attrs[FIRE].value = "1"

    def refill(self) -> Sample | None:
        """Wait for the next scan; None if there was none for two seconds. OSError when capturing ends."""
        try:
            self._buffer.refill()
        except OSError as error:
            if error.errno == errno.ETIMEDOUT:
                return None
            raise
        values = [channel.last(self._buffer) for channel in self._channels]
        counts = self._scaling.counts
        time = values[2] // NS_PER_100NS & 0xFFFFFFFF if len(values) == 3 else None
        return Sample(counts(values[0]), counts(values[1]), time_100ns=time)

    def cancel(self) -> None:
        """Let :meth:`refill` end with an OSError, now and ever after."""
        self._buffer.cancel()


class _Values:
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


def _binding() -> Any:
    try:
        import iio
    except ImportError:
        raise BusError("source kind iio needs libiio's Python binding: pip install 'canfb[iio]'") from None
    except (AttributeError, OSError):  # how the binding fails without its library
        raise BusError("source kind iio needs the library libiio: apt-get install libiio0") from None
    if iio.version[0] != 0:
        raise BusError(f"source kind iio needs libiio 0.x and pylibiio below 1, not {iio.version[2]}")
    return iio


def _opened(iio: Any, uri: str) -> Any:
    try:
        return iio.Context(uri)
    except OSError as error:
        raise BusError(f"IIO context {uri!r}: {_hint(error)}") from error


def _device(iio: Any, context: Any, config: IioSourceConfig) -> Any:
    device = context.find_device(config.device) if config.device.isascii() else None
    if device is None or isinstance(device, iio.Trigger):
        names = [_name(one) for one in context.devices if not isinstance(one, iio.Trigger)]
        raise _missing("device", config.device, f"in {config.uri}", names)
    return device


def _channel(device: Any, config: IioSourceConfig, key: str) -> Any:
    wanted = getattr(config, key)
    channel = device.find_channel(wanted) if wanted.isascii() else None
    if channel is None or not channel.scan_element:
        names = [one.id for one in device.channels if one.scan_element and not one.output]
        found = "of a buffer " if channel is not None else ""
        raise _missing(key, wanted, f"as a channel {found}in {_name(device)}", names)
    return channel


def _timestamp(device: Any) -> Any:
    channel = device.find_channel(TIMESTAMP)
    if channel is None or not channel.scan_element:
        raise ConfigError(f"source: time_stamps: {_name(device)} has no time stamps; set time_stamps: false")
    return channel


def _scaling(sine: Any, cosine: Any, config: IioSourceConfig) -> ChannelScaling:
    formats = [channel.data_format for channel in (sine, cosine)]
    for key, channel in zip(("sine", "cosine"), formats, strict=True):
        if channel.repeat > 1:
            raise ConfigError(
                f"source: {key}: {getattr(config, key)!r} has {channel.repeat} values in a scan"
            )
        if not 4 <= channel.bits <= 64:
            raise ConfigError(f"source: {key}: {getattr(config, key)!r} has {channel.bits} bits, not 4 to 64")
    (bits, signed), other = ((one.bits, bool(one.is_signed)) for one in formats)
    if (bits, signed) != other:
        raise ConfigError(
            f"source: cosine: the format of {config.cosine!r} differs from that of {config.sine!r}"
        )
    scaling = ChannelScaling(bits, signed, config.mid_scale)
    if config.adc_bits not in (None, scaling.adc_bits):
        raise ConfigError(f"adc_bits is {config.adc_bits}, but the converter of {config.device!r} has {bits}")
    return scaling


def _trigger(iio: Any, context: Any, device: Any, config: IioSourceConfig) -> Any:
    if config.trigger is None:
        return None
    trigger = context.find_device(config.trigger) if config.trigger.isascii() else None
    if not isinstance(trigger, iio.Trigger):
        names = [_name(one) for one in context.devices if isinstance(one, iio.Trigger)]
        raise _missing("trigger", config.trigger, f"in {config.uri}", names)
    device.trigger = trigger
    return trigger


def _set_rate(trigger: Any, device: Any, config: IioSourceConfig) -> None:
    if config.rate_hz is None:
        return
    for one in (trigger, device):
        if one is not None and SAMPLING_FREQUENCY in one.attrs:
            one.attrs[SAMPLING_FREQUENCY].value = str(config.rate_hz)
            return
    raise ConfigError(f"source: rate_hz: neither trigger nor {_name(device)} has a {SAMPLING_FREQUENCY}")


def _choose_clock(device: Any) -> None:
    """A clock that is never set, where there is the choice; the default is the calendar's."""
    if TIMESTAMP_CLOCK in device.attrs:
        with contextlib.suppress(OSError):
            device.attrs[TIMESTAMP_CLOCK].value = "monotonic"


def _name(device: Any) -> str:
    return f"{device.id} ({device.name})" if device.name else str(device.id)


def _missing(key: str, wanted: str, where: str, there: list[str]) -> CanfbError:
    return ConfigError(f"source: {key}: no {wanted!r} {where}; there is {', '.join(there) or 'nothing'}")


def _hint(error: OSError) -> str:
    hints = {
        errno.ENOENT: "; is the driver of a converter loaded?",
        errno.EINVAL: "; is a trigger missing?",
        errno.EBUSY: "; another program captures it",
        errno.EACCES: "; see the permissions of /dev/iio:device*",
    }
    return f"{reason(error)}{hints.get(error.errno or 0, '')}"
