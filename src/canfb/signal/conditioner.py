"""From the counts of the next sample to its phase: conditioning and correction at the present speed and
drift.
"""

from __future__ import annotations

from collections.abc import Callable

from canfb.signal.adaptation import Adaptation, AdaptConfig, FollowedDrift
from canfb.signal.correction import NO_CORRECTION, Correction, check_table
from canfb.signal.front_end import NO_LOW_PASS, Corners, FrontEnd, corrected
from canfb.signal.sample import Feedback


class Conditioner:
    """The correction in use, at the speed of the machine. Speeds are in cycles per interval.

    correction      the active one
    coefficients    of the conditioning of the next sample
    correct         from raw phase, not NaN, to phase
    front           the part that depends on the speed; None: nothing does
    lag_intervals   2002:07 in sampling intervals: age of the position at the instant of the sample
    unit_s          the sampling interval, seconds; 0.0: not known
    """

    __slots__ = (
        "_row",
        "_table_phase",
        "adaptation",
        "coefficients",
        "corners",
        "correct",
        "correction",
        "front",
        "lag_intervals",
        "unit_s",
    )

    def __init__(self, unit_s: float) -> None:
        self.correction, self.corners = NO_CORRECTION, NO_LOW_PASS
        self.unit_s = unit_s
        self.adaptation = Adaptation()
        self._renew()

    def activate(self, correction: Correction) -> None:
        check_table(correction.table)
        self.correction = correction
        self.adaptation.use(correction)
        self._renew()

    def use_corners(self, corners: Corners) -> None:
        self.corners = corners
        self._renew()

    def adapt(self, limits: AdaptConfig | None, start_from: FollowedDrift | None = None) -> None:
        self.adaptation.use_limits(limits, start_from)
        self._renew()

    def use_unit(self, unit_s: float) -> None:
        self.unit_s = unit_s
        self.lag_intervals = self.correction.conditioning.delay_s / unit_s if unit_s > 0.0 else 0.0
        if self.front is not None:
            self.front.use_interval(unit_s)

    def expect(self, speed_cycles: float, amplitude_known: bool = True) -> None:
        front = self.front
        if front is not None:
            self.coefficients = front.coefficients(speed_cycles, amplitude_known)
            if front.varies:
                self._row, self.lag_intervals = front.row(speed_cycles), front.lag_intervals(speed_cycles)

    def _without_harmonics(self, raw: float) -> float:
        phase = self._table_phase(raw)
        return corrected(self._row, phase) if self._row else phase

    def learn(self, feedback: Feedback) -> bool:
        moved = self.adaptation.take(feedback, self.unit_s)
        if moved:
            self._remove_drift()
        return moved

    @property
    def phases_keep(self) -> bool:
        return self.correction.conditioning.cosine_delay_s == 0.0

    @property
    def depends_on_past(self) -> bool:
        """True if the phase depends on earlier samples, too."""
        return self.front is not None or self.adaptation.is_on

    @property
    def needs_unit(self) -> bool:
        """True if the sampling interval in seconds is needed: for the analog path or the drift."""
        return self.depends_on_past or self.correction.conditioning.delay_s != 0.0

    def turned_rad(self, speed_cycles: float) -> float:
        return 0.0 if self.front is None else self.front.turned_rad(speed_cycles)

    def hertz(self, speed_cycles: float) -> float:
        """This speed in cycles per second; 0.0 if nothing depends on it."""
        return 0.0 if self.front is None else self.front.hertz(speed_cycles)

    def _renew(self) -> None:
        conditioning, corners = self.correction.conditioning, self.corners
        depends = not self.phases_keep or corners.are_there
        self.front = FrontEnd(conditioning, corners) if depends else None
        self.coefficients = conditioning.coefficients()
        self._row = ()  # correction of the harmonics at the next sample; () for none
        table = self.correction.table
        self._table_phase: Callable[[float], float] = float if table is None else table.correct
        harmonics = self.front is not None and self.front.varies
        self.correct = self._without_harmonics if harmonics else self._table_phase
        self._remove_drift()
        self.use_unit(self.unit_s)

    def _remove_drift(self) -> None:
        if self.adaptation.is_on:
            used = self.adaptation.drift.removed_by(self.correction.conditioning)
            self.coefficients = used.coefficients()
            if self.front is not None:
                self.front.use_conditioning(used)
