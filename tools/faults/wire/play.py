"""One episode: drawn, laid on the wire, played on the module, judged."""

from __future__ import annotations

import os
from typing import NamedTuple

import numpy as np

from canfb import Frame
from tools.faults.wire.classes import CLASSES
from tools.faults.wire.draw import UNKNOWN_LIMIT, draw_plan, torque
from tools.faults.wire.host import STAMP_NOISE_S, Sent, drive
from tools.faults.wire.judge import Judge, Verdict
from tools.faults.wire.line import Line, Plan, lay
from tools.faults.wire.physics import unseen
from tools.faults.wire.setups import NMT_ID, NODE, SETUPS, Bench

GAUSSIAN, BLOCKED_US = 4.5, 135.0  # standard deviations: one of 150 000; a frame before a SYNC


class Episode(NamedTuple):
    """Which one; two of a name are the same in every run."""

    wire_class: int
    setup: int
    seed: int

    def __str__(self) -> str:
        return f"{CLASSES[self.wire_class].name}:{SETUPS[self.setup].name}:{self.seed}"

    @classmethod
    def parse(cls, text: str) -> Episode:
        """CLASS:SETUP:SEED; ValueError if there is no such class or set-up."""
        name, setup, seed = text.rsplit(":", 2)
        classes, setups = [one.name for one in CLASSES], [one.name for one in SETUPS]
        return cls(classes.index(name), setups.index(setup), int(seed))


class Played(NamedTuple):
    """All of one episode."""

    plan: Plan
    line: Line
    sent: list[Sent]
    judge: Judge
    verdict: Verdict


_START = Frame(NMT_ID, bytes([1, NODE]))
_bench = Bench()


def plan_of(episode: Episode) -> Plan:
    """The plan that this class, set-up and seed give."""
    wire_class, setup = CLASSES[episode.wire_class], SETUPS[episode.setup]
    name = wire_class.name.encode() + setup.name.encode()
    rng = np.random.default_rng(np.random.SeedSequence([episode.seed, *name]))
    plan = draw_plan(setup, rng, wire_class.after, steady=wire_class.torque == 0.0)
    pushed = rng.uniform() < wire_class.torque
    wire_class.change(plan)
    if not plan.note:
        plan.note = unseen(plan)
    if pushed:
        torque(plan)
    if not setup.servo:
        declare(plan)
    plan.options.jitter_s = jitter_s(plan)
    return plan


def declare(plan: Plan) -> None:
    """2010:02 is at least what the machine does; where it is not set, what 2010:0B assumes is."""
    largest = plan.motion.largest_acceleration(plan.end)
    if largest > (plan.options.limit or UNKNOWN_LIMIT):
        plan.options.limit = largest


def jitter_s(plan: Plan) -> float:
    """2010:0D: what the wire has, and the noise of a receive time."""
    blocked_us = BLOCKED_US if plan.busy and (plan.jitter_us or plan.locked) else 0.0
    return 1e-6 * (plan.jitter_us * (GAUSSIAN if plan.gaussian else 1.0) + blocked_us) + STAMP_NOISE_S


def play_plan(plan: Plan, fresh: bool = False, bench: Bench = _bench) -> Played:
    """Play a plan on a module."""
    module = bench.begin(plan.setup, plan.options, fresh or bool(os.environ.get("CANFB_FRESH")))
    begin = bench.now + 0.01
    module.receive(_START, bench.now + 0.005)
    line = lay(plan)
    sent, bench.now = drive(module, plan, line.events, begin)
    judge = Judge(plan, line)
    return Played(plan, line, sent, judge, judge.judge(sent))


def play(episode: Episode, fresh: bool = False, confirm: bool = True) -> Played:
    """Draw and play one episode; to ``confirm``, a wrong position counts on a module that is new only."""
    played = play_plan(plan_of(episode), fresh)
    if played.verdict.wrong and confirm and not fresh:
        return play(episode, fresh=True)
    return played
