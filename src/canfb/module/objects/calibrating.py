"""Object 2030h: a reference measurement from the module's own samples, while it publishes.

IDLE ──start──> RECORDING ──full, or finish──> COMPUTING ──> READY ──accept──> ACCEPTED
                                                        └──> REFUSED, CHECKED
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

from canfb import objects as od
from canfb.calibration.ellipse import without_harmonics
from canfb.calibration.methods import calibrate_from_motion
from canfb.calibration.over_speeds import counts_at, tracks_of_job
from canfb.calibration.recording import NO_TIME
from canfb.calibration.result import BINS, Calibration, Drift, Reason, covered, drift
from canfb.calibration.solver import no_progress
from canfb.cia301.codes import AbortCode, SdoAbort
from canfb.device.od.dictionary import Dictionary, refuse_if
from canfb.errors import CalibrationError
from canfb.module.objects.recorder import SampleObservers
from canfb.module.objects.table_store import TableStore
from canfb.objects import MeasurementCommand as Command, MeasurementState as State
from canfb.signal.chain import SignalChain
from canfb.signal.correction import Correction
from canfb.signal.front_end import Corners
from canfb.signal.sample import TICKS, Feedback, Sample
from canfb.signal.sample_recording import SampleRecording
from canfb.signal.supervision import AMPLITUDE, CLIPPED, FROZEN, LOST, RESIDUAL


class Outcome(NamedTuple):
    """Result of a job; the ``calibration`` of a refused measurement is for diagnosis only."""

    reason: Reason
    calibration: Calibration | None
    text: str


@dataclass(frozen=True, eq=False)
class CalibrationJob:
    """A table from samples takes seconds to compute: a host calls this, perhaps in another process.

    samples     in the format of 2050:03
    times       in 100 ns, rising, INTEGER64, NO_TIME for none; None: one sample per interval
    adc_bits    4..16
    turned      angle from the sine of each sample to its cosine, rad, REAL32; None: 0, sampled at once
    delays_s    2002:06 and 2002:07, which are kept: one speed does not determine them
    at_speed    the analog path has an effect at the speed of the samples
    """

    samples: bytes
    times: bytes | None
    adc_bits: int
    turned: bytes | None = None
    delays_s: tuple[float, float] = (0.0, 0.0)
    at_speed: bool = False

    def __call__(self, progress: Callable[[float], None] = no_progress) -> Outcome:
        try:
            sine, cosine, time_s = tracks_of_job(self.samples, self.times, self.turned, self.adc_bits)
            found = calibrate_from_motion(
                sine, cosine, "fit", time_s=time_s, adc_bits=self.adc_bits, progress=progress
            )
        except CalibrationError as error:
            return Outcome(Reason(error.reason), error.calibration, str(error))
        between_s, common_s = self.delays_s
        kept = replace(found.conditioning, cosine_delay_s=between_s, delay_s=common_s)
        found = replace(found, conditioning=without_harmonics(kept) if self.at_speed else kept)
        return Outcome(Reason.ACCEPTED, found, found.verdict)


RECORDING_PART = 80.0  # per cent of the progress for the recording; the rest is for the computation
COMPUTING_PART = 99.0
UNKNOWN = Drift(math.nan, math.nan)
AT_WORK = frozenset({State.RECORDING, State.COMPUTING})


class Calibrating:
    """Only a master puts the result in force. ``working`` sets bit 10 of the status word.

    ``job`` is to be computed: the same object until it is done or obsolete.
    """

    def __init__(
        self,
        dictionary: Dictionary,
        chain: SignalChain,
        tables: TableStore,
        observers: SampleObservers,
        working: Callable[[bool], None],
    ) -> None:
        self._chain, self._tables = chain, tables
        self._observers, self._working = observers, working
        self._requested = dictionary.entry(*od.MEASUREMENT_SAMPLES)
        self._full_scale = dictionary.entry(*od.ENCODER_FULL_SCALE)
        self._corners = [
            dictionary.entry(*corner)
            for corner in (od.ENCODER_CORNER_FREQUENCY, od.ENCODER_COSINE_CORNER_FREQUENCY)
        ]
        self._commands: dict[int, Callable[[], None]] = {
            Command.START: lambda: self._start(Command.START),
            Command.STOP: self.reset,
            Command.ACCEPT: self._accept,
            Command.CHECK: lambda: self._start(Command.CHECK),
            Command.FINISH: self._finish,
        }
        self.reset()
        command = dictionary.entry(*od.MEASUREMENT_COMMAND)
        command.on_check = refuse_if(lambda value: value not in self._commands)
        command.on_written = lambda: self._commands[command.value]()
        dictionary.read_live(
            {
                od.MEASUREMENT_COMMAND: lambda: int(self._task) if self.state in AT_WORK else 0,
                od.MEASUREMENT_STATE: lambda: int(self.state),
                od.MEASUREMENT_PROGRESS: self._progress,
                od.MEASUREMENT_COVERAGE: self._coverage,
                od.MEASUREMENT_RESIDUAL_RMS: lambda: self._figure("residual_rms"),
                od.MEASUREMENT_RESIDUAL_PEAK: lambda: self._figure("residual_peak"),
                od.MEASUREMENT_REASON: lambda: self._reason.number,
                od.MEASUREMENT_DRIFT_RMS: lambda: self._drift().rms,
                od.MEASUREMENT_DRIFT_PEAK: lambda: self._drift().peak,
            }
        )

    def _forget(self, capacity: int) -> None:
        self._samples = SampleRecording(capacity)
        self._times = array("q")
        self._turned = array("f")  # angle from each sine to its cosine, rad
        self._fastest_hz = 0.0  # fastest sample, cycles per second
        self._timed = True
        self._last_tick: int | None = None
        self._bins: list[int] = [0] * BINS
        self._part = 0.0
        self.job: CalibrationJob | None = None
        self._calibration: Calibration | None = None
        self._reason: Reason = Reason.ACCEPTED
        self._compared: tuple[Correction, Drift] | None = None

    def reset(self) -> None:
        self._task = Command.START
        self._forget(1)
        self._enter(State.IDLE)

    def interrupted(self) -> None:
        if self.state is State.RECORDING:
            self._refuse(Reason.INTERRUPTED)

    def finish(self, job: CalibrationJob, result: Outcome | Exception) -> None:
        if not isinstance(result, (Outcome, Exception)):
            raise TypeError(f"pass what the job returned, or the Exception that it raised, not {result!r}")
        if job is not self.job:
            return
        if not isinstance(result, Outcome):
            result = Outcome(Reason.FAILED, None, str(result))
        self._calibration = result.calibration
        if result.reason == Reason.ACCEPTED:
            self._enter(State.CHECKED if self._task is Command.CHECK else State.READY)
        else:
            self._refuse(result.reason)

    def computed(self, job: CalibrationJob, part: float) -> None:
        if job is self.job:
            self._part = min(max(part, 0.0), 1.0)

    def take(self, sample: Sample, feedback: Feedback) -> None:
        """Record a sample; a flagged one, or one with the time of the last, is left out."""
        status = feedback.status
        is_new = self._add_time(sample.time_100ns)
        tracks = self._chain.tracks
        turned = tracks.turned_rad(feedback.speed_cycles)
        self._fastest_hz = max(self._fastest_hz, abs(tracks.hertz(feedback.speed_cycles)))
        self._turned.append(turned)
        left_out = sample.invalid or not is_new or _left_out(status)
        if left_out or (turned and status & LOST):  # `turned` needs the speed
            self._samples.miss()
        else:
            self._samples.take(self._held(sample.sine), self._held(sample.cosine))
            if feedback.raw_phase == feedback.raw_phase:
                self._bins[int(feedback.raw_phase * BINS) % BINS] += 1
        self._complete()

    def miss(self) -> None:
        self._times.append(NO_TIME)
        self._turned.append(0.0)
        self._samples.miss()
        self._complete()

    def _start(self, task: Command) -> None:
        self._task = task
        self._forget(self._requested.value)
        bits = (self._full_scale.value - 1).bit_length() + 1
        self._adc_bits = min(max(bits, 4), 16)
        # If the range of the converter is not a power of two, its ends are stored as those of the next one.
        self._lowest, self._highest = 1 - self._full_scale.value, self._full_scale.value - 2
        self._enter(State.RECORDING)

    def _finish(self) -> None:
        if self.state is not State.RECORDING:
            raise SdoAbort(AbortCode.DEVICE_STATE)
        self._compute()

    def _accept(self) -> None:
        if self.state is not State.READY or self._calibration is None:
            raise SdoAbort(AbortCode.DEVICE_STATE)
        self._tables.take_over(self._calibration.correction)
        self._enter(State.ACCEPTED)

    def _enter(self, state: State) -> None:
        self.state = state
        if state is State.RECORDING:
            self._observers.add(self)
        else:
            self._observers.remove(self)
        if state is not State.COMPUTING:
            self.job = None
        self._working(state in AT_WORK)

    def _refuse(self, reason: str) -> None:
        self._reason = Reason(reason)
        self._enter(State.REFUSED)

    def _complete(self) -> None:
        if self._samples.is_full:
            self._compute()

    def _compute(self) -> None:
        times = self._times.tobytes() if self._timed and len(self._times) else None
        active = self._chain.correction.conditioning
        turned = self._turned.tobytes() if active.cosine_delay_s else None
        delays_s = active.cosine_delay_s, active.delay_s
        corners = Corners(*(corner.value for corner in self._corners))
        at_speed = counts_at(self._fastest_hz, active.cosine_delay_s, corners)
        self.job = CalibrationJob(self._samples.to_bytes(), times, self._adc_bits, turned, delays_s, at_speed)
        self._enter(State.COMPUTING)

    def _add_time(self, time_100ns: int | None) -> bool:
        """Note a time, unwrapped; False: it is that of the last sample. Used only if all samples have one."""
        self._timed &= time_100ns is not None
        if time_100ns is None:
            self._times.append(NO_TIME)
            return True
        last = self._last_tick
        self._last_tick = time_100ns if last is None else last + (time_100ns - last) % TICKS
        is_new = self._last_tick != last
        self._times.append(self._last_tick if is_new else NO_TIME)
        return is_new

    def _held(self, counts: float) -> int:
        """``counts`` as recorded: at or beyond an end of the converter, the end of its bits."""
        if self._lowest <= counts <= self._highest:
            return int(counts)
        full: int = 1 << (self._adc_bits - 1)
        return -full if counts < 0 else full - 1

    def _progress(self) -> int:
        parts = {
            State.IDLE: 0.0,
            State.RECORDING: RECORDING_PART * len(self._samples) / self._samples.capacity,
            State.COMPUTING: RECORDING_PART + (COMPUTING_PART - RECORDING_PART) * self._part,
        }
        return int(parts.get(self.state, 100.0))

    def _coverage(self) -> int:
        found = self._calibration
        return int(100.0 * (covered(self._bins) if found is None else found.coverage))

    def _figure(self, name: str) -> float:
        """A figure of the calibration, cycles; NaN while there is none."""
        return math.nan if self._calibration is None else float(getattr(self._calibration, name))

    def _drift(self) -> Drift:
        if self._calibration is None or self._reason != Reason.ACCEPTED:
            return UNKNOWN
        active, known = self._chain.correction, self._compared
        if known is None or known[0] is not active:
            found = drift(self._calibration, active.table, active.conditioning)
            known = self._compared = (active, found)
        return known[1]


def _left_out(status: int) -> bool:
    """True for a sample with a fault, except clipping: tracks that are too large must be detected.

    The residual of a lost position is no fault.
    """
    flagged = status & (AMPLITUDE | FROZEN) or status & (RESIDUAL | LOST) == RESIDUAL
    return bool(flagged and not status & CLIPPED)
