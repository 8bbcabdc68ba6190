"""The judge of time alone on the wire of the campaign: are the true intervals among those that it gives?

    python -m tools.faults.wire.judged [--episodes N] [--class NAME] [--setup NAME] [--seed N]

Prints each class and set-up in which a sample was given intervals, certain and within its error, that are
not those of the wire; with the first of them. No position is computed: a wrong interval is a fault whether or
not the phases would show it. Cases of tools/faults/wire/README.md (P1, P3, P4, P7) are not taken out.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from fnmatch import fnmatch

from canfb import Frame
from canfb.timing.judge import Judge, Passed, Refusal
from canfb.timing.sync_verdict import SyncVerdict
from tools.faults.wire.classes import CLASSES
from tools.faults.wire.host import drive
from tools.faults.wire.line import Event, Line, Plan, lay
from tools.faults.wire.play import Episode, plan_of
from tools.faults.wire.setups import SETUPS

TOLERANCE = 0.3  # intervals: jitter is no matter of the judge
WHOLE = 0.5
REMEMBERED = 16  # samples, by the estimator
ANOTHER_RATE = 0.02


class JudgedModule:
    """In the place of a module: gives each frame to a judge, and compares."""

    def __init__(self, plan: Plan, line: Line) -> None:
        self._plan, self._line = plan, line
        self._events = iter(line.events)
        self.judge = judge = Judge()
        options = plan.options
        judge.syncs.overflow = options.overflow if plan.setup.counter else 0
        judge.syncs.clock.nominal_s = options.interval_s * options.period_factor if options.period else 0.0
        self.wrong: list[str] = []
        self._past: list[tuple[float, float, float]] = []  # given, true, error
        self._given = self._uncertain = 0.0
        self._set_true: float | None = None

    def deadline(self) -> float | None:
        """As of a module."""
        return None if self.judge.syncs.until == float("inf") else self.judge.syncs.until

    def tick(self, now: float) -> list[Frame]:
        """As of a module."""
        self.judge.syncs.overdue(now)
        return []

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        """As of a module; frames come in the order of the line."""
        event = next(self._events)
        stamped = frame.timestamp is not None
        time_s = now if frame.timestamp is None else frame.timestamp
        if event.what == "sync" and len(frame.data) == self._plan.setup.counter:
            self._sync(self.judge.syncs.sync(time_s, stamped, frame.data[0] if frame.data else None), event)
        elif event.what == "pdo":
            self._sample(self.judge.answer(time_s, stamped), event, stamped)
        return []

    def _forget(self) -> None:
        self._past, self._uncertain, self._set_true = [], 0.0, None

    def _sync(self, verdict: SyncVerdict, event: Event) -> None:
        if verdict.doubt:
            self._forget()
        if verdict.confirmed is not None and self._set_true is not None:
            if abs(verdict.confirmed - self._set_true) > WHOLE:
                self.wrong.append(f"{event.time:.2f} T: {verdict}, was {self._set_true:.3f}")
            self._set_true = None
        if not self.judge.syncs.is_open and abs(self._uncertain) > WHOLE:
            self.wrong.append(f"{event.time:.2f} T: not open any more, off by {self._uncertain:.3f}")
            self._uncertain = 0.0

    def _sample(self, passed: Passed | Refusal, event: Event, stamped: bool) -> None:
        judge = self.judge
        if isinstance(passed, Refusal):
            if passed is Refusal.ANOTHER and not judge.syncs.extra_came:
                self._forget()
            return
        interval_s = self._plan.options.interval_s
        ratio = (judge.syncs.clock.period_s or interval_s) / interval_s
        if abs(ratio - 1.0) > ANOTHER_RATE:
            self._forget()
        true, error = self._true(event, stamped), passed.instant_error
        if self._past:
            options = passed.options
            since = true - self._past[-1][1]
            taken = min((one for one in options), key=lambda one: abs(one - since))
            self._set_true = taken if len(options) > 1 else self._set_true
            if not passed.certain and abs(since - taken) > TOLERANCE + error:
                self._uncertain += since - taken
                taken = since
            self._given += taken
            off = max(
                abs(self._given - given - (true - then)) - error - other for given, then, other in self._past
            )
            if off > TOLERANCE:
                self.wrong.append(f"{event.time:.2f} T: {passed}, was {since:.3f}, off by {off:.3f}")
                self._forget()
        self._past = [*self._past[1 - REMEMBERED :], (self._given, true, error)]

    def _true(self, event: Event, stamped: bool) -> float:
        """The instant of the sample, T. Without receive times nothing shows more than its SYNC."""
        plan, line = self._plan, self._line
        slot = line.sample_slots[event.number]
        return slot + 1.0 + (plan.slots[slot].late_us * plan.us if stamped else 0.0)


def judged(episode: Episode) -> list[str]:
    """What was wrong in this episode, but for what the module does: NMT, SDO, bus-off."""
    plan = plan_of(episode)
    plan.actions, plan.reads = [], []
    line = lay(plan)
    module = JudgedModule(plan, line)
    drive(module, plan, line.events, 100.0)  # type: ignore[arg-type]
    return module.wrong


def main(argv: Sequence[str] | None = None) -> int:
    options = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    options.add_argument("--episodes", type=int, default=10, metavar="N", help="of each class and set-up")
    options.add_argument("--seed", type=int, default=0)
    options.add_argument("--class", dest="wire_class", default="*", metavar="NAME", help="with * and ?")
    options.add_argument("--setup", default="*", metavar="NAME", help="with * and ?")
    chosen = options.parse_args(argv)
    total = found = 0
    for number, wire_class in enumerate(CLASSES):
        for place, setup in enumerate(SETUPS):
            if (
                setup.servo
                or setup.times
                or not wire_class.of(setup)
                or not fnmatch(setup.name, chosen.setup)
            ):
                continue
            if not fnmatch(wire_class.name, chosen.wire_class):
                continue
            seeds = range(chosen.seed, chosen.seed + chosen.episodes)
            wrong = {seed: faults for seed in seeds if (faults := judged(Episode(number, place, seed)))}
            total, found = total + len(seeds), found + len(wrong)
            for seed, faults in list(wrong.items())[:1]:
                name = f"{wire_class.name}:{setup.name}"
                print(f"{name}: {len(wrong)} of {len(seeds)}; {seed}: {faults[0]}", flush=True)
    print(f"{found} of {total} episodes")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
