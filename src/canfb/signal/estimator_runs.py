"""An estimator on arrays, where nothing is in doubt, and what takes its place when the order changes."""

from __future__ import annotations

from canfb.objects import LossCause
from canfb.signal import speeds
from canfb.signal.blocks import Scratch
from canfb.signal.declared import Declared
from canfb.signal.estimator import REMEMBERED_SAMPLES, Estimator
from canfb.signal.third_order import SECOND, ThirdOrderTracker
from canfb.signal.tracker import TrackResult
from canfb.signal.tracking import predicts_by_parabola, steady_run


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
    estimator: Estimator, state: tuple[float | int, ...], tracked: TrackResult, start: int, stop: int
) -> None:
    """Go on after the samples start..stop of a run that :func:`follow_run` began; none are possible.

    ``state`` is the tracker's snapshot before the run.
    """
    tracker = estimator.tracker
    by_parabola = predicts_by_parabola(tracker)
    if stop - start < 1 + by_parabola:
        tracker.restore(state)
        for phase in tracked.phase[start:stop].tolist():
            tracker.advance(phase)
    else:
        counts = tracked.cycles[stop - 2 - by_parabola : stop].tolist()
        *before, phase_before, phase = tracked.phase[stop - 2 - by_parabola : stop].tolist()
        step = counts[-1] - counts[-2]
        if isinstance(tracker, ThirdOrderTracker) and by_parabola:
            bend = step - (counts[-2] - counts[-3])
            tracker.set_full_state(before[0], phase_before, phase, counts[-1], step, bend)
        else:
            tracker.set_state(phase_before, phase, counts[-1], step)
    if stop > start and not estimator.lost:
        new = slice(max(start, stop - REMEMBERED_SAMPLES), stop)
        counts, phases = tracked.cycles[new].tolist(), tracked.phase[new].tolist()
        estimator.places.extend((count, phase, 1.0) for count, phase in zip(counts, phases, strict=True))


def successor(old: Estimator, declared: Declared) -> Estimator:
    """An estimator of another order that goes on where ``old`` is.

    The position is lost if it was in doubt, or if eq. 9 is to follow an acceleration that is not below its
    limit: phases show accelerations up to whole cycles per interval squared only.
    """
    new = Estimator(declared)
    new.take_over(old)
    bend = abs(speeds.acceleration(old.places))
    too_fast = declared.order == SECOND and bend >= declared.residual_limit
    if not new.lost and (old.in_doubt or too_fast):
        new.lose(LossCause.CONFIGURATION)
    return new
