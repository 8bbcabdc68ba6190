"""The host of the module: when it gets to run, and what the module sends then.

The process sleeps until a frame arrives or a deadline is due, wakes up late, takes all frames that wait,
and then looks at its deadline. Frames keep their order.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from canfb import FeedbackModule, Frame
from tools.faults.wire.line import Event, Plan

PER_FRAME_S = 8e-6
STAMP_NOISE_S = 30e-6
ENDLESS = 1000  # ticks in a row without progress


class Sent(NamedTuple):
    now: float  # T
    cause: Event | None  # None: a timer
    frame: Frame
    newest: int  # number of the newest sample that the module has heard; -1: none


BLOCK = 256
LATENCIES_S: dict[str, Callable[[np.random.Generator], npt.NDArray[np.float64]]] = {
    "quick": lambda rng: rng.uniform(10e-6, 80e-6, BLOCK),
    "late": lambda rng: np.minimum(rng.exponential(0.7e-3, BLOCK), 5e-3),  # under load
}
"""How late the process wakes up."""


def latencies_s(host: str, rng: np.random.Generator) -> Iterator[float]:
    while True:
        yield from reversed(LATENCIES_S[host](rng).tolist())


def _noise(plan: Plan, count: int) -> list[float]:
    """What is wrong with each receive time, seconds."""
    noise = plan.rng.uniform(0.0, STAMP_NOISE_S, count)
    if plan.bad_rx:
        bad = np.where(plan.rng.integers(2, size=count) == 0, 9e-4, plan.rng.normal(0.0, 1.0, count))
        noise = np.where(plan.rng.uniform(size=count) < plan.bad_rx, bad, noise)
    errors_s: list[float] = noise.tolist()
    return errors_s


def drive(
    module: FeedbackModule, plan: Plan, events: list[Event], begin_s: float
) -> tuple[list[Sent], float]:
    """Run the module over the events; what it sent, and the time of the end, seconds."""
    interval_s, rng, stamps = plan.options.interval_s, plan.rng, plan.setup.stamps
    latency = latencies_s(plan.host, rng)
    noise = _noise(plan, len(events)) if stamps else []
    stalls = [(begin_s + a * interval_s, begin_s + b * interval_s) for a, b in plan.stalls]
    end_s = begin_s + plan.end * interval_s
    sent: list[Sent] = []
    times = [begin_s + event.time * interval_s for event in events]
    at, count, now, stuck = 0, len(events), begin_s, 0
    newest = -1
    while True:
        due = module.deadline()
        trigger = min(times[at] if at < count else end_s, math.inf if due is None else due)
        if trigger >= end_s:
            break
        wake = max(trigger, now) + next(latency)
        for begin, end in stalls:
            if begin <= wake < end:
                wake = end
        now = wake
        while at < count and times[at] <= now:
            event = events[at]
            frame = event.frame
            if frame is not None:
                if stamps:
                    frame = frame._replace(timestamp=min(times[at] + noise[at], now))
                if event.what == "pdo" and event.number > newest:
                    newest = event.number
                out = module.receive(frame, now)
            else:
                out = module.bus_off(now) if event.what == "bus_off" else module.bus_back(now)
            if out:
                elapsed = (now - begin_s) / interval_s
                sent += [Sent(elapsed, event, one, newest) for one in out]
            now += PER_FRAME_S
            at += 1
            stuck = 0
        due = module.deadline()
        if now >= end_s:
            break  # nothing comes any more
        if due is not None and due <= now:
            elapsed = (now - begin_s) / interval_s
            sent += [Sent(elapsed, None, one, newest) for one in module.tick(now)]
            stuck += 1
            if stuck > ENDLESS:
                raise RuntimeError(f"tick({now}) does not move its deadline {due}")
    return sent, max(now, end_s)
