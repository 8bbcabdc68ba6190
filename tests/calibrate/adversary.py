"""A module that fails at the n-th SDO request of a tool, in every way in which a live node may fail."""

from __future__ import annotations

import copy
import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from canfb.cia301.frame import Frame
from canfb.device.storage.storage import MemoryStore
from canfb.errors import CanfbError
from canfb.module.device_configuration import configuration_of
from canfb.module.feedback_module import FeedbackModule
from canfb.signal.correction import Correction
from commissioning_kit import MODULE_ID, Bench
from node_commands import ANSWER, REQUEST, abort

RESET = Frame(0x000, bytes((0x81, MODULE_ID)))
DEAF_S = 0.5
EVERY = "CANFB_EVERY_REQUEST" in os.environ
"""At every single request, which takes minutes; else at some of them."""

Values = dict[tuple[int, int], Any]


class Adversary:
    """Between the bus and the module of a bench: ``fault`` happens at SDO request ``at``, from 1.

    refused, request lost, answer lost   this one request
    deaf                                 half a second without an SDO response
    reset, reset after                   before this request, or instead of the response
    killed, killed after                 the same, and it does not come back
    """

    FAULTS = (
        "refused",
        "request lost",
        "answer lost",
        "deaf",
        "reset",
        "reset after",
        "killed",
        "killed after",
    )

    def __init__(self, bench: Bench, fault: str = "", at: int = 0) -> None:
        self.requests = 0
        self.dead = False
        self._fault, self._at, self._deaf_until = fault, at, 0.0
        self._receive = bench.module.receive
        bench.module.receive = self.receive  # type: ignore[method-assign]

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        if self.dead:
            return []
        if frame.can_id != REQUEST:
            return self._receive(frame, now)
        self.requests += 1
        if now < self._deaf_until:
            return []
        return self._spoiled(frame, now) if self.requests == self._at else self._receive(frame, now)

    def _spoiled(self, frame: Frame, now: float) -> list[Frame]:
        fault = self._fault
        if fault == "refused":
            return abort(frame)
        if fault == "reset":
            return self._receive(RESET, now) + self._receive(frame, now)
        if fault == "deaf":
            self._deaf_until = now + DEAF_S
        self.dead = fault.startswith("killed")
        if fault.endswith(("after", "answer lost")):
            frames = [one for one in self._receive(frame, now) if one.can_id != ANSWER]
            return frames + self._receive(RESET, now) if fault == "reset after" else frames
        return []


@dataclass(frozen=True)
class Held:
    """What a module holds, and what it would hold after the power was off."""

    values: Values
    used: Correction
    saved_values: Values
    saved: Correction

    @classmethod
    def of(cls, bench: Bench) -> Held:
        again = FeedbackModule(bench.module.config, copy.deepcopy(bench.store))
        again.start(0.0)
        return cls(*_held(bench.module), *_held(again))

    @property
    def kept(self) -> tuple[Values, Correction]:
        """What the power does not take."""
        return self.saved_values, self.saved


def _held(module: FeedbackModule) -> tuple[Values, Correction]:
    return configuration_of(module).values(), module.chain.correction


@dataclass(frozen=True)
class Task:
    """A command with a module that it changes: ``prepare`` makes it, with all that it holds saved."""

    prepare: Callable[[], Bench]
    run: Callable[[Bench], object]

    def undisturbed(self) -> tuple[Held, int]:
        """What comes of it, and after how many SDO requests."""
        bench = self.prepare()
        adversary = Adversary(bench)
        self.run(bench)
        return Held.of(bench), adversary.requests

    def check(self, fault: str, at: int, wanted: Held) -> str:
        """The module is as before or as wanted, and the task says which: "" or why it has failed."""
        bench = self.prepare()
        assert isinstance(bench.store, MemoryStore)
        before = Held.of(bench)
        assert before.kept == (before.values, before.used)
        adversary = Adversary(bench, fault, at)
        said = ""
        try:
            self.run(bench)
        except CanfbError as error:
            said = str(error)
        assert adversary.requests >= at, "the fault came"
        assert "\n" not in said
        held = Held.of(bench)
        done = not said or said.startswith("done: ")
        if adversary.dead:
            assert "switch module 32 (20h) off and on" in said or "no answer" in said, said
            saved = [before.kept, wanted.kept] if "or the new values" in said else [before.kept]
            assert held.kept in ([wanted.kept] if done else saved), said
        else:
            assert "could not be put back" not in said
            assert held == (wanted if done else before), said
        return said


def requests(fault: str, last: int, step: int) -> range:
    """The requests of a task at which a fault is tried: each fault begins at another one."""
    return range(1, last + 1) if EVERY else range(1 + Adversary.FAULTS.index(fault), last + 1, step)
