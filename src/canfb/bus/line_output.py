"""Output of lines to a slow reader: no SYNC cycle waits for a terminal or a pipe."""

from __future__ import annotations

import errno
import os
import select
from collections import deque
from collections.abc import Callable

MOST_LINES = 1000
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


class LineOutput:
    """Writes lines to ``descriptor`` as far as it accepts them; up to MOST_LINES wait, also for a full disk.

    ``excuse`` gives the line that replaces dropped ones. OSError as of write(2), for a full disk at the end.
    """

    def __init__(self, descriptor: int, excuse: Callable[[int], str], encoding: str = "utf-8") -> None:
        self._descriptor = descriptor
        self._excuse = excuse
        self._encoding = encoding
        self._waiting: deque[bytes] = deque()
        self._left_out = 0

    def put(self, line: str) -> None:
        if len(self._waiting) < MOST_LINES:
            self._keep(line)
        else:
            self._left_out += 1
        self.flush()

    def flush(self, wait_s: float = 0.0) -> None:
        while self._waiting:
            if not select.select([], [self._descriptor], [], wait_s)[1]:
                return
            line = self._waiting[0]
            try:
                written = os.write(self._descriptor, line[: select.PIPE_BUF])  # does not block up to PIPE_BUF
            except OSError as error:
                if wait_s > 0.0 or error.errno not in FULL:
                    raise
                return
            if written < len(line):
                self._waiting[0] = line[written:]
            else:
                self._waiting.popleft()
            if self._left_out and not self._waiting:
                left_out, self._left_out = self._left_out, 0
                self._keep(self._excuse(left_out))

    def _keep(self, line: str) -> None:
        self._waiting.append(f"{line}\n".encode(self._encoding, "backslashreplace"))
