"""Begin and end of sampling with NMT states, resets and silence; and why a position is not valid."""

from __future__ import annotations

from canfb.device.core import NEVER
from canfb.module.interval import AGREES, InterfaceGrid, SamplingInterval
from canfb.module.pairing import Pairing
from canfb.module.parameters import Limits
from canfb.module.publishing import Publishing
from canfb.signal.chain import SignalChain
from canfb.signal.stages import CONFIRMING_SAMPLES
from canfb.timing.grid import MEMORY
from canfb.timing.syncs import Syncs

GRID_SYNCS = 1024  # memory of the grid with several samples per SYNC, which depend on its interval


class Sampling:
    """Begins, pauses and ends the ``pairing`` of frames, and the counting of the ``chain``."""

    def __init__(
        self,
        syncs: Syncs,
        interval: SamplingInterval,
        grid: InterfaceGrid,
        limits: Limits,
        chain: SignalChain,
        pairing: Pairing,
        publishing: Publishing,
    ) -> None:
        self._syncs, self._interval, self._grid, self._limits = syncs, interval, grid, limits
        self._chain, self._pairing, self._publishing = chain, pairing, publishing
        self._paused_s = self._interval_s = 0.0  # the last SYNC before a pause; its interval
        self._paused = False  # from the end of a pause to the first sample
        pairing.on_first = self._go_on
        publishing.events.unconfirmed = self._why_unconfirmed

    def _why_unconfirmed(self) -> str:
        pairing, chain, late_ms = self._pairing, self._chain, self._syncs.late_s * 1e3
        reasons = (
            (pairing.unconfirmed, f"{CONFIRMING_SAMPLES} samples must confirm it after the pause"),
            (late_ms, f"SYNC {late_ms:.3g} ms late, one may have been missed: the next SYNCs decide"),
            (chain.searches, "the sample times do not confirm yet that the machine stood at the start"),
            (chain.reference.in_doubt, "a zero pulse contradicts it"),
            (pairing.timed, "the sample time is not where it was due"),
        )
        return next((text for holds, text in reasons if holds), "")

    def overdue(self, now: float) -> None:
        if not self._pairing.overdue(now):
            self._publishing.outdated(now)
        if self._chain.lost:
            self._syncs.until = NEVER

    def uncounted(self, now: float) -> None:
        """Lose the position: the bus is off, and no SYNC is counted."""
        if self._pairing.sampled:
            self._publishing.publish(self._chain.lose(), now, send=False)
            self._pairing.begin()

    def pause(self, now: float) -> None:
        """End sampling: OPERATIONAL ends, or the mapping changes."""
        if not self._paused:
            grid = self._syncs.grid  # its last place: the call of a late host may be later than the SYNC
            self._paused_s = min(self._syncs.synced_s, grid.due - grid.period) if self._syncs.begun else now
            self._interval_s = self._interval.seconds
        self._pairing.begin()

    def resume(self, now: float) -> None:
        """Begin sampling: OPERATIONAL, for the first time or again."""
        chain, pairing = self._chain, self._pairing
        pairing.begin()
        pairing.unconfirmed = CONFIRMING_SAMPLES if chain.begun and not chain.lost else 0
        self._paused = True
        if not chain.begun:
            self._go_on(now)
        self._publishing.prediction.pause(self._publishing.last)
        self._publishing.outdated(now)

    def _go_on(self, now: float) -> None:
        """At the first sample, continue after a pause: from the last SYNC, whose sample may not have come."""
        if self._paused:
            self._paused = False
            before_s = self._interval_s
            known = before_s and abs(self._interval.seconds - before_s) <= AGREES * before_s
            self._chain.resume((now - self._paused_s) / before_s + 1.0 if known else NEVER)

    def configured(self, samples_per_sync: int, timed: bool) -> None:
        """Set the number of samples per SYNC, and whether they are ``timed``."""
        limits = self._limits
        if (samples_per_sync, timed) != (self._interval.samples_per_sync, limits.timed):
            self._interval.samples_per_sync, limits.timed = samples_per_sync, timed
            self._interval.speed_unit_s = 0.0
            self._chain.measures_intervals = True
            self._chain.sample_grid.memory = GRID_SYNCS if samples_per_sync > 1 else MEMORY
            limits.noise_changes()

    def forget_interval(self) -> None:
        """Forget the rate of SYNC: after a reset another master may send another one."""
        self._syncs.forget()
        self._pairing.answers.forget()
        self._interval.speed_unit_s = 0.0
        self._grid.forget()
        self._chain.forget_times()
