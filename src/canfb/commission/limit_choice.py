"""Limits of the supervision from samples of a machine in its duty cycle, followed by the chain of the module.

The samples determine the speed modulo one cycle per interval; the speeds that the module reports (2011:07)
resolve it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from canfb import objects as od
from canfb.calibrate.measurement import SupervisedSamples, supervise
from canfb.calibration.deviation import phases_with
from canfb.calibration.path_fit import LowPass
from canfb.calibration.recording import positions
from canfb.calibration.result import MOST_CHANGE_CYCLES, about_mean, changed, robust_rms
from canfb.commission.machine_figures import (
    TELLING_CYCLES,
    MotionFigures,
    Observation,
    TrackFigures,
    low_pass_of,
    motion_figures,
    repeats_of_frozen_input,
    track_figures,
)
from canfb.master.access import CommissioningError, as_real32
from canfb.master.machine_watch import PERCENT, SpeedReading, in_words
from canfb.master.samples import TrackSamples
from canfb.master.session import AMPLITUDES, CORNER, JITTER, KINDS, SupervisionLimits
from canfb.signal.correction import Correction
from canfb.signal.limits import (
    CALIBRATED_PHASE_ERROR_CYCLES,
    MOST_PHASE_ERROR_CYCLES,
    SHARP,
    cycles_per_interval_squared,
    max_acceleration,
)
from canfb.signal.tracker import RESIDUAL_LIMIT
from canfb.signal.witness.witness import CoarseTrack
from canfb.timing.grid import UNDECLARED
from canfb.timing.syncs import USUAL_JITTER_S
from canfb.view.module_view import LIMIT_UNITS

SAME_CORNER = 0.05  # relative difference of the corner below which 2001:05 is not changed
LEAST_AMPLITUDE_SPREAD = 0.2  # allowance for temperature, supply and ageing of an encoder
MOST_AMPLITUDE_SPREAD = 0.7
NOISE_SIGMAS = 6.0  # noise exceeds these in one of 10^9 samples
LEAST_RESIDUAL_LIMIT = 0.02  # 4 x phase error; a table half spoilt by temperature leaves 0.005 cycle
LEAST_SPEED_CHANGE = 0.5  # of the top speed; with less, neither a start nor a stop was measured
LEAST_TURNED_CYCLES = 8.0  # over fewer cycles the samples may repeat the same few phases
LEAST_COARSE_LIMIT = 1.0 / 256.0
MOST_COARSE_LIMIT = 0.25
USUAL_PERIODS, MOST_PERIODS = 2, 10
NO_TIMES = "the times of the SYNCs are not known"
Chosen = tuple[float | None, str]  # a value (None: unchanged), and the reason


@dataclass(frozen=True)
class Choice:
    """A limit: previous and new value of its object (equal: unchanged), and the reason."""

    place: od.Multiplexer
    before: float
    value: float
    why: str

    @property
    def changes(self) -> bool:
        return self.value != self.before


def choose(
    machine: Observation, limits: SupervisionLimits, margin: float, known_rad_s2: float = 0.0
) -> list[Choice]:
    """All limits in the order of :data:`LIMITS`.

    ``margin`` is the safety factor on measured values, above 1. ``known_rad_s2`` is a known acceleration of
    the machine, rad/s^2, 0.0: none.
    """
    before, corner = limits.values, corner_choice(machine.low_pass, limits)
    error, why = _phase_error(machine.motion, margin)
    error = before[od.SUPERVISION_PHASE_ERROR] if error is None else error
    most_jitter_s = UNDECLARED * machine.interval_s * limits.settings.samples_per_sync
    chosen = {
        **_amplitude(machine.tracks, margin),
        **_motion(machine, limits.settings.cycles_per_revolution, error / LIMIT_UNITS, margin, known_rad_s2),
        od.SUPERVISION_PHASE_ERROR: (error, why),
        od.SUPERVISION_FROZEN: _frozen(machine, margin),
        od.SUPERVISION_COARSE_LIMIT: _coarse(machine, margin),
        od.SUPERVISION_PERIODS: _periods(machine.longest_pause),
        JITTER.place: _jitter(machine.off_grid_s, most_jitter_s, margin),
    }
    return [
        *([] if corner is None else [corner]),
        *(
            Choice(place, before[place], before[place] if value is None else value, why)
            for place, (value, why) in chosen.items()
            if place in before
        ),
    ]


def corner_choice(low_pass: LowPass | None, limits: SupervisionLimits) -> Choice | None:
    """2001:05 from the amplitude over the speed; None if none is detected and none is set."""
    before = limits.settings.corners.corner_hz
    if low_pass is None or (not low_pass.is_detected and not before):
        return None
    measured = f"{PERCENT * low_pass.left:.0f} % of the amplitude at the highest speed"
    if not low_pass.is_detected:
        return Choice(CORNER.place, before, before, "the amplitude does not fall with the speed")
    if not low_pass.is_one_pole or not low_pass.checked:
        why = f"{measured}, which does not fall as by one pole: canfb calibrate --speeds, or data sheets"
        return Choice(CORNER.place, before, before, why)
    measured += f": {low_pass.corner_hz / 1e3:.4g} ± {low_pass.corner_sigma_hz / 1e3:.1g} kHz"
    if limits.settings.corners.cosine_corner_hz or (
        before and abs(low_pass.corner_hz - before) <= max(SAME_CORNER * before, low_pass.corner_sigma_hz)
    ):
        return Choice(CORNER.place, before, before, measured)
    return Choice(CORNER.place, before, as_real32(float(f"{low_pass.corner_hz:.4g}")), measured)


def _amplitude(tracks: TrackFigures, margin: float) -> dict[od.Multiplexer, Chosen]:
    mean, spread, usual = tracks.mean, tracks.spread, LEAST_AMPLITUDE_SPREAD
    measured = f"{tracks.least:.0f} to {tracks.most:.0f} counts, mean {mean:.0f}"
    part, why = _largest(
        (usual, f"±{PERCENT * usual:.0f} % for temperature, supply and age"),
        (margin * spread, f"{margin:g} times the largest deviation of {PERCENT * spread:.1f} %"),
    )
    if part > MOST_AMPLITUDE_SPREAD:
        why = f"{measured}: it varies too much for a narrow limit; look at the encoder, or calibrate it"
        return dict.fromkeys(AMPLITUDES, (None, why))
    values = math.floor((1.0 - part) * mean), min(WIDEST_AMPLITUDE, math.ceil((1.0 + part) * mean))
    return {place: (value, f"{measured}: {why}") for place, value in zip(AMPLITUDES, values, strict=True)}


def _motion(
    machine: Observation, n: int, error_cycles: float, margin: float, known_rad_s2: float
) -> dict[od.Multiplexer, Chosen]:
    motion, to_rad = machine.motion, machine.rad(1.0, 2, n)
    known = known_rad_s2 / to_rad
    change = motion.fastest - motion.slowest
    if known == 0.0 and (change < LEAST_SPEED_CHANGE * motion.top_speed or motion.acceleration == 0.0):
        why = (
            f"the speed changed by {PERCENT * change / motion.top_speed:.0f} % only, so the largest "
            "acceleration was not measured: let the machine start and stop meanwhile, or set --acceleration"
        )
        return dict.fromkeys((od.SUPERVISION_RESIDUAL_LIMIT, od.SUPERVISION_ACCELERATION), (None, why))
    limit, why = _residual_limit(motion, margin, known, error_cycles)
    largest, taken = _largest(
        (margin * motion.acceleration, f"times {margin:g}"),
        (known, f"{known_rad_s2:g} given"),
        (limit / LIMIT_UNITS - 4.0 * error_cycles, "raised: a smaller one would narrow the residual limit"),
    )
    most = max_acceleration(n, 1.0 / machine.interval_s)
    value = as_real32(min(_rounded_up(largest * to_rad), most))
    words = f"{motion.acceleration * to_rad:.3g} rad/s², {taken}"
    if value >= most * (1.0 - 1e-6):
        words += "; no more than eq. 10 allows: increase the SYNC rate"
    elif value / to_rad > SHARP:
        words += "; above 1/6 cycle a missed sample may lose the position: increase the SYNC rate"
    return {od.SUPERVISION_RESIDUAL_LIMIT: (limit, why), od.SUPERVISION_ACCELERATION: (value, words)}


def _residual_limit(
    motion: MotionFigures, margin: float, known: float, error_cycles: float
) -> tuple[int, str]:
    """2010:01, and the reason. ``known`` is a given acceleration, cycles per interval^2; 0.0: none."""
    noise, least = NOISE_SIGMAS * motion.residual_noise, max(LEAST_RESIDUAL_LIMIT, 4.0 * error_cycles)
    needed, why = _largest(
        (margin * max(motion.residual_peak, motion.acceleration + noise), f", times {margin:g}"),
        (
            known + margin * noise,
            f": the acceleration given, and {margin:g} times {NOISE_SIGMAS:g} standard deviations",
        ),
        (least, f": {least:.2g} cycle, so that the encoder may drift from its table"),
    )
    if needed > RESIDUAL_LIMIT:
        why = ": the widest limit, at which one bad sample is still safe; increase the SYNC rate"
    seen = f"residual up to {motion.residual_peak:.2g} cycle, {motion.residual_noise:.2g} rms of it noise"
    return min(math.ceil(needed * LIMIT_UNITS), int(RESIDUAL_LIMIT * LIMIT_UNITS)), f"{seen}{why}"


def _largest(*found: tuple[float, str]) -> tuple[float, str]:
    return max(found, key=lambda one: one[0])


def _phase_error(motion: MotionFigures, margin: float) -> Chosen:
    if motion.turned < LEAST_TURNED_CYCLES or motion.top_speed < TELLING_CYCLES:
        return (
            None,
            f"the machine moved by {motion.turned:.2g} cycles, at most {motion.top_speed:.2g} per sample: "
            "too little for the phases to show their errors",
        )
    if math.isnan(motion.fitted_error):
        return None, "only a few phases were sampled: let the machine turn at other speeds, too"
    least = CALIBRATED_PHASE_ERROR_CYCLES
    largest, why = _largest(
        (least, f": {least:g}, so that the encoder may drift from its table"),
        (margin * motion.phase_error, f", times {margin:g}"),
    )
    if largest > MOST_PHASE_ERROR_CYCLES:
        why += ", which is more than can be declared: calibrate the encoder"
    units = math.ceil(min(largest, MOST_PHASE_ERROR_CYCLES) * LIMIT_UNITS)
    return units, f"up to {motion.phase_error:.2g} cycle{why}"


def _frozen(machine: Observation, margin: float) -> Chosen:
    tracks = machine.tracks
    repeats = repeats_of_frozen_input(
        tracks.noise_counts, 1.0 / machine.interval_s, margin, tracks.longest_repeat
    )
    noise = f"noise of {tracks.noise_counts:.2f} counts, {tracks.longest_repeat} repeats in a row"
    why = (
        f"{noise}: less than one false alarm in ten years at whole cycles per sample"
        if repeats
        else f"off: {noise}; a working converter may repeat itself at whole cycles per sample"
    )
    return repeats, why


def _coarse(machine: Observation, margin: float) -> Chosen:
    spread = machine.coarse_spread
    if spread is None:
        return None, machine.coarse_note
    wide = min(max(margin * spread, LEAST_COARSE_LIMIT), MOST_COARSE_LIMIT)
    why = f"the coarse track differs by up to {360.0 * spread:.2g}° of the shaft, times {margin:g}"
    return math.ceil(wide * LIMIT_UNITS), why


def _periods(pause: float | None) -> Chosen:
    if pause is None:
        return None, NO_TIMES
    periods = USUAL_PERIODS if pause <= 1.5 else math.ceil(pause) + 1
    if periods > MOST_PERIODS:
        return None, f"a pause of {pause:.1f} periods: find its cause rather than allow for it"
    return periods, f"at most {pause:.1f} periods without SYNC or sample"


def _jitter(off_s: float | None, most_s: float, margin: float) -> Chosen:
    if off_s is None:
        return None, NO_TIMES
    seen = f"up to {1e6 * off_s:.0f} µs from the even grid"
    if margin * off_s > most_s:
        return None, f"{seen}: find its cause"
    if margin * off_s <= USUAL_JITTER_S:
        return 0.0, f"{seen}: within the default of {1e3 * USUAL_JITTER_S:g} ms"
    return as_real32(min(_rounded_up(margin * off_s), most_s)), f"{seen}, times {margin:g}"


def _rounded_up(value: float) -> float:
    step = 10.0 ** (math.floor(math.log10(value)) - 2)
    return math.ceil(value / step) * step


LEAST_SAMPLES = 2000
MOST_FLAGGED = 0.01
LEAST_OBSERVED_CYCLES, LEAST_MOVING = 4.0, 0.01
AGREES_CYCLES = 0.3
WIDEST_AMPLITUDE = 65535
GRID_SAMPLES = 256  # times that are compared with a straight line, as in docs/time.md
MOST_DIFFERENCE = 0.25  # largest difference of the coarse track, revolutions


def observe(
    samples: TrackSamples, used: Correction, limits: SupervisionLimits, readings: Sequence[SpeedReading]
) -> Observation:
    """Follow the samples, and evaluate motion, noise, amplitude and coarse track.

    ``readings`` of the speed determine the whole cycles per interval. CommissioningError, with advice, if the
    samples do not suffice.
    """
    if not samples.rate_hz:
        raise CommissioningError("the rate of the samples is not known: are SYNCs received?")
    interval_s = 1.0 / samples.rate_hz
    came = len(samples) - samples.missed
    if came < LEAST_SAMPLES:
        raise CommissioningError(
            f"{came} usable samples of {len(samples)} are too few, at least {LEAST_SAMPLES} are required: "
            f"set a longer --seconds{_missed_words(samples, interval_s)}"
        )
    start_speed, followed = _follow(samples, used, limits, readings, interval_s)
    flagged = followed.flagged
    if sum(flagged.values()) > MOST_FLAGGED * len(samples):
        raise CommissioningError(
            f"many of {len(samples)} samples are flagged already ({in_words(flagged)}): find the cause first "
            "(docs/supervision.md)"
        )
    low_pass = low_pass_of(followed, interval_s, limits.settings.corners)
    corner = corner_choice(low_pass, limits)
    if corner is not None and corner.changes:
        # The new corner changes the amplitude, so the previous limits of the amplitude do not apply.
        open_limits = limits.changed({CORNER.place: corner.value, AMPLITUDES[1]: WIDEST_AMPLITUDE})
        followed = supervise(samples, used, open_limits.chain_limits(interval_s), start_speed)
    motion = motion_figures(followed)
    if motion.turned < LEAST_OBSERVED_CYCLES or motion.moving < LEAST_MOVING:
        raise CommissioningError(
            "the machine stands still: its acceleration cannot be measured; let it do its normal duty "
            "meanwhile"
        )
    if motion.change > MOST_CHANGE_CYCLES:
        raise CommissioningError(str(changed(f"by {motion.change:.1e} cycle rms from one third to another")))
    gain = math.sqrt(abs(used.conditioning.sine_gain * used.conditioning.cosine_gain))
    spread, note = _coarse_spread(samples, followed, limits)
    jitter_s, off_grid_s = _grid(samples, interval_s)
    return Observation(
        samples,
        used,
        start_speed,
        followed,
        motion=motion,
        tracks=track_figures(samples, followed, gain, motion.noise),
        interval_s=interval_s,
        coarse_spread=spread,
        coarse_note=note,
        longest_pause=_longest_pause(samples, interval_s, limits.settings.samples_per_sync),
        jitter_s=jitter_s,
        off_grid_s=off_grid_s,
        low_pass=low_pass,
    )


def _follow(
    samples: TrackSamples,
    used: Correction,
    limits: SupervisionLimits,
    readings: Sequence[SpeedReading],
    interval_s: float,
) -> tuple[float, SupervisedSamples]:
    phase = phases_with(used, samples.sine, samples.cosine)
    time = np.arange(float(len(samples))) if samples.time_s is None else samples.time_s / interval_s
    place = positions(phase, time, samples.time_s is not None, np.zeros(0, np.int64))
    speed = np.diff(place) / np.diff(time)
    to_cycles = limits.settings.cycles_per_revolution * interval_s / (2.0 * math.pi)
    apart = [
        one.rad_per_s * to_cycles - speed[min(max(round(one.at), 0), len(speed) - 1)] for one in readings
    ]
    known = [one for one in apart if math.isfinite(one)]
    if not known:
        raise CommissioningError("the module did not report its speed (2011:07): set a longer --seconds")
    off = float(np.median(known))
    start = float(speed[np.flatnonzero(np.isfinite(speed))[0]]) + round(off)
    followed = supervise(samples, used, limits.chain_limits(interval_s), start)
    if abs(off - round(off)) <= AGREES_CYCLES and followed.valid.mean() > 0.5:
        return start, followed
    raise CommissioningError(
        f"the position is lost in the samples ({in_words(followed.flagged) or 'none flagged'}"
        f"{_missed_words(samples, interval_s)}): find the cause of flagged samples. Otherwise the machine "
        "accelerates by more than the residual limit, or samples are lost: increase the SYNC rate"
    )


def _missed_words(samples: TrackSamples, interval_s: float) -> str:
    # The module may have received what this computer, if busy, did not: its position is not lost then.
    steps = np.diff([] if samples.received_s is None else samples.received_s) / interval_s
    unheard = int((np.rint(steps) - 1.0).clip(0.0).sum())
    words = f"; {samples.missed} samples missed" if samples.missed else ""
    return f"{words}; this computer did not receive about {unheard} SYNCs" if unheard else words


def _coarse_spread(
    samples: TrackSamples, followed: SupervisedSamples, limits: SupervisionLimits
) -> tuple[float | None, str]:
    if samples.coarse is None:
        return None, "no coarse track is mapped"
    n = limits.settings.cycles_per_revolution
    track = CoarseTrack(n, limits.settings.sample.full_scale_counts, MOST_DIFFERENCE)
    use = followed.valid & np.isfinite(samples.coarse[0]) & np.isfinite(samples.coarse[1])
    if not use.any() or np.ptp(followed.position[use]) < n:
        return None, "the machine moved less than a revolution: the error of the coarse track is not known"
    pairs = zip(samples.coarse[0][use].tolist(), samples.coarse[1][use].tolist(), strict=True)
    angles = [track.angle(sine, cosine) for sine, cosine in pairs]
    if None in angles:
        return None, "the coarse track has no amplitude in some samples: find the cause first"
    apart = np.asarray(angles, np.float64) - followed.position[use] / n
    return float(np.ptp(about_mean(apart))), ""


def _longest_pause(samples: TrackSamples, interval_s: float, per_sync: int) -> float | None:
    """Longest time between two samples or SYNCs, in periods of SYNC; None without times.

    ``per_sync``: sampling intervals in a period.
    """
    if samples.received_s is None:
        return None
    missing = float(np.max(np.diff(np.flatnonzero(np.isfinite(samples.sine))), initial=1.0))
    longest = max(missing, float(np.max(np.diff(samples.received_s) / interval_s, initial=1.0)))
    return 1.0 + (longest - 1.0) / per_sync


def _grid(samples: TrackSamples, interval_s: float) -> tuple[float | None, float | None]:
    """Rms deviation of intervals between SYNCs or sample times, and the largest distance of a time from a
    line through 256 of them, seconds; None: not known.
    """
    rms, off = None, []
    for times in (samples.received_s, samples.time_s):
        if times is None or len(times) < GRID_SAMPLES:
            continue
        steps = np.diff(times, prepend=times[:1])
        rms = robust_rms(steps[1:] - interval_s)
        place = np.cumsum(np.rint(steps / interval_s))
        for part in np.array_split(np.arange(len(times)), len(times) // GRID_SAMPLES):
            line = np.polynomial.Polynomial.fit(place[part], times[part], 1)
            off.append(float(np.abs(times[part] - line(place[part])).max()))
    return rms, max(off, default=None)


# Meaning of a limit of 0.
NOTHING = {
    od.SUPERVISION_ACCELERATION: "not known",
    od.SUPERVISION_FROZEN: "off",
    JITTER.place: f"{1e3 * USUAL_JITTER_S:g} ms",
}


# Limits in 1/65536: full scale and unit.
PARTS = {
    od.SUPERVISION_RESIDUAL_LIMIT: (1.0, " cycle"),
    od.SUPERVISION_PHASE_ERROR: (1.0, " cycle"),
    od.SUPERVISION_COARSE_LIMIT: (360.0, "°"),
}


def value_words(choice: Choice, value: float, interval_s: float, cycles_per_revolution: int) -> str:
    place = choice.place
    if not value and place in NOTHING:
        return f"0, {NOTHING[place]}"
    if place == od.SUPERVISION_ACCELERATION:
        cycles = cycles_per_interval_squared(value, cycles_per_revolution, interval_s)
        return f"{value:.3g} rad/s² ({cycles:.2g} cycle)"
    if place == JITTER.place:
        return f"{1e6 * value:.0f} µs"
    if place in PARTS:
        whole, unit = PARTS[place]
        return f"{value:.0f} ({whole * value / LIMIT_UNITS:.3g}{unit})"
    return f"{value:.0f} {KINDS[place].unit}"
