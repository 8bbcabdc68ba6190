"""Samples of the ADC PDO, SYNC by SYNC, without a word of its own on the bus."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from canfb.commissioning.access import CommissioningError, Master
from canfb.commissioning.pdo_layout import PdoLayout
from canfb.commissioning.samples import MISSED, Samples

SYNC = 0x80
PATIENCE_S = 2.0  # for the first SYNC, the first sample, and for either to go on
LOOK_S = 0.1
PART_MISSED = 0.5
Heard = Callable[[float], None]


class PdoRecorder:
    """Puts SYNCs and PDOs together: each SYNC gets one sample, the first that comes before the next SYNC.

    Its methods are called from the receiving thread, in the order of the frames; what came is read when
    they are no longer called.
    """

    def __init__(self, layout: PdoLayout) -> None:
        self._layout = layout
        self._pairs: list[tuple[int, int]] = []
        self._times: list[float] = []
        self.samples = 0
        self.surplus = 0
        """PDOs beyond one for each SYNC, or too short: not used."""

    @property
    def syncs(self) -> int:
        """SYNCs that came."""
        return len(self._times)

    def hear_sync(self, can_id: int, data: bytes, time_s: float) -> None:
        """A SYNC: a new interval begins."""
        self._pairs.append((MISSED, MISSED))
        self._times.append(time_s)

    def hear_pdo(self, can_id: int, data: bytes, time_s: float) -> None:
        """A PDO with a sample."""
        if not self._pairs:
            return  # it belongs to a SYNC that was before
        counts = self._layout.unpack(data)
        if counts is None or self._pairs[-1] != (MISSED, MISSED):
            self.surplus += 1
            return
        self._pairs[-1] = counts
        self.samples += 1

    def result(self, origin: str) -> Samples:
        """What came; the last interval may still be open and is left out."""
        pairs = np.array(self._pairs[:-1], np.float64).reshape(-1, 2)
        return Samples.of(pairs[:, 0], pairs[:, 1], self._rate_hz(), origin)

    def _rate_hz(self) -> float | None:
        steps = np.diff(self._times)
        # The median does not mind a pause; the mean of what is near it does not mind late time stamps.
        if not len(steps) or (middle := float(np.median(steps))) <= 0.0:
            return None
        near = steps[np.abs(steps - middle) < 0.5 * middle]
        return 1.0 / float(near.mean()) if len(near) else None


def listen(master: Master, layout: PdoLayout, duration_s: float, heard: Heard = lambda part: None) -> Samples:
    """Samples of ``duration_s`` seconds from the first SYNC on; ``heard`` gets 0..1 as time goes.

    CommissioningError, with what to do, when SYNC or samples do not come.
    """
    recorder = PdoRecorder(layout)
    master.subscribe(SYNC, recorder.hear_sync)
    master.subscribe(layout.can_id, recorder.hear_pdo)
    try:
        _follow(master, recorder, layout, duration_s, heard)
    finally:
        master.unsubscribe(SYNC, recorder.hear_sync)
        master.unsubscribe(layout.can_id, recorder.hear_pdo)
    samples = recorder.result(f"PDO {layout.can_id:03X}h at each SYNC")
    if samples.missed > PART_MISSED * len(samples):
        raise CommissioningError(
            f"{samples.missed} of {len(samples)} SYNCs brought no PDO {layout.can_id:03X}h: samples are "
            "lost, or the PDO is not sent at each SYNC (transmission type 1 is needed)"
        )
    return samples


def _follow(
    master: Master, recorder: PdoRecorder, layout: PdoLayout, duration_s: float, heard: Heard
) -> None:
    """Wait, and see that SYNC and samples keep coming."""
    began = last_sync = last_sample = master.now()
    started = False
    syncs = samples = 0
    while True:
        master.wait(LOOK_S)
        now = master.now()
        if recorder.syncs > syncs:
            syncs, last_sync = recorder.syncs, now
            if not started:
                started, began = True, now
        if recorder.samples > samples:
            samples, last_sample = recorder.samples, now
        if now - last_sync > PATIENCE_S:
            raise CommissioningError(
                f"no SYNC (080h) for {PATIENCE_S:g} s: start the node that produces it, the drive or the "
                "controller, or let canfb produce it (--sync HZ)"
            )
        if now - max(last_sample, began) > PATIENCE_S:
            raise CommissioningError(
                f"SYNC comes, the PDO {layout.can_id:03X}h with the samples does not: is the encoder "
                "interface OPERATIONAL (NMT start), and its id right?"
            )
        if started:
            heard(min(1.0, (now - began) / duration_s))
            if now - began >= duration_s:
                return
