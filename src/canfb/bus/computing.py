"""Long computations of a device, in a process of their own, so that no frame waits for them."""

from __future__ import annotations

import contextlib
import logging
import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from typing import IO, Any

from canfb.bus.compute_process import Inbox
from canfb.cia301.frame import Frame
from canfb.device.device_protocol import Computing

log = logging.getLogger(__name__)

COMMAND = (sys.executable, "-m", "canfb.bus.compute_process")
PIECE_BYTES = 1 << 16


class Computation:
    """The computations of one ``device``, one at a time. The process is started when one comes.

    A fresh process, not a fork nor a thread: a fork would take bus and memory along, a thread the
    time of the SYNC cycle. A process that ends without a result is reported to ``report``, and refuses
    the measurement. ``command`` is what is started, but for tests. It may use the processors that were ours
    when this was made.
    """

    def __init__(
        self,
        device: Computing,
        report: Callable[[str], None] = log.warning,
        command: tuple[str, ...] = COMMAND,
    ) -> None:
        self._device = device
        self._report = report
        self._command = command
        self._job: Any = None
        self._process: subprocess.Popen[bytes] | None = None
        self._killed: list[subprocess.Popen[bytes]] = []
        self._cpus = os.sched_getaffinity(0) if sys.platform == "linux" else set()

    def poll(self, now: float) -> list[Frame]:
        """Start, feed, read or end what there is, without waiting; the frames of the device."""
        if self._killed:
            self._killed = [process for process in self._killed if process.poll() is None]
        job = self._device.pending_job()
        if job is not self._job:
            self._kill()
            self._job = job
            if job is not None:
                try:
                    self._start(job)
                except Exception as error:  # no process, or a job that cannot be sent
                    return self._finish(error, now)
        if self._process is None:
            return []
        return self._exchange(self._process, now)

    def close(self) -> None:
        """Kill the process, if there is one, and wait for its end."""
        self._kill()
        for process in self._killed:
            process.wait()
        self._killed = []

    def _kill(self) -> None:
        process, self._process = self._process, None
        if process is None:
            return
        process.kill()
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                pipe.close()
        self._killed.append(process)

    def _start(self, job: Any) -> None:
        self._unsent = memoryview(pickle.dumps(job))
        self._inbox = Inbox()
        path = os.pathsep.join(folder or os.getcwd() for folder in sys.path)
        self._process = process = subprocess.Popen(
            self._command,
            bufsize=0,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "PYTHONPATH": path},
            start_new_session=True,  # Ctrl-C is for us; we end it
        )
        if sys.platform == "linux":  # not beside us, where `cpu` of `realtime:` keeps us
            with contextlib.suppress(OSError):  # it has ended, which its pipe says
                os.sched_setaffinity(process.pid, self._cpus)
        for pipe in (process.stdin, process.stdout):
            os.set_blocking(_number(pipe), False)

    def _exchange(self, process: subprocess.Popen[bytes], now: float) -> list[Frame]:
        self._feed(process)
        try:
            ended = self._read(process)
            for message in self._inbox.messages():
                if not isinstance(message, float):
                    return self._finish(message, now)
                self._device.job_progress(self._job, message)
        except Exception as error:  # what it sent is no message
            return self._finish(error, now)
        if not ended:
            return []
        status = process.poll()
        text = "without a result" if status is None else f"without a result, exit status {status}"
        return self._finish(ChildProcessError(f"the process ended {text}"), now)

    def _feed(self, process: subprocess.Popen[bytes]) -> None:
        """Write what the pipe takes; at the end it is closed."""
        pipe = process.stdin
        if pipe is None or pipe.closed:
            return
        try:
            while self._unsent:
                self._unsent = self._unsent[os.write(_number(pipe), self._unsent) :]
        except BlockingIOError:
            return
        except OSError:  # it has ended; that is seen where its answers end
            self._unsent = self._unsent[:0]
        pipe.close()

    def _read(self, process: subprocess.Popen[bytes]) -> bool:
        """Read what there is; True if no more will come."""
        while True:
            try:
                piece = os.read(_number(process.stdout), PIECE_BYTES)
            except BlockingIOError:
                return False
            if not piece:
                return True
            self._inbox.add(piece)

    def _finish(self, result: Any, now: float) -> list[Frame]:
        self._kill()
        if isinstance(result, Exception):
            self._report(f"the computation of a reference measurement failed: {result}")
        return self._device.finish_job(self._job, result, now)


def _number(pipe: IO[bytes] | None) -> int:
    """File descriptor of a pipe that was asked for."""
    if pipe is None:
        raise OSError("there is no pipe to the process")
    return pipe.fileno()
