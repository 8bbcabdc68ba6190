"""An estimator on arrays, where nothing is in doubt."""

from __future__ import annotations

from canfb.signal.blocks import Scratch
from canfb.signal.estimator import REMEMBERED_SAMPLES, Estimator
from canfb.signal.tracker import TrackResult
from canfb.signal.tracking import steady_run


def follow_run(estimator: Estimator, tracked: TrackResult, run: slice, scratch: Scratch) -> int:
    """Follow a run of phases, ``tracked.phase[run]``, one interval apart, with eq. 9 on arrays.

    Only where the tracker is steady and nothing is in doubt. What the prediction stands on is in
    ``tracked`` before the run. Fills the rest of ``tracked[run]``. The result is the place of the first
    sample that :meth:`Estimator.good` must take, or the end of the run. Call :func:`take_run` with what is
    taken.
    """
    steady_run(estimator.tracker, tracked, run.start, run.stop, scratch)
    if estimator.lost or tracked.ok[run].all():
        return int(run.stop)
    return int(run.start + tracked.ok[run].argmin())


def take_run(
    estimator: Estimator, state: tuple[float, float, int, int], tracked: TrackResult, start: int, stop: int
) -> None:
    """Go on after the samples start..stop of a run that :func:`follow_run` began; none are possible.

    ``state`` is that of the tracker before the run.
    """
    tracker = estimator.tracker
    if stop == start:
        tracker.set_state(*state)
    else:
        before, last = tracked.cycles[stop - 2 : stop].tolist()
        phase_before, phase = tracked.phase[stop - 2 : stop].tolist()
        tracker.set_state(phase_before, phase, last, last - before)
    if stop > start and not estimator.lost:
        new = slice(max(start, stop - REMEMBERED_SAMPLES), stop)
        counts, phases = tracked.cycles[new].tolist(), tracked.phase[new].tolist()
        estimator.places.extend((count, phase, 1.0) for count, phase in zip(counts, phases, strict=True))
