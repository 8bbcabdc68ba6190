"""Detects failure and recovery of the bus."""

from __future__ import annotations

import errno
from collections.abc import Callable

from canfb.errors import reason

RETRY_S = 0.2  # time between attempts on a bus that is down
LASTING_S = 2 * RETRY_S  # if reading fails for this long without a break, the bus is gone
SETTLED_S = 1.0  # time without a failure, after which a bus is reported to work again

# Classes of SocketCAN's error frames (linux/can/error.h).
ERROR_BUS_OFF = 0x040
ERROR_RESTARTED = 0x100

BUS_FAILS, BUS_WORKS = "the bus fails", "the bus works again"
_OFF, _ON = "the CAN controller is bus-off", "the CAN controller is on the bus again"

INTERFACE_DOWN = frozenset({errno.ENETDOWN, errno.ENODEV, errno.ENXIO})


class FailureWatch:
    """Reports a failure once, and its end after SETTLED_S without a failure."""

    def __init__(self, report: Callable[[str], None], trouble: str, recovered: str) -> None:
        self._report = report
        self._trouble = trouble
        self._recovered = recovered
        self._reported = False
        # Time of the last failure; None after its end is reported: :meth:`worked` need not be called then.
        self.failed_s: float | None = None

    def failed(self, error: Exception, now: float, *, known: bool = False) -> bool:
        """Note a failure (``known``: reported already); True if the previous one is less than RETRY_S ago."""
        before, self.failed_s = self.failed_s, now
        if not (self._reported or known):
            self._reported = True
            self._report(f"{self._trouble}: {reason(error)}")
        return before is not None and now - before < RETRY_S

    def worked(self, now: float) -> None:
        if self.failed_s is not None and now - self.failed_s >= SETTLED_S:
            self.failed_s = None
            if self._reported:
                self._reported = False
                self._report(self._recovered)


class BusState:
    """The bus is gone: bus-off, interface down, or reading fails for LASTING_S; back: none for SETTLED_S.

    `lost` and `returned` are True once for each change.
    """

    def __init__(self, report: Callable[[str], None]) -> None:
        self._report = report
        self._reading = FailureWatch(report, BUS_FAILS, BUS_WORKS)
        self._sending = FailureWatch(report, "a frame could not be sent", "frames can be sent again")
        self.gone = False
        self.troubled = False  # Whether `reading_worked` and `sending_worked` must be called.
        self._notified = True
        self._bus_off = False
        self._recovered = ""  # the report that ends the present failure; empty: no failure was reported
        self._alive_s: float | None = None
        self._failing_since_s: float | None = None

    def error_frame(self, error_class: int, now: float) -> None:
        """An error frame; `error_class` is its CAN-ID."""
        if error_class & ERROR_BUS_OFF:
            self._lose(_OFF, _ON)
            self._bus_off = True
        elif error_class & ERROR_RESTARTED:
            self._show_life(now)

    def reading_failed(self, error: Exception, now: float) -> bool:
        """True if the previous failure is less than RETRY_S ago."""
        self.troubled = True
        if self._failing_since_s is None:
            self._failing_since_s = now
        if is_down(error):
            self._lose(f"{BUS_FAILS}: {reason(error)}", BUS_WORKS)
        elif now - self._failing_since_s >= LASTING_S:
            self._lose()
        return self._reading.failed(error, now, known=is_down(error))

    def reading_worked(self, now: float, *, frame: bool) -> None:
        self._failing_since_s = None
        if frame:
            self._reading.worked(now)
            self._show_life(now)
        self._look()

    def sending_failed(self, error: Exception, now: float) -> None:
        self.troubled = True
        if is_down(error):
            self._lose(f"{BUS_FAILS}: {reason(error)}", BUS_WORKS)
        self._sending.failed(error, now, known=self.gone)

    def sending_worked(self, now: float) -> None:
        self._sending.worked(now)
        if not self._bus_off:
            self._show_life(now)
        self._look()

    def lost(self) -> bool:
        """True once for each failure of the bus."""
        notified, self._notified = self._notified, True
        return not notified

    def returned(self, now: float) -> bool:
        if not self.gone or self._alive_s is None or now - self._alive_s < SETTLED_S:
            return False
        self.gone = self._bus_off = False
        self._alive_s = None
        if self._recovered:
            self._report(self._recovered)
            self._recovered = ""
        self._look()
        return True

    def _lose(self, trouble: str = "", recovered: str = "") -> None:
        if trouble and not self._recovered:
            self._recovered = recovered
            self._report(trouble)
        if not self.gone or self._alive_s is not None:
            self._notified = False
        self.gone = self.troubled = True
        self._bus_off = False
        self._alive_s = None

    def _show_life(self, now: float) -> None:
        if self.gone and self._alive_s is None:
            self._alive_s = now

    def _look(self) -> None:
        failing = (self._failing_since_s, self._reading.failed_s, self._sending.failed_s)
        self.troubled = self.gone or failing != (None, None, None)


def is_down(error: Exception) -> bool:
    return code_of(error) in INTERFACE_DOWN


def code_of(error: Exception) -> int | None:
    return error.errno if isinstance(error, OSError) else getattr(error, "error_code", None)
