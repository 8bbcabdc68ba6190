"""The SYNC of a simulated machine: it comes when those have answered that answer."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import pytest
from sync import SYNC, WaitingSync

PATIENCE_S = 60.0


class Answers:
    """A network whose nodes answer each SYNC as they are asked to."""

    def __init__(self, answer: Callable[[Answers, int], None]) -> None:
        self.hearers: dict[int, Callable[[int, bytes, float], None]] = {}
        self.syncs = 0
        self._answer = answer

    def subscribe(self, can_id: int, hear: Callable[[int, bytes, float], None]) -> None:
        self.hearers[can_id] = hear

    def unsubscribe(self, can_id: int, hear: Callable[[int, bytes, float], None]) -> None:
        assert self.hearers.pop(can_id) == hear

    def send_message(self, can_id: int, data: bytes) -> None:
        assert (can_id, data) == (SYNC, b"")
        self.syncs += 1
        self._answer(self, self.syncs)

    def hear(self, *can_ids: int) -> None:
        """The answers arrive, in the receiving thread."""
        for can_id in can_ids:
            threading.Thread(target=self.hearers[can_id], args=(can_id, b"", 0.0)).start()


def started(answer: Callable[[Answers, int], None], longest_s: float) -> tuple[Answers, WaitingSync]:
    network = Answers(answer)
    unseen: Any = network
    sync = WaitingSync(unseen, 1e-4, longest_s, [0x1A0, 0x1B0])
    sync.start()
    return network, sync


def test_the_next_one_waits_for_a_late_answer() -> None:
    held = threading.Event()

    def answer(network: Answers, number: int) -> None:
        network.hear(0x1A0, *(() if number == 9 else (0x1B0,)))
        if number == 9:
            held.set()

    network, sync = started(answer, 4.0)
    assert held.wait(PATIENCE_S)
    sync.join(0.05)  # many periods
    assert network.syncs == 9, "one has not answered"
    network.hear(0x1B0)
    while network.syncs < 12:
        assert sync.is_alive()
    sync.stop()
    assert not network.hearers


@pytest.mark.parametrize("until", [9, 0])
def test_who_has_gone_is_waited_for_once_and_nobody_who_answers_not_at_all(until: int) -> None:
    reached = threading.Event()

    def answer(network: Answers, number: int) -> None:
        if until:
            network.hear(*((0x1A0, 0x1B0) if number <= until else (0x1A0,)))
        if number == 50:
            reached.set()

    _, sync = started(answer, 0.4)
    assert reached.wait(PATIENCE_S)
    sync.stop()


def test_a_bus_that_fails_ends_it() -> None:
    def answer(network: Answers, number: int) -> None:
        raise OSError("Network is down")

    _, sync = started(answer, PATIENCE_S)
    sync.join(PATIENCE_S)
    assert not sync.is_alive()
    sync.stop()
