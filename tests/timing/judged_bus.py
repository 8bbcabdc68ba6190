"""A bus with a known truth in front of the judge: what each frame was, and what the judge said of it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from canfb.timing.judge import Judge, Passed, Refusal

DELAY_S = 0.2  # periods from a SYNC to its PDO
SAME = 0.02  # interval
REMEMBERED = 16  # samples, by the estimator


@dataclass
class Slot:
    """One SYNC and its answer; times in periods."""

    late: float = 0.0
    to_module: bool = True
    to_interface: bool = True
    again: float = 0.0  # sent twice, so much later
    pdo_lost: bool = False
    pdo_late: float = 0.0
    produced: bool = True


@dataclass
class Bus:
    """SYNCs every ``period_s``; the frames reach the host at once, or after a stall."""

    slots: list[Slot]
    period_s: float = 1e-3
    stamped: bool = False
    overflow: int = 0
    nominal_s: float = 0.0
    jitter: float = 0.02  # periods
    latency: float = 0.02
    noise_s: float = 20e-6
    stalls: list[tuple[float, float]] = field(default_factory=list)
    seed: int = 1

    def frames(self) -> list[tuple[float, str, int, float, float]]:
        """(time on the bus, kind, slot, instant of the sample, how late it was sent again) in their order."""
        rng = np.random.default_rng(self.seed)
        jitter = rng.uniform(-self.jitter, self.jitter, len(self.slots)).tolist()
        frames = []
        for n, slot in enumerate(self.slots):
            if not slot.produced:
                continue
            at = n + 1.0 + jitter[n] + slot.late
            for instant in [at] + [at + slot.again] * (slot.again > 0.0):
                if slot.to_module:
                    frames.append((instant, "sync", n, instant, instant - at))
                if slot.to_interface and not slot.pdo_lost:
                    frames.append((instant + DELAY_S + slot.pdo_late, "pdo", n, instant, instant - at))
        return sorted(frames)

    def play(self, judge: Judge | None = None) -> Result:
        """All frames through a judge."""
        rng = np.random.default_rng(self.seed + 1)
        judge = judge or Judge()
        judge.syncs.overflow, judge.syncs.clock.nominal_s = self.overflow, self.nominal_s
        result = Result(judge, self.period_s)
        now, newest = 0.0, -1
        for at, kind, n, _, again in self.frames():
            now = max(now + 1e-5, at + float(rng.uniform(0.0, self.latency)))
            for begin, end in self.stalls:
                if begin <= now < end:
                    now = end
            time_s = 100.0 + now * self.period_s
            if self.stamped:
                noise = float(rng.uniform(0.0, self.noise_s))
                time_s = min(100.0 + at * self.period_s + noise, time_s)
            if kind == "sync":
                counter = n % self.overflow + 1 if self.overflow else None
                result.sync(judge.syncs.sync(time_s, self.stamped, counter), n)
                newest = n
            else:
                slot = self.slots[n]
                at_s = n + 1.0 + slot.late * self.stamped  # else nothing shows it
                at_s += slot.again * (again > 0)
                in_time_for_next = n < newest and judge.delay.is_usual(time_s - judge.syncs.synced_s)
                passed = judge.answer(time_s, self.stamped)
                if in_time_for_next and not isinstance(passed, Refusal):  # tools/faults/wire/README.md, P7
                    result.begin_again()
                else:
                    result.sample(passed, n, at_s)
        return result


@dataclass
class Result:
    """What the judge said, against the truth."""

    judge: Judge
    period_s: float
    wrong: list[str] = field(default_factory=list)
    used: list[int] = field(default_factory=list)
    verdicts: dict[int, object] = field(default_factory=dict)
    passed: dict[int, Passed] = field(default_factory=dict)
    doubts: list[int] = field(default_factory=list)
    sets: int = 0
    errors: dict[int, float] = field(default_factory=dict)
    _instant: float | None = None
    _open: float = 0.0  # intervals by which what was said while open is off
    _clock: float = 0.0
    _past: list[tuple[float, float, float]] = field(default_factory=list)
    _set_true: float | None = None  # of the last set

    @property
    def scale(self) -> float:
        """Where the rate of SYNC has changed, an interval is another one."""
        ratio = self.period_s / (self.judge.syncs.clock.period_s or self.period_s)
        return 1.0 if not self.judge.syncs.stamped or abs(ratio - 1.0) < 0.05 else ratio

    @property
    def same(self) -> float:
        """The usual jitter is not part of the error of an instant."""
        return SAME + 2.0 * self.judge.syncs.clock.jitter

    def sync(self, verdict: object, n: int) -> None:
        self.verdicts[n] = verdict
        if verdict.doubt:  # type: ignore[attr-defined]
            self.doubts.append(n)
            self.begin_again()
        if verdict.confirmed is not None and self._set_true is not None:  # type: ignore[attr-defined]
            if abs(verdict.confirmed - self._set_true) > SAME:  # type: ignore[attr-defined]
                self.wrong.append(f"SYNC {n}: confirmed {verdict}, was {self._set_true}")
            self._set_true = None
        if not (self.judge.syncs.is_open or self.judge.syncs._streak) and abs(self._open) > SAME:
            self.wrong.append(f"SYNC {n}: closed, off by {self._open}")
            self._open = 0.0

    def begin_again(self) -> None:
        """What comes from here on is compared."""
        self._open, self._set_true, self._instant = 0.0, None, None

    def sample(self, passed: Passed | Refusal, n: int, instant: float) -> None:
        """Compares with all of the samples that the estimator remembers."""
        if isinstance(passed, Refusal):
            return
        before, self._instant = self._instant, instant
        self.used.append(n)
        self.passed[n] = passed
        error = passed.instant_error
        if error:
            self.errors[n] = error
        if before is None:
            self._clock, self._past = 0.0, [(0.0, instant, error)]
            return
        true = (instant - before) * self.scale
        elapsed = passed.options
        taken = min(elapsed, key=lambda one: abs(true - one))
        if len(elapsed) > 1:
            self.sets += 1
            self._set_true = taken
        if not passed.certain and abs(true - taken) > SAME + error:
            self._open += true - taken
            taken = true
        self._clock += taken
        off = [
            abs(self._clock - clock - (instant - then) * self.scale) - error - other - self.same
            for clock, then, other in self._past
        ]
        if max(off) > 0.0:
            self.wrong.append(f"sample {n}: {passed}, was {true:.3f}, off by {max(off):.3f}")
            self._past = []
        self._past = [*self._past[1 - REMEMBERED :], (self._clock, instant, error)]
