"""One episode: drawn, laid on the wire, played on the module, judged; and printed in full."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from canfb import Frame, StatusBit
from tools.faults.wire.classes import CLASSES, STALLS
from tools.faults.wire.draw import UNKNOWN_LIMIT, draw_plan, keep_regular, torque
from tools.faults.wire.host import STAMP_NOISE_S, Sent, drive
from tools.faults.wire.judge import ACCELERATION_ID, Judge, Verdict
from tools.faults.wire.line import Line, Plan, Slot, lay
from tools.faults.wire.physics import unseen
from tools.faults.wire.setups import EMCY_ID, NMT_ID, NODE, SETUPS, Bench

EVERY = CLASSES | STALLS
SHOWN_BEFORE = 6  # slots
GAUSSIAN, BLOCKED_US = 4.5, 135.0  # standard deviations: one of 150 000; a frame before a SYNC


class Episode(NamedTuple):
    fault: str
    setup: str
    seed: int

    def __str__(self) -> str:
        return ":".join(map(str, self))

    @classmethod
    def parse(cls, text: str) -> Episode:
        """CLASS:SETUP:SEED; ValueError if there is no such class or set-up."""
        name, setup, seed = text.rsplit(":", 2)
        if name not in EVERY or setup not in SETUPS:
            raise ValueError(f"there is no {name}:{setup}")
        return cls(name, setup, int(seed))


class Played(NamedTuple):
    plan: Plan
    line: Line
    sent: list[Sent]
    judge: Judge
    verdict: Verdict


_START = Frame(NMT_ID, bytes([1, NODE]))
_bench = Bench()


def plan_of(episode: Episode) -> Plan:
    wire_class, setup = EVERY[episode.fault], SETUPS[episode.setup]
    rng = np.random.default_rng([episode.seed, *episode.fault.encode(), *episode.setup.encode()])
    plan = draw_plan(setup, rng, wire_class.after, steady=wire_class.torque == 0.0)
    pushed = rng.uniform() < wire_class.torque
    wire_class.change(plan)
    if not plan.note:
        plan.note = unseen(plan)
    if pushed:
        torque(plan)
    keep_regular(plan)
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


def play_plan(plan: Plan, fresh: bool = False) -> Played:
    module = _bench.begin(plan.setup, plan.options, fresh)
    begin = _bench.now + 0.01
    module.receive(_START, _bench.now + 0.005)
    line = lay(plan)
    sent, _bench.now = drive(module, plan, line.events, begin)
    judge = Judge(plan, line)
    return Played(plan, line, sent, judge, judge.judge(sent))


def play(episode: Episode, fresh: bool = False, confirm: bool = True) -> Played:
    """Draw and play one episode; to ``confirm``, a wrong position counts on a module that is new only."""
    played = play_plan(plan_of(episode), fresh)
    if played.verdict.wrong and confirm and not fresh:
        return play(episode, fresh=True)
    return played


def trace(episode: Episode, every: bool) -> int:
    """Print one episode: what was planned, heard and sent; 1 if a valid position was wrong."""
    played = play(episode, fresh=True)
    plan = played.plan
    print(f"{episode}: {played.verdict.outcome}")
    print(f"  {plan.motion.speed(plan.fault):.3f} cycles/T in slot {plan.fault}, SYNC at {plan.fault + 1} T")
    for name, value in vars(plan).items():
        if name not in ("rng", "slots"):
            print(f"  {name}: {value}")
    healthy = vars(Slot())
    for number, slot in enumerate(plan.slots):
        changes = [f"{name}={value}" for name, value in vars(slot).items() if value != healthy[name]]
        if changes:
            print(f"  slot {number}: {', '.join(changes)}")
    if every:
        _print_frames(played)
    print(f"  {played.verdict}")
    return int(played.verdict.outcome == "wrong")


def _print_frames(played: Played) -> None:
    shown, tolerance = played.judge.shown, played.plan.tolerance
    strange = [one.now for one in shown if not one.valid or abs(one.error) > tolerance]
    begin = min([played.plan.fault, *strange[:1]]) - SHOWN_BEFORE
    lines = [
        (one.time, f"> {one.what} {one.number} {one.frame.data.hex() if one.frame else ''}")
        for one in played.line.events
    ]
    for one in shown:
        mark = "WRONG" if one.valid and abs(one.error) > tolerance else ""
        bits = StatusBit(one.status).name
        text = f"    {one.what} {one.position:.3f} [{bits}] residual {one.residual:.3f}"
        lines.append((one.now, f"{text} error {one.error:+.3f} {mark}"))
    others = [sent for sent in played.sent if sent.frame.can_id in (EMCY_ID, ACCELERATION_ID)]
    lines += [(one.now, f"    {one.frame.can_id:03X} {one.frame.data.hex()}") for one in others]
    for at, text in sorted(lines, key=lambda line: line[0]):
        if at >= begin:
            print(f"  {at:9.3f} {text}")
