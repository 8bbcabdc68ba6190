"""The master of python canopen on an embedded bus."""

from __future__ import annotations

import canopen

from canfb.cia301.frame import Frame
from canfb.simulation.embedded_bus import EmbeddedBus


class EmbeddedNetwork(canopen.Network):
    """python canopen's master on an embedded bus: no thread, no waiting, the answer is there at once."""

    def __init__(self, bus: EmbeddedBus) -> None:
        super().__init__()
        self._embedded = bus
        self._own: list[tuple[int, bytes, bool]] = []  # sent, and not yet heard
        bus.observers.append(self._hear)

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        """Put a frame on the embedded bus."""
        frame = Frame(can_id, bytes(data), remote)
        self._own.append(frame[:3])
        self._embedded.send(frame)

    def _hear(self, frame: Frame, now: float) -> None:
        if self._own and frame[:3] in self._own:  # a controller does not receive what it sends
            self._own.remove(frame[:3])
        elif not frame.rtr:
            self.notify(frame.can_id, bytearray(frame.data), now)
