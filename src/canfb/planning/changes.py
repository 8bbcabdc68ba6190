"""Changes of a plan: what a proposal does to its modules."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

from canfb import objects as od
from canfb.module.parameters import LIMIT_UNITS
from canfb.planning.planned_module import PlannedModule
from canfb.planning.situation import Situation
from canfb.signal.third_order import THIRD


@dataclass(frozen=True)
class Remedy:
    """One change.

    for_what     what it widens
    text         what to do, one line
    situation    what is planned then
    """

    for_what: str
    text: str
    situation: Situation


NOISE_MARGIN = 6  # docs/faults.md

Proposals = Iterator[tuple[str, Situation]]


def each(situation: Situation, change: Callable[[PlannedModule], PlannedModule]) -> Situation:
    """The same change of every module."""
    return replace(situation, modules=tuple(change(module) for module in situation.modules))


def knowing(module: PlannedModule, acceleration_rad_s2: float) -> PlannedModule:
    """With 2010:02."""
    return module.with_values({od.SUPERVISION_ACCELERATION: acceleration_rad_s2})


def limited(module: PlannedModule, limit_cycles: float) -> PlannedModule:
    """With 2010:01."""
    return module.with_values({od.SUPERVISION_RESIDUAL_LIMIT: int(limit_cycles * LIMIT_UNITS)})


def rounded_limit(cycles: float) -> float:
    """A limit above ``cycles``, in thousandths: 2010:01 rounds down by 1/65536."""
    return math.floor(min(cycles, 1.0) * 1000.0 + 1.1) / 1000.0


def with_table(module: PlannedModule) -> PlannedModule:
    """With a correction table."""
    return replace(module, has_table=True)


def knowing_jerk(module: PlannedModule, jerk_rad_s3: float) -> PlannedModule:
    """With 2010:08."""
    return module.with_values({od.SUPERVISION_JERK: jerk_rad_s3})


def noise_margined(module: PlannedModule) -> PlannedModule:
    """With 2010:09 = 6, where nothing else is set."""
    return module if module.noise_margin else module.with_values({od.SUPERVISION_NOISE_MARGIN: NOISE_MARGIN})


def with_samples(situation: Situation, per_sync: int) -> tuple[str, Situation] | None:
    """At least ``per_sync`` samples for each SYNC of every module, and the cost; None: no RPDO is left."""
    try:
        after = each(situation, lambda module: module.with_samples(max(per_sync, module.samples_per_sync)))
    except ValueError:
        return None
    old, new = situation.bus, after.bus
    more = sum(one.sample_bytes for one in after.modules) - sum(one.sample_bytes for one in situation.modules)
    percent = 100.0 * (new.load - old.load)
    cost = f"{more} bytes more for each SYNC, bus load +{percent:.1f} %"
    words = {2: "two", 3: "three", 4: "four"}[per_sync]
    return f"send {words} samples for each SYNC (samples_per_sync: {per_sync}; {cost})", after


def third_order(module: PlannedModule) -> PlannedModule:
    """With 2010:07 = 3."""
    return module.with_values({od.SUPERVISION_ORDER: THIRD})
