"""The commands that speak to one node, on the bench in place of a bus; and what spoils their requests."""

import contextlib
import itertools
import struct
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from canfb.cia301.frame import Frame
from canfb.cli import node_options
from commands import Command, Said
from commissioning_kit import Bench

REQUEST, ANSWER = 0x620, 0x5A0
Spoil = Callable[[Frame], list[Frame] | None]


class Commands:
    """Runs `canfb ...` against a bench, and says what it said."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
        self._monkeypatch = monkeypatch
        self._command = Command(capsys)
        self.at_end: Callable[[], None] = lambda: None  # called while the bus is closed

    def __call__(self, bench: Bench, *arguments: Any, code: int = 0) -> Said:
        @contextlib.contextmanager
        def master_of(options: Any) -> Iterator[Any]:
            yield bench.master
            self.at_end()

        self._monkeypatch.setattr(node_options, "master_of", master_of)
        said = self._command("", *arguments, code=code)
        if code:
            assert said.err.count("\n") == 1, said.err
        return said


def place_of(frame: Frame) -> tuple[int, int]:
    """Index and sub-index of an initiating request."""
    index, subindex = struct.unpack_from("<HB", frame.data, 1)
    return index, subindex


def is_write(frame: Frame) -> bool:
    return frame.data[0] >> 5 in (1, 6)


def abort(frame: Frame, code: int = 0x08000000) -> list[Frame]:
    return [Frame(ANSWER, b"\x80" + frame.data[1:4] + struct.pack("<I", code))]


def between(bench: Bench, spoil: Spoil) -> None:
    """What ``spoil`` gives for an SDO request takes the place of the module's answer; None: as it is."""
    receive = bench.module.receive

    def spoiled(frame: Frame, now: float) -> list[Frame]:
        answer = spoil(frame) if frame.can_id == REQUEST else None
        return receive(frame, now) if answer is None else answer

    bench.module.receive = spoiled  # type: ignore[method-assign]


def refuse_once(bench: Bench, place: tuple[int, int], times: int = 1, answer: Spoil = abort) -> list[Frame]:
    """The module refuses the next writes of an object, or ``answer`` does; what it has refused."""
    refused: list[Frame] = []

    def spoil(frame: Frame) -> list[Frame] | None:
        if is_write(frame) and place_of(frame) == place and len(refused) < times:
            refused.append(frame)
            return answer(frame)
        return None

    between(bench, spoil)
    return refused


def interrupt(bench: Bench, at: int, error: type[BaseException] = KeyboardInterrupt) -> None:
    """Instead of sending the frame with this number, from 1, the master is interrupted."""
    send, numbers = bench.master.network.send_message, itertools.count(1)

    def interrupted(can_id: int, data: bytes, remote: bool = False) -> None:
        if next(numbers) == at:
            raise error
        send(can_id, data, remote)

    bench.master.network.send_message = interrupted  # type: ignore[method-assign]


def drop_answer(bench: Bench, place: tuple[int, int]) -> None:
    """The module takes the next write of an object, and its answer is lost."""
    receive = bench.module.receive
    refuse_once(bench, place, 1, lambda frame: receive(frame, bench.bus.now)[:0])
