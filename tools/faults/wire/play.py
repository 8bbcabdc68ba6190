"""One episode: drawn, converted to frames, played on the module, judged; and printed in full.

The process of the module sleeps until a frame arrives or a deadline is due, wakes up late, processes all
waiting frames, and then checks its deadline. Frames keep their order.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from canfb import FeedbackModule, ModuleConfig, StatusBit
from tools.faults.wire.classes import CLASSES, STALLS
from tools.faults.wire.draw import UNKNOWN_LIMIT, draw_plan, keep_regular, torque
from tools.faults.wire.judge import ACCELERATION_ID, Judge, Verdict
from tools.faults.wire.line import Event, Line, Plan, Sent, Slot, lay
from tools.faults.wire.physics import unseen
from tools.faults.wire.setups import EMCY_ID, INTERFACE, NODE, SETUPS, set_up

START_S = 100.0
PER_FRAME_S = 8e-6
STAMP_NOISE_S = 30e-6
ENDLESS = 1000  # successive ticks without progress that end an episode
EVERY = CLASSES | STALLS
SHOWN_BEFORE = 6  # slots before the fault that are printed
GAUSSIAN, BLOCKED_US = 4.5, 135.0  # standard deviations (exceeded by one in 150 000); longest wait of a SYNC
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
    """Errors of the receive times, seconds."""
    noise = plan.rng.uniform(0.0, STAMP_NOISE_S, count)
    if plan.bad_rx:
        bad = np.where(plan.rng.integers(2, size=count) == 0, 9e-4, plan.rng.normal(0.0, 1.0, count))
        noise = np.where(plan.rng.uniform(size=count) < plan.bad_rx, bad, noise)
    errors_s: list[float] = noise.tolist()
    return errors_s


def drive(module: FeedbackModule, plan: Plan, events: list[Event], begin_s: float) -> list[Sent]:
    """Process the events by the module; returns the frames that it sends."""
    interval_s, rng, stamps = plan.options.interval_s, plan.rng, plan.setup.stamps
    latency = latencies_s(plan.host, rng)
    noise = _noise(plan, len(events)) if stamps else []
    stalls = [(begin_s + a * interval_s, begin_s + b * interval_s) for a, b in plan.stalls]
    end_s = begin_s + plan.end * interval_s
    sent: list[Sent] = []
    times = [begin_s + event.time * interval_s for event in events]
    at, count, now, stuck = 0, len(events), begin_s, 0
    # A sample is received with its last part, or at the SYNC that takes over a synchronous RPDO.
    last_part = "extra" if plan.options.extra or plan.options.coarse else "pdo"
    if plan.options.rpdo_type == 1:
        last_part = "sync"
    newest = tracks = -1
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
                tracks = event.number if event.what == "pdo" else tracks
                if event.what == last_part and (last_part == "sync" or event.number == tracks):
                    newest = max(newest, tracks)
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
            break  # no further events
        if due is not None and due <= now:
            elapsed = (now - begin_s) / interval_s
            sent += [Sent(elapsed, None, one, newest) for one in module.tick(now)]
            stuck += 1
            if stuck > ENDLESS:
                raise RuntimeError(f"tick({now}) does not move its deadline {due}")
    return sent


class Episode(NamedTuple):
    fault: str
    setup: str
    seed: int

    def __str__(self) -> str:
        return ":".join(map(str, self))

    @classmethod
    def parse(cls, text: str) -> Episode:
        """The episode CLASS:SETUP:SEED; ValueError for an unknown class or set-up."""
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


def plan_of(episode: Episode) -> Plan:
    wire_class, setup = EVERY[episode.fault], SETUPS[episode.setup]
    rng = np.random.default_rng([episode.seed, *episode.fault.encode(), *episode.setup.encode()])
    plan = draw_plan(setup, rng, wire_class.after, steady=wire_class.torque == 0.0)
    pushed = rng.uniform() < wire_class.torque
    wire_class.change(plan)
    if not plan.note:
        plan.note = unseen(plan)
    if pushed and not plan.actions:  # motion that begins in a pause is undetectable
        torque(plan)
    keep_regular(plan)
    if not setup.servo:
        declare(plan)
    plan.options.jitter_s = jitter_s(plan)
    return plan


def declare(plan: Plan) -> None:
    """Raise 2010:02, or if it is not set 2010:0B, to the acceleration of the machine."""
    largest = plan.motion.largest_acceleration(plan.end)
    if largest > (plan.options.limit or UNKNOWN_LIMIT):
        plan.options.limit = largest


def jitter_s(plan: Plan) -> float:
    """2010:0D: jitter of the wire, and noise of a receive time."""
    blocked_us = BLOCKED_US if plan.busy and (plan.jitter_us or plan.locked) else 0.0
    return 1e-6 * (plan.jitter_us * (GAUSSIAN if plan.gaussian else 1.0) + blocked_us) + STAMP_NOISE_S


def play(episode: Episode) -> Played:
    """Draw and play one episode, on a new module."""
    plan = plan_of(episode)
    module = FeedbackModule(ModuleConfig(node_id=NODE, encoder_interface=INTERFACE))
    module.start(START_S)
    begin_s = set_up(module, plan.setup, plan.options, START_S)
    line = lay(plan)
    sent = drive(module, plan, line.events, begin_s)
    judge = Judge(plan, line)
    return Played(plan, line, sent, judge, judge.judge(sent))


def trace(episode: Episode, every: bool) -> int:
    """Print one episode: plan, frames received and sent; 1 if a valid position was wrong."""
    played = play(episode)
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
