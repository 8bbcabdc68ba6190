"""A local ADC through Linux IIO as a source: its keys, properties of the converter, capturing of scans.

Thread and clock are in :class:`canfb.hosting.captured_source.CapturedSource`. If the device lacks something
that is configured, ConfigError names the key.
"""

from __future__ import annotations

import contextlib
import errno
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from canfb.checks import within
from canfb.errors import BusError, CanfbError, ConfigError, reason
from canfb.signal.sample import MOST_PER_SYNC, Sample
from canfb.sources.protocol import (
    LEAST_SCANS_PER_SYNC,
    MOST_SCANS_PER_SYNC,
    EvenScans,
    Source,
    SourceConfig,
    Surroundings,
)

TIMESTAMP = "timestamp"
FIRE = "trigger_now"  # attribute of a sysfs trigger
SAMPLING_FREQUENCY = "sampling_frequency"
TIMESTAMP_CLOCK = "current_timestamp_clock"
MOST_BITS = 16  # size of a track in object 2000h
TIMEOUT_MS = 2000


class ChannelScaling:
    """Converts the readings of a channel to ADC counts of ``adc_bits``, 4..16; a reading at either end of its
    range gives the end of the counts: it is clipped.
    """

    def __init__(self, bits: int, signed: bool, mid_scale: float | None) -> None:
        self.adc_bits = min(bits, MOST_BITS)
        self._lowest = -(1 << bits - 1) if signed else 0
        self._highest = self._lowest + (1 << bits) - 1
        self._mid_scale = float(0 if signed else 1 << bits - 1) if mid_scale is None else mid_scale
        self._divisor = 1 << bits - self.adc_bits
        self._full_scale = 1 << self.adc_bits - 1

    def counts(self, reading: int) -> int:
        full_scale = self._full_scale
        if reading <= self._lowest:
            return -full_scale
        if reading >= self._highest:
            return full_scale - 1
        counts = round((reading - self._mid_scale) / self._divisor)
        return max(-full_scale, min(counts, full_scale - 1))


def last_reading(channel: Any, size: int, signed: bool, buffer: Any) -> int:
    """The newest reading in a buffer; libiio has converted byte order, bits and sign."""
    data = channel.read(buffer)
    if len(data) < size:
        raise OSError(errno.EIO, "the buffer is empty")
    return int.from_bytes(data[-size:], sys.byteorder, signed=signed)


def binding() -> Any:
    """libiio's Python binding. BusError if it is missing or too new."""
    try:
        import iio
    except ImportError:
        raise BusError("source kind iio needs libiio's Python binding: pip install 'canfb[iio]'") from None
    except (AttributeError, OSError):  # raised by the binding if its library is missing
        raise BusError("source kind iio needs the library libiio: apt-get install libiio0") from None
    if iio.version[0] != 0:
        raise BusError(f"source kind iio needs libiio 0.x and pylibiio below 1, not {iio.version[2]}")
    return iio


def find_device(iio: Any, context: Any, key: str, name: str, uri: str) -> Any:
    """The device with this name or id; for the ``key`` "trigger" the trigger."""

    def fits(one: Any) -> bool:
        return isinstance(one, iio.Trigger) == (key == "trigger")

    device = context.find_device(name) if name.isascii() else None
    if device is None or not fits(device):
        raise _missing(key, name, f"in {uri}", [_name(one) for one in context.devices if fits(one)])
    return device


def find_channel(device: Any, key: str, name: str) -> Any:
    """The channel with this name or id, as configured by ``key``; it must be part of the buffer."""
    channel = device.find_channel(name) if name.isascii() else None
    if channel is None or not channel.scan_element:
        names = [one.id for one in device.channels if one.scan_element and not one.output]
        found = "of a buffer " if channel is not None else ""
        raise _missing(key, name, f"as a channel {found}in {_name(device)}", names)
    return channel


def find_timestamp(device: Any) -> Any:
    channel = device.find_channel(TIMESTAMP)
    if channel is None or not channel.scan_element:
        raise ConfigError(f"source: time_stamps: {_name(device)} has no time stamps; set time_stamps: false")
    return channel


def common_scaling(tracks: Mapping[str, Any], mid_scale: float | None) -> ChannelScaling:
    """The scaling of both channels, which must have one format. ``tracks``: the channels by key."""
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


def set_rate(trigger: Any, device: Any, rate_hz: int) -> None:
    """Set the sampling frequency of the trigger (None: no trigger) if it has one, else of the device."""
    for one in (trigger, device):
        if one is not None and SAMPLING_FREQUENCY in one.attrs:
            one.attrs[SAMPLING_FREQUENCY].value = str(rate_hz)
            return
    raise ConfigError(f"source: rate_hz: neither trigger nor {_name(device)} has a {SAMPLING_FREQUENCY}")


def choose_clock(device: Any) -> None:
    """Select the monotonic clock for time stamps if there is the choice; the default is real time."""
    if TIMESTAMP_CLOCK in device.attrs:
        with contextlib.suppress(OSError):
            device.attrs[TIMESTAMP_CLOCK].value = "monotonic"


def hint(error: OSError) -> str:
    """The reason, and what to check."""
    hints = {
        errno.ENOENT: "; is the driver of a converter loaded?",
        errno.EINVAL: "; is a trigger missing?",
        errno.EBUSY: "; another program captures it",
        errno.EACCES: "; see the permissions of /dev/iio:device*",
    }
    return f"{reason(error)}{hints.get(error.errno or 0, '')}"


def _name(device: Any) -> str:
    return f"{device.id} ({device.name})" if device.name else str(device.id)


def _missing(key: str, name: str, where: str, there: list[str]) -> CanfbError:
    return ConfigError(f"source: {key}: no {name!r} {where}; there is {', '.join(there) or 'nothing'}")


NS_PER_100NS = 100


@dataclass(frozen=True, kw_only=True)
class IioSourceConfig(SourceConfig):
    """A local ADC through Linux IIO, captured by the kernel into a buffer.

    device            name, id (iio:device0) or label, as listed by ``iio_info``; required
    sine, cosine      ids or names of the channels
    uri               libiio context: ``local:`` or ``ip:HOST``
    mid_scale         reading of a zero signal, any number of counts; None: mid-range, 0 for signed readings
    trigger           name or id of the trigger to assign to the device; one with ``trigger_now`` (sysfs) is
                      fired at each SYNC. None: the device keeps its own, or runs freely
    rate_hz           sampling frequency to set, 1..10000000, on the trigger if it has one, else on the
                      device; None: unchanged
    time_stamps       True: the kernel's time stamp of the scan is the sample time (2000:05)
    scans_per_sync    2..256 scans in an interval of SYNC, a multiple of samples_per_sync: samples lie on a
                      grid of these scans. None: the newest scan is the sample
    buffer_scans      length of the kernel's buffer, 2..65536 scans
    wait_us           longest wait of a SYNC for the scan that it fired, 10..1000000 µs
    adc_bits          configured bits of the converter, 4..16; None: those of the channels. In the YAML:
                      ``adc_bits`` of the module
    samples_per_sync  1..8 pairs for each SYNC. In the YAML: that of the module
    """

    kind: str = "iio"
    device: str
    sine: str = "voltage0"
    cosine: str = "voltage1"
    uri: str = "local:"
    mid_scale: float | None = None
    trigger: str | None = None
    rate_hz: int | None = None
    time_stamps: bool = True
    scans_per_sync: int | None = None
    buffer_scans: int = 16
    wait_us: int = 1000
    adc_bits: int | None = field(default=None, metadata={"key": False})
    samples_per_sync: int = field(default=1, metadata={"key": False})

    def __post_init__(self) -> None:
        super().__post_init__()
        within(
            self,
            device=str,
            sine=str,
            cosine=str,
            uri=str,
            trigger=str,
            mid_scale=float,
            time_stamps=bool,
            rate_hz=(1, 10_000_000),
            buffer_scans=(2, 65536),
            wait_us=(10, 1_000_000),
            adc_bits=(4, 16),
            scans_per_sync=(LEAST_SCANS_PER_SYNC, MOST_SCANS_PER_SYNC),
            samples_per_sync=(1, MOST_PER_SYNC),
        )
        if not self.uri.isascii():
            raise ValueError(f"uri must be such as local: or ip:192.168.2.1, not {self.uri!r}")
        if self.sine == self.cosine:
            raise ValueError(f"cosine must differ from sine, {self.sine!r}")
        scans, samples = self.scans_per_sync, self.samples_per_sync
        if samples > 1 and (scans is None or scans % samples):
            raise ValueError(
                f"samples_per_sync: {samples} need scans_per_sync in source, a multiple of it, not {scans}"
            )
        if scans is not None and not self.time_stamps:
            raise ValueError("scans_per_sync needs time_stamps: true")

    @property
    def title(self) -> str:
        return repr(self.device)

    def of_module(self, keys: Mapping[str, Any]) -> IioSourceConfig:
        """With ``adc_bits`` only if the module configures them: the default says nothing of the converter."""
        return replace(self, adc_bits=keys.get("adc_bits"), samples_per_sync=keys.get("samples_per_sync", 1))

    def open(self, surroundings: Surroundings) -> Source:
        scans = self.scans_per_sync
        picked = None if scans is None else EvenScans(self.samples_per_sync, scans)
        return surroundings.captured(
            lambda: IioCapture(self), f"iio {self.device}", self.wait_us * 1e-6, picked
        )


class IioCapture:
    """An open device; the kernel buffers both channels. ConfigError, with the key, or BusError."""

    def __init__(self, config: IioSourceConfig) -> None:
        iio, where = binding(), f"IIO context {config.uri!r}"
        try:
            self._context = iio.Context(config.uri)
            self._context.set_timeout(TIMEOUT_MS)
            where = f"IIO device {config.device!r} of {config.uri}"
            self._open(iio, config)
        except OSError as error:
            raise BusError(f"{where}: {hint(error)}") from error

    def _open(self, iio: Any, config: IioSourceConfig) -> None:
        device = self._device = find_device(iio, self._context, "device", config.device, config.uri)
        tracks = {
            key: find_channel(device, key, name)
            for key, name in (("sine", config.sine), ("cosine", config.cosine))
        }
        channels = list(tracks.values())
        if config.time_stamps:
            channels.append(find_timestamp(device))
        self._scaling = common_scaling(tracks, config.mid_scale)
        if config.adc_bits not in (None, self.adc_bits):
            bits = tracks["sine"].data_format.bits
            raise ConfigError(
                f"adc_bits is {config.adc_bits}, but the converter of {config.device!r} has {bits}"
            )
        self._trigger = None
        if config.trigger is not None:
            self._trigger = find_device(iio, self._context, "trigger", config.trigger, config.uri)
            device.trigger = self._trigger
        if config.scans_per_sync is not None and self.is_fired:
            raise ConfigError(
                f"source: trigger: {config.trigger!r} is fired once for each SYNC; scans_per_sync needs one "
                "that has a clock"
            )
        if config.rate_hz is not None:
            set_rate(self._trigger, device, config.rate_hz)
        choose_clock(device)
        for channel in device.channels:
            channel.enabled = False
        for channel in channels:
            channel.enabled = True
        formats = [(channel, channel.data_format) for channel in channels]
        self._channels = [(one, form.length // 8, bool(form.is_signed)) for one, form in formats]
        device.set_kernel_buffers_count(config.buffer_scans)
        self._buffer = iio.Buffer(device, 1)
        self._taken_ns: int | None = None  # time stamp of the last scan

    @property
    def adc_bits(self) -> int:
        return self._scaling.adc_bits

    @property
    def is_fired(self) -> bool:
        return self._trigger is not None and FIRE in self._trigger.attrs

    def fire(self) -> None:
        assert self._trigger is not None
        self._trigger.attrs[FIRE].value = "1"

    def refill(self) -> Sample | None:
        try:
            self._buffer.refill()
        except OSError as error:
            if error.errno == errno.ETIMEDOUT:
                return None
            raise
        values = [last_reading(*channel, self._buffer) for channel in self._channels]
        counts = self._scaling.counts
        if len(values) < 3:
            return Sample(counts(values[0]), counts(values[1]))
        before, self._taken_ns = self._taken_ns, values[2]
        invalid = before is not None and values[2] <= before
        time = values[2] // NS_PER_100NS & 0xFFFFFFFF
        return Sample(counts(values[0]), counts(values[1]), invalid=invalid, time_100ns=time)

    def cancel(self) -> None:
        self._buffer.cancel()
