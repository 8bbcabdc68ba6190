"""Objects 2002:08..12: following offset, gain and phase of the tracks in operation (docs/adaptation.md)."""

from __future__ import annotations

from functools import partial

from canfb import objects as od
from canfb.device.od.dictionary import Dictionary
from canfb.device.storage.storage import Storage
from canfb.module.parameters import ADAPTATION_BOUNDS, ADAPTATION_UNIT, Limits
from canfb.objects import AdaptationState as State
from canfb.signal.adaptation import AdaptConfig, FollowedDrift
from canfb.signal.chain import SignalChain

MOST_PER_CENT = 0xFFFF


class Adapting:
    """Between these objects and :attr:`SignalChain.adaptation`.

    `save` keeps the drift that is followed, and a reset goes on from there; the conditioning of 2002:01..07
    stays that of the calibration. An activation (2020:03, 2030:01) begins at zero, as 2002:08 does when 0 is
    written.
    """

    def __init__(self, dictionary: Dictionary, chain: SignalChain, limits: Limits, storage: Storage) -> None:
        self._chain, self._limits = chain, limits
        entry = dictionary.entry
        self._mode = entry(*od.ADAPTATION)
        self._bounds = {name: entry(*place) for name, place in ADAPTATION_BOUNDS.items()}
        self._drift = [entry(*place) for place in od.DRIFT]
        self._mode.on_written = self._apply
        for bound in self._bounds.values():
            bound.on_written = self._apply
        entry(*od.ADAPTATION_STATE).on_read = lambda: int(self.state)
        entry(*od.ADAPTATION_USED).on_read = self._used
        for part, shown in enumerate(self._drift):
            shown.on_read = read = partial(self._followed, part)
            storage.entries.keep(shown.index, shown.subindex, saved=read)

    @property
    def state(self) -> State:
        """What it does now."""
        adaptation = self._chain.adaptation
        if not adaptation.is_on:
            return State.OFF
        if adaptation.at_limit:
            return State.AT_LIMIT
        return State.FOLLOWING if adaptation.is_recent(self._chain.samples) else State.WAITING

    def reset(self) -> None:
        """After the correction is in force: on from the drift that was saved with it."""
        self._adapt(FollowedDrift(*(entry.value for entry in self._drift)))

    def _apply(self) -> None:
        self._adapt(None)

    def _adapt(self, start_from: FollowedDrift | None) -> None:
        bounds = {name: entry.value * ADAPTATION_UNIT for name, entry in self._bounds.items()}
        self._chain.adapt(AdaptConfig(**bounds) if self._mode.value else None, start_from)
        self._limits.apply()  # it needs the sampling interval

    def _followed(self, part: int) -> float:
        return self._chain.adaptation.drift[part]

    def _used(self) -> int:
        return min(int(100.0 * self._chain.adaptation.used), MOST_PER_CENT)
