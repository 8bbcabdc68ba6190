"""A store that is written in a thread of its own: no SYNC waits for the disk."""

from __future__ import annotations

import sys
import threading
from collections import deque
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType
from typing import Self

from canfb.device.storage.image import ParameterGroup
from canfb.device.storage.writing import Changes, Store

SWITCH_S = 2e-4
"""How long a thread may keep the interpreter from the one that serves the bus, seconds; 5 ms are usual.
System calls of some microseconds give it back too soon for the other one to take it."""
STACK_BYTES = 1 << 18  # of the thread; a locked memory would hold all of the usual 8 MB


class ThreadedStore:
    """``store``, written in one thread, a change after the other: a ``BackgroundStore`` of the device.

    The thread begins here, so that a save needs no new one, and waits in system calls of the disk nearly all
    of its time. :meth:`close`, or the end of a ``with``, waits for what was begun.
    """

    def __init__(self, store: Store) -> None:
        self._store = store
        self._begun: deque[Future[OSError | None]] = deque()
        self._executor = ThreadPoolExecutor(1, "canfb-save")
        self._switch_s = sys.getswitchinterval()
        sys.setswitchinterval(min(SWITCH_S, self._switch_s))
        before = threading.stack_size(STACK_BYTES)
        try:
            self._executor.submit(int).result()
        finally:
            threading.stack_size(before)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Wait for what was begun, and end the thread."""
        self._executor.shutdown()
        sys.setswitchinterval(self._switch_s)

    def load(self) -> Mapping[ParameterGroup, bytes | OSError]:
        """What is kept, with all that was begun."""
        return self._executor.submit(self._store.load).result()

    def save(self, changes: Changes) -> None:
        """Keep ``changes`` behind those that were begun, and wait for it; OSError if that fails."""
        error = self._executor.submit(self._write, changes).result()
        if error is not None:
            raise error

    def begin(self, changes: Changes) -> None:
        """Begin to keep ``changes``, behind those that were begun."""
        self._begun.append(self._executor.submit(self._write, changes))

    def ended(self) -> list[OSError | None]:
        """What has ended since the last call, in order."""
        ended = []
        while self._begun and self._begun[0].done():
            ended.append(self._begun.popleft().result())
        return ended

    def _write(self, changes: Changes) -> OSError | None:
        try:
            self._store.save(changes)
        except OSError as error:
            return error
        return None
