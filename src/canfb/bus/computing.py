"""Runs long computations of a device in a separate process."""

from __future__ import annotations

import contextlib
import logging
import os
import pickle
import subprocess
import sys
import tempfile
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

from canfb.cia301.frame import Frame
from canfb.device.node import Computing

log = logging.getLogger(__name__)

COMMAND = (sys.executable, "-m", "canfb.bus.compute_process")


class Computation:
    """The computations of one ``device``, a new process each: a fork would share its bus and its memory."""

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
        self._answers: Connection | None = None
        self._killed: list[subprocess.Popen[bytes]] = []
        self._cpus = os.sched_getaffinity(0) if sys.platform == "linux" else set()

    def poll(self, now: float) -> list[Frame]:
        self._killed = [process for process in self._killed if process.poll() is None]
        job = self._device.pending_job()
        try:
            if job is not self._job:
                self._kill()
                self._job = job
                if job is not None:
                    self._start(job)
            result = self._read()
        except EOFError:
            result = ChildProcessError("the process ended without a result")
        except Exception as error:  # the process does not start, the job cannot be sent, or no valid answer
            result = error
        if result is None:
            return []
        self._kill()
        if isinstance(result, Exception):
            self._report(f"the computation of a reference measurement failed: {result}")
        return self._device.finish_job(self._job, result, now)

    def close(self) -> None:
        self._kill()
        for process in self._killed:
            process.wait()

    def _kill(self) -> None:
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            self._killed.append(process)
        if self._answers is not None:
            self._answers.close()
            self._answers = None

    def _start(self, job: Any) -> None:
        path = os.pathsep.join(folder or os.getcwd() for folder in sys.path)
        with tempfile.TemporaryFile() as file:  # unlike a pipe, writing never waits for the process
            pickle.dump(job, file)
            file.seek(0)
            self._process = process = subprocess.Popen(
                self._command,
                stdin=file,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env={"OPENBLAS_NUM_THREADS": "1", **os.environ, "PYTHONPATH": path},
                start_new_session=True,  # Ctrl-C reaches only this process, which ends the other
            )
        assert process.stdout is not None
        with process.stdout:
            self._answers = Connection(os.dup(process.stdout.fileno()), writable=False)
        if sys.platform == "linux":  # `cpu` of `realtime:` binds this process to one CPU; not the computation
            with contextlib.suppress(OSError):  # it has ended already; reading its pipe reports that
                os.sched_setaffinity(process.pid, self._cpus)

    def _read(self) -> Any:
        while self._answers is not None and self._answers.poll():
            message = self._answers.recv()
            if not isinstance(message, float):
                return message
            self._device.job_progress(self._job, message)
        return None
