"""Receiving from a bus of python-can that goes down, or is removed and made again."""

from __future__ import annotations

import contextlib
import errno
import os
import socket
import time
from collections.abc import Callable

import can
from can.interfaces.socketcan import SocketcanBus

from canfb.bus.bus_state import BUS_FAILS, BUS_WORKS, RETRY_S, FailureWatch, code_of, is_down
from canfb.bus.shared_bus import SharedBus
from canfb.errors import BusError, reason

AF_CAN = getattr(socket, "AF_CAN", None)  # on Linux only

# Of frames that wait, as the kernel counts them: 768 for each, and twice what is asked for. By default a
# socket holds 277 frames, 30 ms of a full bus at 1 Mbit/s; these are 2700. Without CAP_NET_ADMIN the kernel
# grants at most net.core.rmem_max, by default 554.
QUEUE_BYTES = 1 << 20
_SO_RCVBUFFORCE = 33  # asm-generic/socket.h


def enlarge_queue(one: socket.socket) -> None:
    """For the frames that wait while this process is busy or does not run; the kernel drops the others."""
    for option in (_SO_RCVBUFFORCE, socket.SO_RCVBUF):
        with contextlib.suppress(OSError):
            one.setsockopt(socket.SOL_SOCKET, option, QUEUE_BYTES)
            return


def enlarge_queue_of(bus: can.BusABC) -> None:
    """That of a bus of python-can, if it is a socket."""
    with (
        contextlib.suppress(OSError, NotImplementedError, ValueError),
        socket.socket(fileno=os.dup(bus.fileno())) as one,
    ):
        enlarge_queue(one)


class NamedInterface:
    """The SocketCAN interface of a bus of python-can, by its name; of any other bus nothing is asked.

    One that was removed and made again, as by an adapter that was unplugged, has another index: the kernel
    has unbound the socket, which says so once and is silent from then on.
    """

    def __init__(self, bus: can.BusABC) -> None:
        under = bus.under if isinstance(bus, SharedBus) else bus
        self._bus = None
        if isinstance(under, SocketcanBus) and under.channel and under.socket.family == AF_CAN:
            self._bus = under

    def comes_back(self, error: Exception) -> bool:
        """Whether it may work again after this failure: it is down, or removed and :meth:`bind` finds it."""
        return code_of(error) == errno.ENETDOWN or (self._bus is not None and is_down(error))

    def bind(self) -> None:
        """Bind the socket again if the kernel has unbound it. OSError while there is no such interface."""
        bus = self._bus
        if bus is not None and bus.socket.getsockname()[0] != bus.channel:
            bus.socket.bind((bus.channel,))
            bus.set_filters(bus.filters)  # the kernel has dropped them


class Reception:
    """Receives from ``bus`` for as long as it takes.

    An interface that is down, and one that is gone and can be opened by its name, is waited for: ``report``
    gets a line when it goes, and one when frames come again. BusError for any other failure, unless it
    ``lasts``: then each is waited for.
    """

    def __init__(
        self,
        bus: can.BusABC,
        report: Callable[[str], None],
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
        *,
        lasts: bool = False,
    ) -> None:
        self._bus, self._clock, self._sleep, self._lasts = bus, clock, sleep, lasts
        self._interface = NamedInterface(bus)
        self._watch = FailureWatch(report, BUS_FAILS, BUS_WORKS)
        self.failures = 0
        """How often it failed until now."""

    def receive(self, wait_s: float) -> can.Message | None:
        """The next frame; None if there was none for so long, or the bus fails."""
        try:
            message = self._bus.recv(wait_s)
            if message is None:
                self._interface.bind()
        except (can.CanError, OSError) as error:
            self.failed(error)
            return None
        if message is not None and self._watch.failed_s is not None:
            self._watch.worked(self._clock())
        return message

    def failed(self, error: Exception) -> None:
        """Outlast a failure, of sending too; BusError for one that nothing ends."""
        self.failures += 1
        if not self._lasts and not self._interface.comes_back(error):
            raise BusError(f"{BUS_FAILS}: {reason(error)}") from error
        if self._watch.failed(error, self._clock()):
            self._sleep(RETRY_S)
