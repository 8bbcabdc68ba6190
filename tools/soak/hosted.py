"""A device in the runner of `canfb run`, in simulated time, with the effects of process, socket and clock.

The runner waits for its bus; here the wait ends when the embedded bus has a frame for it, or at its time-out.
So it needs its own thread; only one of the two threads runs at a time, so that every run is identical.
"""

import errno
import math
import os
import threading
from collections import deque
from collections.abc import Callable, Iterable
from typing import Self

from canfb.bus.bus_state import ERROR_BUS_OFF, ERROR_RESTARTED
from canfb.bus.frame_bus import ERROR, REMOTE, Received
from canfb.bus.runner import Runner
from canfb.cia301.frame import Frame
from canfb.device.core import NEVER
from canfb.device.node import Device

SOCKET_FRAMES = 270  # capacity of a socket of Linux by default, 212 992 bytes; further frames are lost
WALL_S = 1.7e9
LONGEST_TURN_S = 60.0  # real time from one wait of the runner to the next


class Hosted:
    """A device for the embedded bus that contains another device in a runner.

    stalled_until_s  the process does not run until then; frames wait in its socket
    set_s            offset of the wall clock, which gives the time stamps of frames
    """

    def __init__(self, device: Device, report: Callable[[str], None]) -> None:
        self.stalled_until_s = -math.inf
        self.set_s = 0.0
        self.bus = Socket(self._wait_for_frames, self._wall)
        self._now = 0.0
        self._wake_s = math.inf
        self._reading = False
        self.runner = Runner(
            self.bus,
            [device],
            report=report,
            clock=lambda: self._now,
            sleep=lambda seconds: self._park(self._now + seconds),
            wall=self._wall,
        )
        self._world_runs, self._runner_runs = threading.Semaphore(0), threading.Semaphore(0)
        self._ended_by: BaseException | None = None
        self._thread = threading.Thread(target=self._run, daemon=True)

    def close(self) -> None:
        self.runner.stop()
        if self._thread.is_alive():
            self._go_on()

    def start(self, now: float) -> list[Frame]:
        self._thread.start()
        return self.tick(now)

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        self._now = now
        return self._wake(now) if self.bus.put(frame.can_id | REMOTE * frame.rtr, frame.data) else []

    def deadline(self) -> float:
        return max(self._wake_s, self.stalled_until_s)

    def tick(self, now: float, until: float = NEVER) -> list[Frame]:
        self._now = now
        if min(now, until) < self.stalled_until_s:
            return []
        self._go_on()
        return self.bus.taken()

    def down(self, now: float) -> list[Frame]:
        """`ip link set can0 down`: frames in the socket are kept."""
        self.bus.down = True
        return self._wake(now)

    def bus_off(self, now: float) -> list[Frame]:
        return self._error(ERROR_BUS_OFF, now)

    def bus_back(self, now: float) -> list[Frame]:
        self.bus.down = False
        return self._error(ERROR_RESTARTED, now)

    def _error(self, error: int, now: float) -> list[Frame]:
        self._now = now
        self.bus.keep(ERROR | error)
        return self._wake(now)

    def _wake(self, now: float) -> list[Frame]:
        return self.tick(now) if self._reading else []

    def _wall(self) -> float:
        return WALL_S + self._now + self.set_s

    def _wait_for_frames(self, wait_s: float) -> None:
        self._reading = True
        self._park(self._now + wait_s)
        self._reading = False

    def _park(self, until_s: float) -> None:
        self._wake_s = until_s
        self._world_runs.release()
        self._runner_runs.acquire()

    def _go_on(self) -> None:
        """Let the runner run until it waits again. Raises the exception that ended it."""
        self._runner_runs.release()
        if not self._world_runs.acquire(timeout=LONGEST_TURN_S):
            raise TimeoutError("the runner does not come back to its bus")
        if self._ended_by is not None:
            raise self._ended_by

    def _run(self) -> None:
        self._runner_runs.acquire()
        try:
            self.runner.run()
        except BaseException as error:
            self._ended_by = error
        self._world_runs.release()


class Socket:
    """The bus of the runner; ``full``: the queue of the interface accepts no frame."""

    def __init__(self, wait: Callable[[float], None], wall: Callable[[], float]) -> None:
        self.full = self.down = False
        self._wait, self._wall = wait, wall
        self._waiting: deque[Received] = deque()
        self._sent: list[Frame] = []
        self._heard: frozenset[int] | None = None

    def put(self, can_id: int, data: bytes) -> bool:
        """A frame arrives; False if it is filtered or lost."""
        if self.down or (self._heard is not None and can_id & ~REMOTE not in self._heard):
            return False
        return self.keep(can_id, data)

    def keep(self, can_id: int, data: bytes = bytes(8)) -> bool:
        """Queue a frame; False if the queue is full."""
        if len(self._waiting) < SOCKET_FRAMES:
            self._waiting.append((can_id, data, self._wall()))
            return True
        return False

    def taken(self) -> list[Frame]:
        sent, self._sent = self._sent, []
        return sent

    def receive(self, wait_s: float) -> Received | None:
        if wait_s > 0.0 and not self._waiting and not self.down:
            self._wait(wait_s)
        self._fail_if_down()
        return self._waiting.popleft() if self._waiting else None

    def send(self, can_id: int, data: bytes, remote: bool) -> bool:
        self._fail_if_down()
        if not self.full:
            self._sent.append(Frame(can_id, data, remote))
        return not self.full

    def _fail_if_down(self) -> None:
        if self.down:
            raise OSError(errno.ENETDOWN, os.strerror(errno.ENETDOWN))

    def accept(self, can_ids: Iterable[int] | None, remote_can_ids: Iterable[int]) -> None:
        self._heard = None if can_ids is None else frozenset((*can_ids, *remote_can_ids))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *raised: object) -> None:
        """Nothing to close."""
