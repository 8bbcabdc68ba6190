"""``source:`` of a module in the configuration: where its samples come from, if not from the ADC PDO."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from canfb.signal.config import integer_in


@dataclass(frozen=True, kw_only=True)
class RecordingSourceConfig:
    """A recording, one row for each SYNC.

    file           CSV with a header line, or NPZ as ``canfb calibrate --out`` writes it; required
    columns        names, or numbers from 0, of the sine and the cosine column of a CSV file
    mid_scale      the reading that means zero, subtracted from both (CSV)
    time_column    column with seconds (CSV): a longer step than ``gap_s`` is a gap; None: there is none
    gap_s          seconds, more than 0
    gap_samples    samples missed at each gap, 1..1000000
    time_stamps    True: the time column is the sample time (2000:05), too
    """

    kind: str = "recording"
    file: str
    columns: Sequence[str | int] = ("sine", "cosine")
    mid_scale: float = 0.0
    time_column: str | int | None = None
    gap_s: float = 0.1
    gap_samples: int = 20
    time_stamps: bool = False

    def __post_init__(self) -> None:
        _kind(self.kind, "recording")
        _text("file", self.file)
        if not isinstance(self.columns, Sequence) or isinstance(self.columns, str) or len(self.columns) != 2:
            raise ValueError(f"columns must be two, [sine, cosine], not {self.columns!r}")
        for name in self.columns:
            _column("columns", name)
        _number("mid_scale", self.mid_scale)
        if self.time_column is not None:
            _column("time_column", self.time_column)
        _number("gap_s", self.gap_s)
        if self.gap_s <= 0.0:
            raise ValueError(f"gap_s must be more than 0, not {self.gap_s!r}")
        integer_in("gap_samples", self.gap_samples, 1, 1_000_000)
        _flag("time_stamps", self.time_stamps)
        if self.time_stamps and self.time_column is None:
            raise ValueError("time_stamps need a time_column")


@dataclass(frozen=True, kw_only=True)
class MotionSourceConfig:
    """The machine of the ``simulation:`` section; a sample is 1/``rate_hz`` (0.1..100000) after the last."""

    kind: str = "motion"
    rate_hz: float = 1000.0

    def __post_init__(self) -> None:
        _kind(self.kind, "motion")
        _number("rate_hz", self.rate_hz)
        if not 0.1 <= self.rate_hz <= 100_000:
            raise ValueError(f"rate_hz must be a number 0.1..100000, not {self.rate_hz!r}")


@dataclass(frozen=True, kw_only=True)
class IioSourceConfig:
    """A local ADC through Linux IIO, captured by the kernel into a buffer.

    device         name, id (iio:device0) or label, as ``iio_info`` has it; required
    sine, cosine   ids or names of the channels
    uri            where libiio finds the device: ``local:``, or ``ip:HOST``
    mid_scale      the reading that means zero; None: the middle of the range, 0 where readings are signed
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
        _kind(self.kind, "iio")
        for name in ("device", "sine", "cosine", "uri", *(["trigger"] if self.trigger is not None else [])):
            _text(name, getattr(self, name))
        if not self.uri.isascii():
            raise ValueError(f"uri must be such as local: or ip:192.168.2.1, not {self.uri!r}")
        if self.sine == self.cosine:
            raise ValueError(f"cosine must be another channel than sine, {self.sine!r}")
        if self.mid_scale is not None:
            _number("mid_scale", self.mid_scale)
        if self.rate_hz is not None:
            integer_in("rate_hz", self.rate_hz, 1, 10_000_000)
        _flag("time_stamps", self.time_stamps)
        integer_in("buffer_scans", self.buffer_scans, 2, 65536)
        integer_in("wait_us", self.wait_us, 10, 1_000_000)
        if self.adc_bits is not None:
            integer_in("adc_bits", self.adc_bits, 4, 16)


SourceConfig = RecordingSourceConfig | MotionSourceConfig | IioSourceConfig
SOURCE_KINDS: dict[str, type[SourceConfig]] = {
    "recording": RecordingSourceConfig,
    "motion": MotionSourceConfig,
    "iio": IioSourceConfig,
}


def _kind(kind: str, wanted: str) -> None:
    if kind != wanted:
        raise ValueError(f"kind must be {wanted} here, not {kind!r}")


def _text(name: str, value: object) -> None:
    if not isinstance(value, str) or not value.strip() or "\0" in value:
        raise ValueError(f"{name} must be a text, not {value!r}")


def _column(name: str, value: object) -> None:
    if isinstance(value, bool) or not isinstance(value, (str, int)) or value == "":
        raise ValueError(f"{name} must be a name or a number from 0, not {value!r}")


def _number(name: str, value: object) -> None:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise ValueError(f"{name} must be a number, not {value!r}")


def _flag(name: str, value: object) -> None:
    if not isinstance(value, bool):
        raise ValueError(f"{name} must be true or false, not {value!r}")
