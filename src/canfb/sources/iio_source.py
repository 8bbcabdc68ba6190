"""A local ADC through Linux IIO as a source: its keys, and an open device that captures scan after scan.

Nothing here has a thread or a clock; :class:`canfb.hosting.captured_source.CapturedSource` waits for the
scans. One sample for each SYNC is the newest scan; ``scans_per_sync`` makes it one of an even grid, and
several of them (:mod:`canfb.sources.even_scans`).
"""

from __future__ import annotations

import errno
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from canfb.checks import flag, integer_in, number, text
from canfb.errors import BusError, ConfigError
from canfb.signal.sample import Sample
from canfb.signal.subsamples import MOST_PER_SYNC
from canfb.sources import iio_device
from canfb.sources.even_scans import LEAST_SCANS_PER_SYNC, MOST_SCANS_PER_SYNC, EvenScans
from canfb.sources.protocol import Source
from canfb.sources.source_config import SourceConfig
from canfb.sources.surroundings import Surroundings

US = 1e-6
NS_PER_100NS = 100


@dataclass(frozen=True, kw_only=True)
class IioSourceConfig(SourceConfig):
    """A local ADC through Linux IIO, captured by the kernel into a buffer.

    device            name, id (iio:device0) or label, as ``iio_info`` has it; required
    sine, cosine      ids or names of the channels
    uri               where libiio finds the device: ``local:``, or ``ip:HOST``
    mid_scale         the reading that means zero, any number of counts; None: the middle of the range, 0
                      where readings are signed
    trigger           name or id of the trigger that the device is given; one with ``trigger_now`` (sysfs)
                      is fired at each SYNC. None: the device has one, or runs freely
    rate_hz           sampling frequency to set, of the trigger if it has one, else of the device,
                      1..10000000; None: leave it
    time_stamps       True: the kernel's time of a scan is the sample time (2000:05)
    scans_per_sync    2..256 scans of the converter in an interval of SYNC, a multiple of samples_per_sync:
                      the samples lie on a grid of these scans. None: the newest scan is the sample
    buffer_scans      length of the kernel's buffer, 2..65536 scans
    wait_us           with a trigger that is fired: how long a SYNC waits for its scan, 10..1000000 µs
    adc_bits          bits of the converter as the configuration states them, 4..16; None: those of the
                      channels. In the YAML this is ``adc_bits`` of the module
    samples_per_sync  1..4 pairs for each SYNC. In the YAML this is that of the module
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
        for name in ("device", "sine", "cosine", "uri", *(["trigger"] if self.trigger is not None else [])):
            text(name, getattr(self, name))
        if not self.uri.isascii():
            raise ValueError(f"uri must be such as local: or ip:192.168.2.1, not {self.uri!r}")
        if self.sine == self.cosine:
            raise ValueError(f"cosine must differ from sine, {self.sine!r}")
        if self.mid_scale is not None:
            number("mid_scale", self.mid_scale)
        if self.rate_hz is not None:
            integer_in("rate_hz", self.rate_hz, 1, 10_000_000)
        flag("time_stamps", self.time_stamps)
        integer_in("buffer_scans", self.buffer_scans, 2, 65536)
        integer_in("wait_us", self.wait_us, 10, 1_000_000)
        if self.adc_bits is not None:
            integer_in("adc_bits", self.adc_bits, 4, 16)
        if self.scans_per_sync is not None:
            integer_in("scans_per_sync", self.scans_per_sync, LEAST_SCANS_PER_SYNC, MOST_SCANS_PER_SYNC)
        self._check_samples_per_sync()

    def _check_samples_per_sync(self) -> None:
        integer_in("samples_per_sync", self.samples_per_sync, 1, MOST_PER_SYNC)
        scans, samples = self.scans_per_sync, self.samples_per_sync
        if samples > 1 and (scans is None or scans % samples):
            raise ValueError(
                f"samples_per_sync: {samples} need scans_per_sync in source, a multiple of it, not {scans}"
            )
        if scans is not None and not self.time_stamps:
            raise ValueError("scans_per_sync needs time_stamps: true")

    @property
    def title(self) -> str:
        """The device."""
        return repr(self.device)

    def of_module(self, keys: Mapping[str, Any]) -> IioSourceConfig:
        """With ``adc_bits`` as the module states them: its default says nothing of this converter."""
        return replace(self, adc_bits=keys.get("adc_bits"), samples_per_sync=keys.get("samples_per_sync", 1))

    def open(self, surroundings: Surroundings) -> Source:
        """The device, captured in a thread. ConfigError or BusError, see :class:`.IioCapture`."""
        scans = self.scans_per_sync
        picked = None if scans is None else EvenScans(self.samples_per_sync, scans)
        return surroundings.captured(
            lambda: IioCapture(self), f"iio {self.device}", self.wait_us * US, picked
        )


class IioCapture:
    """A :class:`canfb.sources.surroundings.Capture`: an open device, whose kernel buffers both channels.

    ConfigError, which names the key, for what the device does not have; BusError for what does not
    work. :meth:`refill` may be called in another thread than :meth:`fire` and :meth:`cancel`.
    """

    def __init__(self, config: IioSourceConfig) -> None:
        iio = iio_device.binding()
        self._context = iio_device.open_context(iio, config.uri)
        try:
            self._open(iio, config)
        except OSError as error:
            where = f"IIO device {config.device!r} of {config.uri}"
            raise BusError(f"{where}: {iio_device.hint(error)}") from error

    def _open(self, iio: Any, config: IioSourceConfig) -> None:
        device = self._device = iio_device.find_device(iio, self._context, config.device, config.uri)
        tracks = {
            key: iio_device.find_channel(device, key, wanted)
            for key, wanted in (("sine", config.sine), ("cosine", config.cosine))
        }
        channels = list(tracks.values())
        if config.time_stamps:
            channels.append(iio_device.find_timestamp(device))
        self._scaling = iio_device.common_scaling(tracks, config.mid_scale)
        if config.adc_bits not in (None, self.adc_bits):
            bits = tracks["sine"].data_format.bits
            raise ConfigError(
                f"adc_bits is {config.adc_bits}, but the converter of {config.device!r} has {bits}"
            )
        self._trigger = None
        if config.trigger is not None:
            self._trigger = iio_device.give_trigger(iio, self._context, device, config.trigger, config.uri)
        if config.scans_per_sync is not None and self.is_fired:
            raise ConfigError(
                f"source: trigger: {config.trigger!r} gives one scan for each SYNC; scans_per_sync needs one "
                "that has a clock"
            )
        if config.rate_hz is not None:
            iio_device.set_rate(self._trigger, device, config.rate_hz)
        iio_device.choose_clock(device)
        for channel in device.channels:
            channel.enabled = False
        self._channels = [iio_device.ChannelValues(channel) for channel in channels]
        device.set_kernel_buffers_count(config.buffer_scans)
        self._buffer = iio.Buffer(device, 1)
        self._taken_ns: int | None = None  # time of the last scan

    @property
    def adc_bits(self) -> int:
        """Bits of a count, 4..16."""
        return self._scaling.adc_bits

    @property
    def is_fired(self) -> bool:
        """The trigger waits for :meth:`fire`."""
        return self._trigger is not None and iio_device.FIRE in self._trigger.attrs

    def fire(self) -> None:
        """Have one scan taken. OSError if that fails."""
        assert self._trigger is not None
        self._trigger.attrs[iio_device.FIRE].value = "1"

    def refill(self) -> Sample | None:
        """Wait for the next scan; None if there was none for two seconds. OSError when capturing ends.

        A scan that is not later than the one before, because its clock was set, is invalid.
        """
        try:
            self._buffer.refill()
        except OSError as error:
            if error.errno == errno.ETIMEDOUT:
                return None
            raise
        values = [channel.last(self._buffer) for channel in self._channels]
        counts = self._scaling.counts
        if len(values) < 3:
            return Sample(counts(values[0]), counts(values[1]))
        before, self._taken_ns = self._taken_ns, values[2]
        invalid = before is not None and values[2] <= before
        time = values[2] // NS_PER_100NS & 0xFFFFFFFF
        return Sample(counts(values[0]), counts(values[1]), invalid=invalid, time_100ns=time)

    def cancel(self) -> None:
        """Let :meth:`refill` end with an OSError, now and ever after."""
        self._buffer.cancel()
