"""A local ADC through Linux IIO as a source."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from canfb.checks import flag, integer_in, number, text
from canfb.sources.iio_capture import IioCapture
from canfb.sources.protocol import Source
from canfb.sources.source_config import SourceConfig
from canfb.sources.surroundings import Surroundings

US = 1e-6


@dataclass(frozen=True, kw_only=True)
class IioSourceConfig(SourceConfig):
    """A local ADC through Linux IIO, captured by the kernel into a buffer.

    device         name, id (iio:device0) or label, as ``iio_info`` has it; required
    sine, cosine   ids or names of the channels
    uri            where libiio finds the device: ``local:``, or ``ip:HOST``
    mid_scale      the reading that means zero, any number of counts; None: the middle of the range, 0 where
                   readings are signed
    trigger        name or id of the trigger that the device is given; one with ``trigger_now`` (sysfs) is
                   fired at each SYNC. None: the device has one, or runs freely
    rate_hz        sampling frequency to set, of the trigger if it has one, else of the device, 1..10000000;
                   None: leave it
    time_stamps    True: the kernel's time of a scan is the sample time (2000:05)
    buffer_scans   length of the kernel's buffer, 2..65536 scans
    wait_us        with a trigger that is fired: how long a SYNC waits for its scan, 10..1000000 µs
    adc_bits       bits of the converter as the configuration states them, 4..16; None: those of the
                   channels. In the YAML this is ``adc_bits`` of the module
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
    buffer_scans: int = 16
    wait_us: int = 1000
    adc_bits: int | None = field(default=None, metadata={"key": False})

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

    @property
    def title(self) -> str:
        """The device."""
        return repr(self.device)

    def of_module(self, keys: Mapping[str, Any]) -> IioSourceConfig:
        """With ``adc_bits`` as the module states them: its default says nothing of this converter."""
        return replace(self, adc_bits=keys.get("adc_bits"))

    def open(self, surroundings: Surroundings) -> Source:
        """The device, captured in a thread. ConfigError or BusError, see :class:`.IioCapture`."""
        return surroundings.captured(lambda: IioCapture(self), f"iio {self.device}", self.wait_us * US)
