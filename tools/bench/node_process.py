"""A node as a process of its own, and the far end of its bus."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
from collections.abc import Sequence

PATIENCE_S = 20.0


class NodeProcess:
    """Runs ``python -m MODULE ARGUMENTS`` on a bus until :meth:`end`; the others of the bus use :attr:`bus`.

    The bus is a pair of datagram sockets that carry struct can_frame, of which the process gets one as
    ``--fd N``; or a SocketCAN interface, ``--channel NAME``. The process is on the bus when it has printed a
    line with ``ready`` in it; the program ends with a message if it does not.
    """

    def __init__(self, arguments: Sequence[str], channel: str | None, ready: str) -> None:
        self.name = " ".join(arguments)
        command = [sys.executable, "-m", *arguments]
        if channel is None:
            self.bus, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
            command += ["--fd", str(theirs.fileno())]
        else:
            theirs = self.bus = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
            self.bus.bind((channel,))
            command += ["--channel", channel]
        self._process = subprocess.Popen(
            command, stdout=subprocess.PIPE, text=True, pass_fds=[theirs.fileno()]
        )
        if theirs is not self.bus:
            theirs.close()
        assert self._process.stdout is not None
        if not any(ready in line for line in iter(self._process.stdout.readline, "")):
            sys.exit(f"{self.name} did not start")
        self.processor_clock = (~self._process.pid << 3) | 2  # of the process: clock_getcpuclockid(3)

    def end(self) -> str:
        """End the process; what it has printed since it was ready."""
        self._process.send_signal(signal.SIGTERM)
        try:
            return self._process.communicate(timeout=PATIENCE_S)[0]
        except subprocess.TimeoutExpired:
            self._process.kill()
            return self._process.communicate()[0]
        finally:
            self.bus.close()
