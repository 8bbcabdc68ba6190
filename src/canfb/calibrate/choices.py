"""The options of ``canfb calibrate``, checked, and what follows from them."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from pathlib import Path

from canfb.calibrate.measurement import ESTIMATE, MOTION, ZERO_CROSSINGS, Settings, SpeedSamples
from canfb.errors import ConfigError
from canfb.master.samples import TrackSamples, read_npz
from canfb.signal.conditioning import LONGEST_DELAY_S
from canfb.signal.supervision import SampleLimits
from canfb.sources.recording_source import RecordingLayout, chosen_layout, open_recording
from canfb.sources.sample_files import read_tracks

PDO, RECORDING, MODULE, INTERFACE = "pdo", "recording", "module", "interface"
MOST_RPM = 1e6
RECORDED = "recorded"  # value of --speeds: take the speeds from the files of samples
LEAST_SAMPLES, LEAST_FRESH = 8000, 1500
SECONDS_AT_SPEED = 10.0
OF_THE_MODULE = MOTION, "fit", 1024  # method, conditioning and entries of a measurement by the module
NEAREST = 1.05  # smallest ratio of two speeds, so that the present one can be identified
OF_CSV = ("columns", "mid_scale", "scale", "time_column")
WITHOUT_BUS = "not with --samples, which needs no bus and writes to no module"
# Options that have no effect with another option (False), or without it (True), are refused. Durations are
# accepted: a script may pass the same ones to a dry run and to the measurement after it.
IDLE = (
    (
        (
            "config",
            "nodes",
            "encoder_interface",
            "source",
            "recorder",
            "seconds",
            "least_samples",
            "verify",
            "rate",
            "timeout",
            "dry_run",
            "save",
            "wait",
        ),
        "samples",
        False,
        WITHOUT_BUS,
    ),
    (("table",), "samples", True, "only with --samples; over the bus the table is read from the module"),
    ((*OF_CSV, "cycles_per_revolution"), "samples", True, "only with --samples, which it describes"),
    (("dry_run", "save"), "check", False, "not with --check, which writes nothing"),
    (("save",), "dry_run", False, "not with --dry-run, which writes nothing"),
    (("delay", "wait"), "speeds", True, "only with --speeds"),
    (
        ("check", "method", "source", "conditioning"),
        "speeds",
        False,
        "not with --speeds, which measures by motion",
    ),
)


@dataclass(frozen=True, kw_only=True)
class CalibrateOptions:
    """The options by name; None: not given. ConfigError for invalid ones."""

    dry_run: bool = False
    check: bool = False
    out: Path | None = None
    save: bool = False
    method: str = MOTION
    source: str | None = None
    recorder: str = INTERFACE
    seconds: float | None = None
    least_samples: int = LEAST_SAMPLES
    verify: float | None = None
    conditioning: str = "fit"
    entries: int = 1024
    adc_bits: int | None = None
    sample_rate: float | None = None
    encoder: str = ""
    samples: Path | None = None
    columns: str = "sine,cosine"
    mid_scale: float = 0.0
    scale: float = 1.0
    time_column: str | None = None
    table: Path | None = None
    cycles_per_revolution: int | None = None
    speeds: str | None = None
    delay: str | None = None
    wait: float = 120.0
    line: str = ""  # the command line, for the report

    @property
    def samples_from(self) -> str:
        """Where samples come from: "pdo", "recording" or "module"."""
        return self.source or (RECORDING if self.method == ZERO_CROSSINGS else PDO)

    @property
    def collect_s(self) -> float:
        usual = SECONDS_AT_SPEED if self.speeds else 4.0 if self._is_fast else 20.0
        return usual if self.seconds is None else self.seconds

    @property
    def collecting(self) -> str:
        return f"{self.collect_s:g} s of samples, at least {self.least_samples}"

    @property
    def verify_s(self) -> float:
        return self.verify if self.verify is not None else (1.0 if self._is_fast else 4.0)

    @property
    def least_fresh(self) -> int:
        return min(self.least_samples, LEAST_FRESH)

    @property
    def speeds_rpm(self) -> tuple[float, ...]:
        """The speeds of ``--speeds``; none for :data:`RECORDED`. ConfigError if it is not a list."""
        if self.speeds is None or (self.speeds == RECORDED and self.samples is not None):
            return ()
        try:
            found = tuple(float(word) for word in self.speeds.split(","))
        except ValueError:
            found = ()
        sizes = sorted(found)
        apart = all(b > NEAREST * a if a > 0.0 else b > a / NEAREST for a, b in itertools.pairwise(sizes))
        if len(found) < 2 or not all(0.0 < abs(one) < MOST_RPM for one in found) or not apart:
            raise ConfigError(
                f"--speeds {self.speeds}: two or more different speeds in rpm are required: 61,300,1000,3000"
            )
        return found

    @property
    def delay_to_set(self) -> str | float | None:
        """2002:07 in seconds, :data:`.ESTIMATE`, None: unchanged. ConfigError for anything else."""
        if self.delay is None or self.delay == ESTIMATE:
            return self.delay
        try:
            value = float(self.delay)
        except ValueError:
            value = math.nan
        if not abs(value) <= LONGEST_DELAY_S:
            raise ConfigError(
                f"--delay {self.delay}: seconds, at most {LONGEST_DELAY_S:g}, or {ESTIMATE}, are required"
            )
        return value

    @property
    def _is_fast(self) -> bool:
        return self.samples_from == RECORDING and self.recorder == INTERFACE

    @property
    def _layout(self) -> RecordingLayout:
        return chosen_layout(self.columns, self.mid_scale, self.scale, self.time_column)

    def __post_init__(self) -> None:
        _ = self._layout, self.speeds_rpm, self.delay_to_set
        if self.recorder != INTERFACE and self.samples_from != RECORDING:
            raise ConfigError("--recorder: only with --source recording")
        if self.samples_from == MODULE and (self.method, self.conditioning, self.entries) != OF_THE_MODULE:
            raise ConfigError(
                "--source module: it supports --method motion, --conditioning fit, --entries 1024 only"
            )

    def settings(self, limits: SampleLimits | None) -> Settings:
        """Settings of the calibration; the ADC bits are those of the module, unless given."""
        bits = self.adc_bits
        if bits is None and limits is not None and limits.full_scale_counts.bit_count() == 1:
            bits = limits.full_scale_counts.bit_length()
        return Settings(self.method, "fit" if self.conditioning == "fit" else None, self.entries, bits)

    def samples_of_file(self, path: Path) -> TrackSamples:
        """Samples of ``--samples``. CanfbError, with file and line, for an unusable file."""
        if path.suffix.lower() == ".npz":
            found = read_npz(path)
            return replace(found, rate_hz=self.sample_rate or found.rate_hz)
        recording = open_recording(path, self._layout)
        return TrackSamples.of(*recording.tracks, self.sample_rate, f"file {path.name}{recording.note}")

    def samples_of_folder(self, folder: Path) -> list[SpeedSamples]:
        """The files of a folder in the order of names, with their speeds, given or recorded.

        CanfbError for unusable files.
        """
        files = sorted(one for one in folder.glob("*") if one.suffix.lower() in (".npz", ".csv"))
        if not folder.is_dir() or len(files) < 2:
            raise ConfigError(f"--samples {folder}: with --speeds a folder with a file for each speed")
        rpm, per_turn = self.speeds_rpm, self.cycles_per_revolution
        if self.speeds == RECORDED:
            known = [read_tracks(one).cycles_per_s if one.suffix.lower() == ".npz" else None for one in files]
        elif len(rpm) != len(files) or per_turn is None:
            raise ConfigError(
                f"--speeds {self.speeds}: {len(files)} speeds are required, one for each file of {folder} "
                "in the order of their names, and --cycles-per-revolution"
            )
        else:
            known = [one / 60.0 * per_turn for one in rpm]
        found = []
        for path, hertz in zip(files, known, strict=True):
            if hertz is None:
                raise ConfigError(f"{path}: no speed is recorded (cycles_per_s): --speeds RPM,RPM,...")
            found.append(SpeedSamples(self.samples_of_file(path), hertz))
        return found
