"""A bus and a clock without hardware and without waiting: time passes where the runner waits."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import can

from canfb.cia301.frame import Frame


class FakeClock:
    """Seconds that pass only when somebody waits."""

    def __init__(self) -> None:
        self.now = 1000.0
        self.slept: list[float] = []

    def __call__(self) -> float:
        return self.now

    def sleep(self, duration_s: float) -> None:
        self.slept.append(duration_s)
        self.now += duration_s


class FakeBus:
    """What comes from it is planned, as (seconds from the start, message or error); what is sent is kept."""

    def __init__(self, clock: FakeClock, plan: Sequence[tuple[float, can.Message | Exception]] = ()) -> None:
        self.clock = clock
        self.start = clock.now
        self.plan = list(plan)
        self.sent: list[tuple[float, can.Message]] = []
        self.waits: list[float] = []
        self.end_s = float("inf")
        self.refuse: Callable[[float], Exception | None] = lambda at: None

    @property
    def at(self) -> float:
        """Seconds since the start, rounded to what a plan is written in."""
        return round(self.clock.now - self.start, 9)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        assert timeout is not None
        assert timeout >= 0.0
        self.waits.append(timeout)
        if self.plan and self.plan[0][0] <= min(self.at + timeout, self.end_s):
            due, item = self.plan.pop(0)
            self.clock.now = max(self.clock.now, self.start + due)
            if isinstance(item, Exception):
                raise item
            return item
        self.clock.now = min(self.clock.now + timeout, self.start + self.end_s)
        return None

    def send(self, message: can.Message) -> None:
        error = self.refuse(self.at)
        if error is not None:
            raise error
        self.sent.append((self.at, message))

    def sent_ids(self) -> list[int]:
        return [message.arbitration_id for _, message in self.sent]


@dataclass
class FakeDevice:
    """Notes what it is asked; answers and ticks as it is told."""

    clock: FakeClock
    period_s: float | None = None
    answer: Callable[[Frame], list[Frame]] = lambda frame: []
    tick_id: int = 0x080
    boot: tuple[Frame, ...] = ()
    heard: list[tuple[float, Frame]] = field(default_factory=list)
    ticked: list[float] = field(default_factory=list)
    next_s: float | None = None

    def start(self, now: float) -> list[Frame]:
        self.next_s = None if self.period_s is None else now + self.period_s
        return list(self.boot)

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        assert now == self.clock.now
        self.heard.append((now, frame))
        return self.answer(frame)

    def tick(self, now: float) -> list[Frame]:
        assert self.next_s is not None
        assert self.period_s is not None
        assert now >= self.next_s, "never early"
        self.ticked.append(now - self.next_s)
        self.next_s += self.period_s
        return [Frame(self.tick_id, b"")]

    def deadline(self) -> float | None:
        return self.next_s

    def heard_ids(self) -> list[int]:
        return [frame.can_id for _, frame in self.heard]


def message(can_id: int, data: bytes = b"", **rest: object) -> can.Message:
    return can.Message(arbitration_id=can_id, data=data, is_extended_id=False, **rest)  # type: ignore[arg-type]
