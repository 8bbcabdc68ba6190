"""Each limit of the supervision from the figures of the machine, with a sentence of why."""

from __future__ import annotations

import math
from dataclasses import dataclass

from canfb import objects as od
from canfb.calibration.path_fit import LowPass
from canfb.commission.machine_figures import (
    MachineFigures,
    MotionFigures,
    TrackFigures,
    repeats_of_frozen_input,
)
from canfb.master.access import as_real32
from canfb.master.machine_watch import PERCENT
from canfb.master.session import CORNER, JITTER, SupervisionLimits
from canfb.objects import Multiplexer
from canfb.signal.limits import (
    CALIBRATED_PHASE_ERROR_CYCLES,
    MOST_PHASE_ERROR_CYCLES,
    max_acceleration,
)
from canfb.signal.tracker import RESIDUAL_LIMIT
from canfb.timing.grid import UNDECLARED
from canfb.timing.syncs import USUAL_JITTER_S
from canfb.view.module_view import LIMIT_UNITS

SAME_CORNER = 0.05  # relative: what is set need not change
LEAST_AMPLITUDE_SPREAD = 0.2  # temperature, supply and age of an encoder
MOST_AMPLITUDE_SPREAD = 0.7
NOISE_SIGMAS = 6.0  # beyond that a sample in 10^9
LEAST_RESIDUAL_LIMIT = 0.02  # four times a phase error of 0.005: a table of which temperature has taken half
LEAST_SPEED_CHANGE = 0.5  # of the top speed: less: neither a start nor a stop was measured
STEADY_LIMIT = 1.0 / 6.0  # beyond it, a single missed sample may lose the position
LEAST_TURNED_CYCLES = 8.0  # with fewer, the same few places of the cycle can come again and again
LEAST_COARSE_LIMIT = 1.0 / 256.0
MOST_COARSE_LIMIT = 0.25
USUAL_PERIODS, MOST_PERIODS = 2, 10


@dataclass(frozen=True)
class Choice:
    """A limit: the value of its object before, the one to write (the same: leave it), and why."""

    place: Multiplexer
    before: float
    value: float
    why: str

    @property
    def changes(self) -> bool:
        return self.value != self.before


def choose(
    machine: MachineFigures, limits: SupervisionLimits, margin: float, known_rad_s2: float = 0.0
) -> list[Choice]:
    """All limits in the order of :data:`LIMITS`.

    ``margin`` is the factor beyond what was measured, above 1. ``known_rad_s2`` is an acceleration that the
    machine is known to do, rad/s^2, 0.0 if there is none.
    """
    corner = corner_choice(machine.low_pass, limits)
    error = _phase_error(machine, limits, margin)
    return [
        *([] if corner is None else [corner]),
        *_amplitude(machine.tracks, limits, margin),
        *_motion(machine, limits.changed({error.place: error.value}), margin, known_rad_s2),
        error,
        _frozen(machine, limits, margin),
        _coarse(machine, limits, margin),
        _periods(machine, limits),
        *_jitter(machine, limits, margin),
    ]


def corner_choice(low_pass: LowPass | None, limits: SupervisionLimits) -> Choice | None:
    """2001:05 as the amplitude shows it; None where it shows none, and none is set."""
    before = limits.corners.corner_hz
    if low_pass is None or (not low_pass.is_detected and not before):
        return None
    measured = f"{PERCENT * low_pass.left:.0f} % of the amplitude at the highest speed"
    if not low_pass.is_detected:
        return Choice(CORNER.place, before, before, "the amplitude does not fall with the speed")
    if not low_pass.is_one_pole or not low_pass.checked:
        why = f"{measured}, which does not fall as by one pole: canfb calibrate --speeds, or data sheets"
        return Choice(CORNER.place, before, before, why)
    measured += f": {low_pass.corner_hz / 1e3:.4g} ± {low_pass.corner_sigma_hz / 1e3:.1g} kHz"
    if limits.motion.corners.cosine_corner_hz or (
        before and abs(low_pass.corner_hz - before) <= max(SAME_CORNER * before, low_pass.corner_sigma_hz)
    ):
        return Choice(CORNER.place, before, before, measured)
    return Choice(CORNER.place, before, as_real32(float(f"{low_pass.corner_hz:.4g}")), measured)


def _choice(limits: SupervisionLimits, place: Multiplexer, value: float | None, why: str) -> Choice:
    before = limits.values[place]
    return Choice(place, before, before if value is None else value, why)


def _amplitude(tracks: TrackFigures, limits: SupervisionLimits, margin: float) -> list[Choice]:
    places = (od.ENCODER_LOWEST_AMPLITUDE, od.ENCODER_HIGHEST_AMPLITUDE)
    measured = f"{tracks.least:.0f} to {tracks.most:.0f} counts seen, mean {tracks.mean:.0f}"
    wide = margin * tracks.spread
    if wide > MOST_AMPLITUDE_SPREAD:
        why = f"{measured}: it varies too much for a narrow limit; look at the encoder, or calibrate it"
        return [_choice(limits, place, None, why) for place in places]
    if wide > LEAST_AMPLITUDE_SPREAD:
        why = f"{measured}: {margin:g} times the largest deviation of {PERCENT * tracks.spread:.1f} %"
        part = wide
    else:
        why = f"{measured}: ±{PERCENT * LEAST_AMPLITUDE_SPREAD:.0f} % for temperature, supply and age"
        part = LEAST_AMPLITUDE_SPREAD
    values = (math.floor((1.0 - part) * tracks.mean), min(65535, math.ceil((1.0 + part) * tracks.mean)))
    return [_choice(limits, place, value, why) for place, value in zip(places, values, strict=True)]


def _motion(
    machine: MachineFigures, limits: SupervisionLimits, margin: float, known_rad_s2: float
) -> tuple[Choice, Choice]:
    motion, interval_s, n = machine.motion, machine.interval_s, limits.cycles_per_revolution
    places = (od.SUPERVISION_RESIDUAL_LIMIT, od.SUPERVISION_ACCELERATION)
    to_rad = machine.rad(1.0, 2, n)
    known = known_rad_s2 / to_rad
    change = motion.fastest - motion.slowest
    if known == 0.0 and (change < LEAST_SPEED_CHANGE * motion.top_speed or motion.acceleration == 0.0):
        why = (
            f"the speed changed by {PERCENT * change / motion.top_speed:.0f} % only, so the largest "
            "acceleration was not seen: let the machine start and stop meanwhile, or set --acceleration"
        )
        first, second = (_choice(limits, place, None, why) for place in places)
        return first, second
    largest = max(margin * motion.acceleration, known)
    needed, limit = _residual_limit(motion, motion.acceleration, margin, known)
    # A smaller acceleration would narrow the limit.
    largest = max(largest, limit / LIMIT_UNITS - 4.0 * limits.settings.phase_error_cycles)
    most = max_acceleration(n, 1.0 / interval_s)
    value = as_real32(min(_rounded_up(largest * to_rad), most))
    words = f"{motion.acceleration * to_rad:.3g} rad/s² seen"
    if known > margin * motion.acceleration:
        words += f", {known_rad_s2:g} given"
    else:
        words += f", times {margin:g}"
    if value >= most * (1.0 - 1e-6):
        words += "; no more than eq. 10 allows: increase the SYNC rate"
    elif value / to_rad > STEADY_LIMIT:
        words += "; above 1/6 cycle a missed sample may lose the position: increase the SYNC rate"
    return (
        _choice(limits, places[0], limit, _residual_words(motion, needed, margin, known)),
        _choice(limits, places[1], value, words),
    )


def _phase_error(machine: MachineFigures, limits: SupervisionLimits, margin: float) -> Choice:
    place, motion = od.SUPERVISION_PHASE_ERROR, machine.motion
    if motion.turned < LEAST_TURNED_CYCLES:
        why = f"the machine moved by {motion.turned:.2g} cycles only, so the phases did not show their errors"
        return _choice(limits, place, None, why)
    largest = max(margin * motion.phase_error, CALIBRATED_PHASE_ERROR_CYCLES)
    why = f"up to {motion.phase_error:.2g} cycle seen, times {margin:g}"
    if largest == CALIBRATED_PHASE_ERROR_CYCLES:
        why = (
            f"up to {motion.phase_error:.2g} cycle seen: {largest:g}, so that the encoder may drift from its "
            "table"
        )
    if largest > MOST_PHASE_ERROR_CYCLES:
        largest = MOST_PHASE_ERROR_CYCLES
        why += ", which is more than can be declared: calibrate the encoder"
    return _choice(limits, place, math.ceil(largest * LIMIT_UNITS), why)


def _residual_limit(motion: MotionFigures, largest: float, margin: float, known: float) -> tuple[float, int]:
    """The limit that is needed, cycles, and 2010:01, for the largest acceleration of this machine.

    ``known`` is a larger one that is given, cycles per interval; 0.0: none.
    """
    noise = NOISE_SIGMAS * motion.residual_noise
    needed = max(margin * max(motion.residual_peak, largest + noise), known + margin * noise)
    needed = max(needed, LEAST_RESIDUAL_LIMIT)
    return needed, min(math.ceil(needed * LIMIT_UNITS), int(RESIDUAL_LIMIT * LIMIT_UNITS))


def _residual_words(motion: MotionFigures, needed: float, margin: float, known: float) -> str:
    words = (
        f"residual up to {motion.residual_peak:.2g} cycle seen, {motion.residual_noise:.2g} rms of it noise"
    )
    if needed > RESIDUAL_LIMIT:
        return f"{words}: the widest limit, at which one bad sample is still safe; increase the SYNC rate"
    if needed == LEAST_RESIDUAL_LIMIT:
        return f"{words}: {LEAST_RESIDUAL_LIMIT:g} cycle, so that the encoder may drift from its table"
    if needed == known + margin * NOISE_SIGMAS * motion.residual_noise:
        return f"{words}: the acceleration given, and {margin:g} times {NOISE_SIGMAS:g} standard deviations"
    return f"{words}, times {margin:g}"


def _frozen(machine: MachineFigures, limits: SupervisionLimits, margin: float) -> Choice:
    tracks = machine.tracks
    repeats = repeats_of_frozen_input(
        tracks.noise_counts, 1.0 / machine.interval_s, margin, tracks.longest_repeat
    )
    noise = f"noise of {tracks.noise_counts:.2f} counts, {tracks.longest_repeat} repeats in a row seen"
    if not repeats:
        why = f"off: {noise}; a working converter may repeat itself at whole cycles per sample"
    else:
        why = f"{noise}: less than one false alarm in ten years at whole cycles per sample"
    return _choice(limits, od.SUPERVISION_FROZEN, repeats, why)


def _coarse(machine: MachineFigures, limits: SupervisionLimits, margin: float) -> Choice:
    place = od.SUPERVISION_COARSE_LIMIT
    if machine.coarse_spread is None:
        return _choice(limits, place, None, machine.coarse_note or "no coarse track is mapped")
    wide = max(margin * machine.coarse_spread, LEAST_COARSE_LIMIT)
    units = math.ceil(min(wide, MOST_COARSE_LIMIT) * LIMIT_UNITS)
    degrees = 360.0 * machine.coarse_spread
    why = f"the coarse track differs by up to {degrees:.2g}° of the shaft, times {margin:g}"
    return _choice(limits, place, units, why)


def _periods(machine: MachineFigures, limits: SupervisionLimits) -> Choice:
    place, pause = od.SUPERVISION_PERIODS, machine.longest_pause
    if pause is None:
        return _choice(limits, place, None, "the times of the SYNCs are not known")
    periods = USUAL_PERIODS if pause <= 1.5 else math.ceil(pause) + 1
    if periods > MOST_PERIODS:
        why = f"a pause of {pause:.1f} periods was seen: find its cause rather than allow for it"
        return _choice(limits, place, None, why)
    return _choice(limits, place, periods, f"at most {pause:.1f} periods without SYNC or sample were seen")


def _jitter(machine: MachineFigures, limits: SupervisionLimits, margin: float) -> list[Choice]:
    place, off_s = JITTER.place, machine.off_grid_s
    if place not in limits.values:
        return []
    if off_s is None:
        return [_choice(limits, place, None, "the times of the SYNCs are not known")]
    seen = f"up to {1e6 * off_s:.0f} µs from the even grid seen"
    most_s = UNDECLARED * machine.interval_s * limits.motion.samples_per_sync
    if margin * off_s > most_s:
        why = f"{seen}: find its cause, or map the sample time (times: true)"
        return [_choice(limits, place, None, why)]
    if margin * off_s <= USUAL_JITTER_S:
        return [_choice(limits, place, 0.0, f"{seen}: within the default of {1e3 * USUAL_JITTER_S:g} ms")]
    value = as_real32(min(_rounded_up(margin * off_s), most_s))
    return [_choice(limits, place, value, f"{seen}, times {margin:g}")]


def _rounded_up(value: float) -> float:
    step = 10.0 ** (math.floor(math.log10(value)) - 2)
    return math.ceil(value / step) * step
