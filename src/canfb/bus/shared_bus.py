"""One bus for several users in a process."""

from __future__ import annotations

import contextlib
import queue
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor

import can

from canfb.cia301 import cob

# Client command specifiers that do not download: upload, segments, abort, block (CiA 301, 7.2.4.3).
READING = (2, 3, 4, 5)
SDO_BYTES = 8
Item = can.Message | Exception


def only_reads(message: can.Message) -> bool:
    data, node = message.data, message.arbitration_id - cob.SDO_REQUEST
    classic = not (message.is_extended_id or message.is_remote_frame or message.is_fd)
    return classic and 1 <= node <= 127 and len(data) == SDO_BYTES and data[0] >> 5 in READING


class SharedBus(can.BusABC):
    """``bus``, received by one thread; each :meth:`branch` gets all frames.

    It sends SDO uploads; can.CanOperationError for any other frame.
    """

    def __init__(self, bus: can.BusABC) -> None:
        self.under = bus
        self._branches: list[_Branch] = []
        self._sending = threading.Lock()
        super().__init__(channel="")
        self.channel_info = bus.channel_info

    def branch(self) -> can.BusABC:
        """A bus for another thread; its shutdown leaves the other branches open."""
        branch = _Branch(self)
        self._branches.append(branch)
        return branch

    def release(self, branch: can.BusABC) -> None:
        self._branches = [one for one in self._branches if one is not branch]

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        if not only_reads(msg):
            raise can.CanOperationError("this bus is for reading: it sends SDO uploads alone")
        with self._sending:
            self.under.send(msg, timeout)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        try:
            message = self.under.recv(timeout)
        except Exception as error:
            self._hand_on(error)
            raise
        if message is not None:
            self._hand_on(message)
        return message, False

    def _hand_on(self, item: Item) -> None:
        for branch in self._branches:
            branch.take(item)

    def shutdown(self) -> None:
        super().shutdown()
        self.under.shutdown()


class _Branch(can.BusABC):
    def __init__(self, shared: SharedBus) -> None:
        self._shared = shared
        self._items: queue.SimpleQueue[Item] = queue.SimpleQueue()
        super().__init__(channel="")
        self.channel_info = shared.channel_info

    def take(self, item: Item) -> None:
        if isinstance(item, Exception) or self._matches_filters(item):
            self._items.put(item)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self._shared.send(msg, timeout)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        try:
            item = self._items.get(timeout=timeout)
        except queue.Empty:
            return None, False
        if isinstance(item, Exception):
            raise item
        return item, False

    def shutdown(self) -> None:
        super().shutdown()
        self._shared.release(self)


@contextlib.contextmanager
def beside(work: Callable[[], None], stop: Callable[[], None], failed: Callable[[], None]) -> Iterator[None]:
    """Run ``work`` in a thread during the context; ``stop`` ends it.

    If it raises, ``failed`` is called at once, and the exception is raised at the end.
    """
    with ThreadPoolExecutor(1, "canfb listening") as threads:
        future = threads.submit(work)
        future.add_done_callback(lambda done: failed() if done.exception() else None)
        try:
            yield
        finally:
            stop()
    future.result()
