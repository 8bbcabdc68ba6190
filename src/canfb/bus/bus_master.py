"""A CANopen master on a python-can bus, for tools."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

import can
import canopen
from canopen.network import MessageListener

from canfb.bus.sdo_channel import SharedClient, sdo_turn
from canfb.cia301 import cob
from canfb.errors import BusError, reason, saying

OnFrame = Callable[[int, bytes, float], None]
LOOK_S = 0.05  # interval of checks for a failed bus
STOP_S = 1.0  # time for the receiving thread to end


class BusMaster:
    """A master of a network; a context manager. BusError when the bus fails."""

    def __init__(self, bus: can.BusABC, answer_within_s: float = 1.0) -> None:
        self._bus = bus
        self._answer_within_s = answer_within_s
        self._network = _Network(bus)
        self._clients: dict[int, SharedClient] = {}

    def __enter__(self) -> BusMaster:
        self._network.connect()
        return self

    def __exit__(self, *raised: object) -> None:
        self._bus.stop_all_periodic_tasks()
        if self._network.notifier is not None:
            self._network.notifier.stop(STOP_S)
        self._bus.shutdown()

    def sdo(self, node_id: int) -> SharedClient:
        if node_id not in self._clients:
            turn = partial(sdo_turn, str(self._bus.channel_info), node_id)
            self._clients[node_id] = SharedClient(self._network, node_id, self._answer_within_s, turn)
        return self._clients[node_id]

    def subscribe(self, can_id: int, on_frame: OnFrame) -> None:
        """``on_frame`` gets CAN-ID, data and time stamp, in the receiving thread."""
        self._network.subscribe(can_id, on_frame)

    def unsubscribe(self, can_id: int, on_frame: OnFrame) -> None:
        self._network.unsubscribe(can_id, on_frame)

    def send(self, can_id: int, data: bytes, remote: bool = False) -> None:
        with saying(BusError, "a frame could not be sent", can.CanError, OSError):
            self._network.send_message(can_id, data, remote)

    def produce_sync(self, rate_hz: float) -> None:
        message = can.Message(arbitration_id=cob.SYNC, is_extended_id=False)
        with saying(BusError, "the SYNC cannot be produced", can.CanError, OSError):
            self._bus.send_periodic(message, 1.0 / rate_hz)

    def now(self) -> float:
        return time.monotonic()

    def wait(self, duration_s: float) -> None:
        """Wait. BusError as soon as the bus fails."""
        end = self.now() + duration_s
        self._network.check()
        while self.now() < end:
            time.sleep(min(LOOK_S, max(0.0, end - self.now())))
            self._network.check()


class _Network(canopen.Network):
    """canopen's network, with filters on the bus for the CAN-IDs that have subscribers."""

    NOTIFIER_CYCLE = LOOK_S

    def __init__(self, bus: can.BusABC) -> None:
        self._bus = bus
        super().__init__(bus)
        self.subscribers = {}
        self.listeners = [_Listener(self)]

    def subscribe(self, can_id: int, callback: Callable[..., None]) -> None:
        super().subscribe(can_id, callback)
        self._filter()

    def unsubscribe(self, can_id: int, callback: Callable[..., None] | None = None) -> None:
        super().unsubscribe(can_id, callback)
        self._filter()

    def check(self) -> None:
        """BusError, once for each failure of reading."""
        if self.notifier is not None and self.notifier.exception is not None:
            error, self.notifier.exception = self.notifier.exception, None
            raise BusError(f"the bus fails: {reason(error)}") from error

    def _filter(self) -> None:
        filters = [{"can_id": one, "can_mask": cob.CAN_ID, "extended": False} for one in self.subscribers]
        self._bus.set_filters(filters or None)  # type: ignore[arg-type]


class _Listener(MessageListener):
    """Passes classic frames with 11-bit identifiers."""

    def on_message_received(self, msg: can.Message) -> None:
        if not (msg.is_extended_id or msg.is_fd or msg.is_error_frame or msg.is_remote_frame):
            self.network.notify(msg.arbitration_id, msg.data, msg.timestamp)

    def on_error(self, exc: Exception) -> None:
        """The notifier stores the exception and reads again."""
        time.sleep(LOOK_S)
