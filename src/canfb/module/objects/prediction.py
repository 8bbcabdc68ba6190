"""Object 2013h: the position at the SYNC that sends it, or at the nominal SYNC."""

from __future__ import annotations

import math

from canfb import objects as od
from canfb.device.od.dictionary import Dictionary
from canfb.module.cia406.profile import EncoderProfile
from canfb.module.interval import SamplingInterval
from canfb.signal.chain import SignalChain
from canfb.signal.sample import TICK_S, Feedback
from canfb.signal.supervision import COASTING, EXTRAPOLATED, VALID

OFF, CONSTANT_SPEED, CONSTANT_ACCELERATION = 0, 1, 2  # 2013:01
KNOWN_ACCELERATION = 3  # successive valid samples that determine one


class Prediction:
    """Extrapolates 6004h and 6008h by one interval of SYNC, for synchronous TPDOs only (docs/latency.md).

    At SYNC k+1 the newest sample is that of SYNC k. With x the position, v = x(k) - x(k-1) and a = v(k) -
    v(k-1), in cycles and sampling intervals, m of which are in one of SYNC:

        1  constant speed         x(k) + m v
        2  constant acceleration  x(k) + m v + a m (m + 1)/2, since v is the speed half an interval ago

    :meth:`extrapolate` comes before the TPDOs of a SYNC are sampled, and :meth:`withdraw` restores
    ``measured`` afterwards; in between, bit 12 of the status word is set. While coasting the position
    continues at the last valid speed; a lost one is not extrapolated.

    With 2013:02 and sample times, :meth:`shift` moves the position to the nominal SYNC of its sample, d
    intervals later: x + v d. Formula 1 then adds v (d + p), formula 2 v (d + p) + a (d + p)(d + p + 1)/2, p
    the period in intervals. The delay of the analog path (2002:07) is added in all cases.
    """

    def __init__(
        self,
        dictionary: Dictionary,
        profile: EncoderProfile,
        chain: SignalChain,
        interval: SamplingInterval,
    ) -> None:
        entry = dictionary.entry
        self._kind, self._nominal = entry(*od.PREDICTION_POSITION), entry(*od.PREDICTION_NOMINAL_SYNC)
        self._kind.on_written = self._nominal.on_written = self.forget
        self._chain, self._lock = chain, chain.sample_grid
        self._interval = interval
        self._position, self._fine = entry(*od.POSITION_VALUE), entry(*od.HIGH_PRECISION_POSITION)
        self._status = entry(*od.FEEDBACK_STATUS)
        self._profile = profile
        self.measured: tuple[int, int, int] | None = None
        self.pause(None)

    def pause(self, last: Feedback | None) -> None:
        """OPERATIONAL begins: samples up to ``last`` do not show the present speed."""
        self._before = 0 if last is None else last.samples  # samples before OPERATIONAL
        self.forget()

    def forget(self) -> None:
        # Whether `extrapolate` and `withdraw` must be called, and whether `shift` must.
        self.extrapolates, self.follows = bool(self._kind.value != OFF), bool(self._nominal.value)
        self.is_on = self.extrapolates or self.follows
        self._at_sync: int | None = None  # number of samples at the last SYNC
        self._last_displacement = 0.0  # to the SYNC after the last valid sample, cycles
        self._valid_samples = 0  # valid samples in a row

    def shift(self, last: Feedback, cycles: int, phase: float) -> None:
        if not last.status & VALID or not self._lock.locked:
            return
        self._show(cycles, phase, last.speed_cycles * self._intervals(self._lock.lead))

    def _show(self, cycles: int, phase: float, displacement_cycles: float) -> None:
        cycles, phase = ahead(cycles, phase, displacement_cycles)
        self._position.value = self._fine.value = self._profile.scale.position(cycles, phase)
        self._status.value |= EXTRAPOLATED

    def _intervals(self, ticks: float) -> float:
        return ticks * TICK_S / self._chain.unit_s

    def extrapolate(self, last: Feedback, periods: int, most_syncs: int) -> None:
        """At a SYNC: ``last`` answers that ``periods`` before; since then ``most_syncs`` may be answered."""
        since = None if self._at_sync is None else last.samples - self._at_sync
        self._at_sync = last.samples
        displacement = self._displacement(last, periods)
        self.measured = self._position.value, self._fine.value, self._status.value
        # With more samples than expected since the last SYNC, the instant of the newest is not known.
        if (
            displacement is None
            or last.samples == self._before
            or (since is not None and since > self._interval.samples_per_sync * most_syncs)
        ):
            self._status.value &= ~EXTRAPOLATED  # not even to the nominal SYNC
            return
        self._show(last.cycles, last.phase, displacement)

    def withdraw(self) -> None:
        if self.measured is not None:
            self._position.value, self._fine.value, self._status.value = self.measured
            self.measured = None

    def _displacement(self, last: Feedback, periods: int) -> float | None:
        """Cycles from the last sample to this SYNC; None: there is no position to extrapolate."""
        status = last.status
        if not status & VALID:
            self._valid_samples = 0
            return self._last_displacement if status & COASTING else None
        self._valid_samples += 1
        periods *= self._interval.per_sync
        after, lock = float(self._interval.samples_per_sync * periods), self._lock
        if self.follows and lock.locked:
            after = self._intervals(lock.lead + periods * lock.period)
        after += self._chain.tracks.lag_intervals
        self._last_displacement = displacement = last.speed_cycles * after
        curved = self._kind.value == CONSTANT_ACCELERATION
        if curved and self._valid_samples >= KNOWN_ACCELERATION:
            displacement += last.acceleration_cycles * after * (after + 1.0) / 2.0
        return displacement


def ahead(cycles: int, phase: float, displacement_cycles: float) -> tuple[int, float]:
    """The position plus ``displacement_cycles``, 0 <= phase < 1; the count stays an integer."""
    whole = math.floor(displacement_cycles)
    position = phase + (displacement_cycles - whole)  # 0 to 2, which rounding may reach
    turns = math.floor(position)
    return cycles + whole + turns, position - turns
