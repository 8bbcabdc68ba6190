"""Samples of a machine in its duty, followed by the chain of the module.

They leave the speed open by whole cycles per interval, which the speeds that the module reports (2011:07)
close.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from canfb.calibrate.samples_through_chain import SupervisedSamples, supervise
from canfb.calibration.motion_blocks import about_mean, robust_rms
from canfb.calibration.recording import positions
from canfb.calibration.result import MOST_CHANGE_CYCLES, changed
from canfb.commission.limit_choice import corner_choice
from canfb.commission.machine_figures import (
    MachineFigures,
    change_in_time,
    low_pass_of,
    motion_figures,
    track_figures,
)
from canfb.master.access import CommissioningError
from canfb.master.machine_watch import SpeedReading, in_words
from canfb.master.samples import TrackSamples
from canfb.master.session import AMPLITUDES, CORNER, SupervisionLimits
from canfb.signal.correction import Correction
from canfb.signal.phase import raw_phases
from canfb.signal.witness.coarse import CoarseTrack

LEAST_SAMPLES = 2000
MOST_FLAGGED = 0.01
LEAST_TURNED_CYCLES, LEAST_MOVING = 4.0, 0.01
AGREES_CYCLES = 0.3
WIDEST_AMPLITUDE = 65535
GRID_SAMPLES = 256  # as docs/time.md
MOST_DIFFERENCE = 0.25  # of the coarse track, revolutions


@dataclass(frozen=True, eq=False)
class Observation:
    """Samples of a machine, followed from their start on, and what they show.

    start_speed   at the first sample, cycles per interval
    followed      the chain's account, with the limits that the module has, and the corner that is chosen
    """

    samples: TrackSamples
    used: Correction
    start_speed: float
    followed: SupervisedSamples
    machine: MachineFigures


def observe(
    samples: TrackSamples, used: Correction, limits: SupervisionLimits, readings: Sequence[SpeedReading]
) -> Observation:
    """Follow the samples, and look at motion, noise, amplitude and coarse track.

    ``readings`` of the speed meanwhile determine how many whole cycles per interval the machine moves.
    CommissioningError, with what to do, where the samples say too little.
    """
    if not samples.rate_hz:
        raise CommissioningError("the rate of the samples is not known: are SYNCs received?")
    interval_s = 1.0 / samples.rate_hz
    start_speed, followed = _follow(samples, used, limits, readings, interval_s)
    valid = int(np.count_nonzero(followed.valid))
    if valid < LEAST_SAMPLES:
        raise CommissioningError(
            f"{valid} usable samples of {len(samples)} are too few, at least {LEAST_SAMPLES} are required: "
            "set a longer --seconds"
        )
    flagged = followed.flagged
    if sum(flagged.values()) > MOST_FLAGGED * len(samples):
        raise CommissioningError(
            f"of {len(samples)} samples many are flagged already ({in_words(flagged)}): find the cause first "
            "(docs/supervision.md)"
        )
    low_pass = low_pass_of(followed, interval_s, limits.corners)
    corner = corner_choice(low_pass, limits)
    if corner is not None and corner.changes:
        # With it the amplitude is another one: the limits of before say nothing about that.
        open_limits = limits.changed({CORNER.place: corner.value, AMPLITUDES[1]: WIDEST_AMPLITUDE})
        followed = supervise(samples, used, open_limits.chain_limits(interval_s), start_speed)
    motion = motion_figures(followed)
    if motion.turned < LEAST_TURNED_CYCLES or motion.moving < LEAST_MOVING:
        raise CommissioningError(
            "the machine stands still: nothing can be said of its acceleration; let it do its normal duty "
            "meanwhile"
        )
    change = change_in_time(followed)
    if change > MOST_CHANGE_CYCLES:
        raise CommissioningError(str(changed(f"by {change:.1e} cycle rms from one third to another")))
    gain = math.sqrt(abs(used.conditioning.sine_gain * used.conditioning.cosine_gain))
    spread, note = _coarse(samples, followed, limits)
    jitter_s, off_grid_s = _grid(samples, interval_s)
    machine = MachineFigures(
        motion=motion,
        tracks=track_figures(samples, followed, gain, motion.noise),
        interval_s=interval_s,
        coarse_spread=spread,
        coarse_note=note,
        longest_pause=_longest_pause(samples, interval_s, limits.motion.samples_per_sync),
        jitter_s=jitter_s,
        off_grid_s=off_grid_s,
        change_cycles=change,
        low_pass=low_pass,
    )
    return Observation(samples, used, start_speed, followed, machine)


def _follow(
    samples: TrackSamples,
    used: Correction,
    limits: SupervisionLimits,
    readings: Sequence[SpeedReading],
    interval_s: float,
) -> tuple[float, SupervisedSamples]:
    raw = raw_phases(*used.conditioning.apply(samples.sine, samples.cosine))
    phase = raw if used.table is None else used.table(raw)
    even = np.arange(float(len(samples)))
    time = even if samples.time_s is None else samples.time_s / interval_s
    place = positions(phase, time, samples.time_s is not None, np.zeros(0, np.int64))
    speed = np.diff(place) / np.diff(time)
    to_cycles = limits.cycles_per_revolution * interval_s / (2.0 * math.pi)
    apart = [
        one.rad_per_s * to_cycles - speed[min(max(round(one.at), 0), len(speed) - 1)] for one in readings
    ]
    known = [one for one in apart if math.isfinite(one)]
    if not known:
        raise CommissioningError(
            "the module did not say its speed (2011:07) meanwhile: set a longer --seconds"
        )
    off = float(np.median(known))
    start = float(speed[np.flatnonzero(np.isfinite(speed))[0]]) + round(off)
    followed = supervise(samples, used, limits.chain_limits(interval_s), start)
    if abs(off - round(off)) <= AGREES_CYCLES and followed.valid.mean() > 0.5:
        return start, followed
    missed = f"; {samples.missed} samples did not come" if samples.missed else ""
    raise CommissioningError(
        f"the position is lost in the samples ({in_words(followed.flagged) or 'none flagged'}{missed}): the "
        "machine accelerates by more than the residual limit, or samples are lost; increase the SYNC rate, "
        "or let it move more slowly"
    )


def _coarse(
    samples: TrackSamples, followed: SupervisedSamples, limits: SupervisionLimits
) -> tuple[float | None, str]:
    if samples.coarse is None:
        return None, ""
    n = limits.cycles_per_revolution
    track = CoarseTrack(n, limits.full_scale_counts, MOST_DIFFERENCE)
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
    """Between two samples, or two SYNCs, periods of SYNC; None where the times are not known.

    Of ``per_sync`` samples in a period each, those of one that is missing add that many intervals.
    """
    if samples.received_s is None:
        return None
    here = np.flatnonzero(np.isfinite(samples.sine))
    missing = float(np.max(np.diff(here), initial=1.0))
    pauses = np.diff(samples.received_s) / interval_s
    longest = max(missing, float(np.max(pauses, initial=1.0)))
    return 1.0 + (longest - 1.0) / per_sync


def _grid(samples: TrackSamples, interval_s: float) -> tuple[float | None, float | None]:
    """Rms of the time from SYNC to SYNC, or of sample times, and the largest distance of any from a line
    through 256 of them, seconds; None: not known.
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
