"""The SYNC of the master: at a fixed period, or, for a simulated machine, each when the last one is answered.

Needs python canopen.
"""

from __future__ import annotations

import contextlib
import threading
import time
from typing import Any

import can
import canopen
from network_file import NetworkFile

SYNC = 0x80


def produce(network: canopen.Network, file: NetworkFile) -> Any:
    """Start the SYNC of the file; what it returns has ``stop()``."""
    period_s = file.sync_period_us / 1e6
    if not file.sync_waits_s:
        return network.send_periodic(SYNC, b"", period_s)
    answers = [
        pdo.cob_id
        for node in file.nodes.values()
        for pdo in node.pdos.values()
        if pdo.is_tpdo and pdo.cob_id is not None
    ]
    sync = WaitingSync(network, period_s, file.sync_waits_s, answers)
    sync.start()
    return sync


class WaitingSync(threading.Thread):
    """A SYNC each ``period_s``, or later: when all those have answered it that answered the last two.

    Simulated nodes of a computer that is busy with something else then lose no sample. Who does not answer
    is waited for once, for ``longest_s``. When somebody new answers, a quarter of that passes after each of
    the next two SYNCs, so that no late answer is taken for one to the next SYNC. ``answers`` are the CAN-IDs
    of PDOs.
    """

    def __init__(
        self, network: canopen.Network, period_s: float, longest_s: float, answers: list[int]
    ) -> None:
        super().__init__(daemon=True)
        self._network, self._period_s, self._longest_s = network, period_s, longest_s
        self._answers = answers
        self._changed = threading.Condition()
        self._heard: set[int] = set()
        self._expected: set[int] = set()
        self._unsettled = 2
        self._over = False

    def run(self) -> None:
        """Send them until it is stopped, or until the bus fails."""
        for can_id in self._answers:
            self._network.subscribe(can_id, self._hear)
        before: set[int] = set()
        with self._changed:
            while not self._over:
                self._heard = set()
                sent = time.monotonic()
                try:
                    self._network.send_message(SYNC, b"")
                except (can.CanError, OSError):
                    return  # the master sees it too
                least_s = self._wait_for_answers()
                left = sent + max(self._period_s, least_s) - time.monotonic()
                self._changed.wait_for(lambda: self._over, max(0.0, left))
                if self._heard - before - self._expected:
                    self._unsettled = 2
                self._expected, before = self._heard & before, self._heard

    def _wait_for_answers(self) -> float:
        """How long the SYNC must last at least, seconds."""
        if self._unsettled:
            self._unsettled -= 1
            return self._longest_s / 4
        self._changed.wait_for(lambda: self._over or self._heard >= self._expected, self._longest_s)
        return 0.0

    def stop(self) -> None:
        """No SYNC any more."""
        with self._changed:
            self._over = True
            self._changed.notify_all()
        self.join()
        for can_id in self._answers:
            with contextlib.suppress(KeyError, ValueError):
                self._network.unsubscribe(can_id, self._hear)

    def _hear(self, can_id: int, data: bytearray, timestamp: float) -> None:
        with self._changed:
            self._heard.add(can_id)
            self._changed.notify_all()
