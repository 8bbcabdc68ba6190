"""The computation of a reference measurement, to be run where it delays nothing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

from canfb.calibration.from_motion import calibrate_from_motion
from canfb.calibration.recording import recorded_tracks, timed_tracks
from canfb.calibration.result import Calibration, Reason
from canfb.calibration.simultaneous import recorded_together
from canfb.calibration.solver import no_progress
from canfb.calibration.track_harmonics import without_harmonics
from canfb.errors import CalibrationError


class Outcome(NamedTuple):
    """What came out of a :class:`CalibrationJob`.

    reason        a :class:`canfb.calibration.result.Reason`
    calibration   the measurement; if it was refused, for diagnosis only, and None where there is none
    text          one line for people
    """

    reason: Reason
    calibration: Calibration | None
    text: str


@dataclass(frozen=True, eq=False)
class CalibrationJob:
    """Samples, and what to make of them: a call computes it, in seconds. It can be pickled.

    samples     as 2050:03 has them
    times       sample times in 100 ns, rising, INTEGER64 of this machine, NO_TIME for none;
                None: one sample per interval
    adc_bits    4..16
    turned      by how much the machine turned from the sine of each sample to its cosine, rad, REAL32 of this
                machine; None: both are sampled at once
    at_speed    the analog path counts at the speed of the samples
    delays_s    2002:06 and 2002:07, which stay as they are: they do not show at one speed
    """

    samples: bytes
    times: bytes | None
    adc_bits: int
    turned: bytes | None = None
    delays_s: tuple[float, float] = (0.0, 0.0)
    at_speed: bool = False

    def __call__(self, progress: Callable[[float], None] = no_progress) -> Outcome:
        """Table and conditioning from the samples; ``progress`` is called with 0..1."""
        time_s = None
        if self.times is None:
            sine, cosine = recorded_tracks(self.samples)
        else:
            sine, cosine, time_s = timed_tracks(self.samples, self.times)
        try:
            if self.turned is not None:
                cosine = recorded_together(sine, cosine, time_s, self.adc_bits, self.turned, self.times)
            found = calibrate_from_motion(
                sine, cosine, "fit", time_s=time_s, adc_bits=self.adc_bits, progress=progress
            )
        except CalibrationError as error:
            return Outcome(Reason(error.reason), error.calibration, str(error))
        between_s, common_s = self.delays_s
        kept = replace(found.conditioning, cosine_delay_s=between_s, delay_s=common_s)
        found = replace(found, conditioning=without_harmonics(kept) if self.at_speed else kept)
        return Outcome(Reason.ACCEPTED, found, found.verdict)
