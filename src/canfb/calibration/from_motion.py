"""Reference measurement from any motion, at any speed, also many cycles per sample.

The position of a machine is smooth over tens of samples, the errors of the encoder repeat
with every cycle. So one least-squares fit (:mod:`.joint`) separates the two. It needs neither a
constant speed nor many samples per cycle, only different phases in the samples of a block.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from canfb.calibration.ellipse import angle_cycles, as_real32, fit_ellipse
from canfb.calibration.evaluate import finish, root_mean
from canfb.calibration.recording import check_clipped, recording
from canfb.calibration.result import Calibration
from canfb.calibration.solver import Progress, Solver, no_progress
from canfb.calibration.track_harmonics import with_track_harmonics
from canfb.signal.conditioning import IDENTITY, Conditioning


def calibrate_from_motion(
    sine: npt.ArrayLike,
    cosine: npt.ArrayLike,
    conditioning: Conditioning | str | None = None,
    *,
    time_s: npt.ArrayLike | None = None,
    valid: npt.ArrayLike | None = None,
    adc_bits: int | None = None,
    entries: int = 1024,
    progress: Progress | None = None,
) -> Calibration:
    """Correction table from samples of any motion, taken at any rate (also below Nyquist).

    sine, cosine    ADC counts, zero at mid-scale except for an offset that ``conditioning``
                    removes, shape (n,), NaN for a missing sample, or -32768 in both, the
                    mark of a recording (2050:03)
    conditioning    None: the table corrects all errors, "fit" fits the ellipse of the tracks first, or
                    a :class:`canfb.signal.conditioning.Conditioning` to use
    time_s          sample times in seconds, rising; None: one sample per interval, no gaps
    valid           False for samples to omit (missed, faulty)
    adc_bits        4..16, to find clipped samples; None: 12, 14 or 16, the first that fits
    entries         length of the table, 16..4096. with 1024 the interpolation error is below
                    0.001 % of a cycle even for very poor tracks without conditioning
    progress        called with 0..1 during the computation

    Raises ValueError for wrong arguments, :class:`canfb.errors.CalibrationError` for a
    measurement that is refused, with the reason and the remedy.
    """
    if not 16 <= entries <= 4096:
        raise ValueError(f"entries must be 16..4096, not {entries!r}")
    if not (conditioning is None or conditioning == "fit" or isinstance(conditioning, Conditioning)):
        raise ValueError('conditioning must be None, "fit" or a Conditioning')
    report = progress or no_progress
    record = recording(sine, cosine, time_s, valid, adc_bits, may_be_offset=conditioning is not None)
    ellipse = fit_ellipse(record.sine, record.cosine, record.valid)
    angle = angle_cycles(ellipse, record.sine, record.cosine)
    check_clipped(record, angle)
    report(0.05)
    amplitude = root_mean(np.hypot(*ellipse.apply(record.sine, record.cosine))[record.valid])
    solution = Solver(record, ellipse, amplitude, report).solve(angle)
    report(0.8)
    chosen = IDENTITY if conditioning is None else conditioning
    if not isinstance(chosen, Conditioning):
        chosen = ellipse
    result = finish(record, solution, as_real32(chosen), entries)
    if conditioning == "fit" and result.tracks is not None:
        result = replace(result, conditioning=with_track_harmonics(result.conditioning, result.tracks))
    report(1.0)
    return result
