"""The usual sample from the dictionary through the chain (there: `canfb.signal.usual_step`).

Nearly each sample is one: two counts in time, and nothing wrong. For any other one the parts are called one
by one; tests/module/test_usual_sample.py compares both, frame by frame.
"""

from __future__ import annotations

from collections.abc import Callable

from canfb import objects as od
from canfb.device.od.dictionary import Dictionary
from canfb.module.objects.recorder import SampleObservers
from canfb.module.parameters import Limits
from canfb.module.publishing import Publishing
from canfb.signal.chain import SignalChain


class UsualSample:
    """Takes the counts that stand in the dictionary, by the shortest way.

    ``unusual(now)`` takes all that are not usual.
    """

    def __init__(
        self,
        dictionary: Dictionary,
        chain: SignalChain,
        limits: Limits,
        taps: SampleObservers,
        publishing: Publishing,
        unusual: Callable[[float], None],
    ) -> None:
        entry = dictionary.entry
        self._sine, self._cosine, self._flags = (
            entry(*one) for one in (od.SAMPLE_SINE, od.SAMPLE_COSINE, od.SAMPLE_FLAGS)
        )
        self._chain, self._limits, self._taps = chain, limits, taps
        self._publishing = publishing
        self._interval = limits.interval
        self._unusual = unusual
        self.unconfirmed = 0
        """Samples after a pause that are not called valid yet."""

    def take(self, now: float) -> None:
        """The sample that has come, ``now`` in seconds."""
        limits = self._limits
        if self.unconfirmed or self._taps.open or self._flags.value:
            self._unusual(now)
            return
        if limits.narrowed and not limits.shortest_s < self._interval.measured_s < limits.longest_s:
            limits.follow()
        feedback = self._chain.usual(self._sine.value, self._cosine.value)
        if feedback is None:
            self._unusual(now)
            return
        noise = limits.noise
        if feedback[-1] >= noise.due and noise.take(feedback):
            limits.measured()
        self._publishing.publish(feedback, now)
