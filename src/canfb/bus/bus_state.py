"""Whether the bus is there, from its failures and error frames."""

from __future__ import annotations

import errno
from collections.abc import Callable

from canfb.errors import reason

RETRY_S = 0.2  # between attempts on a bus that is down
LASTING_S = 2 * RETRY_S  # reading fails for this long without a break: the bus is gone, not one datagram bad
SETTLED_S = 1.0  # without a failure, before a bus is said to work again

# Classes of SocketCAN's error frames (linux/can/error.h).
ERROR_BUS_OFF = 0x040
ERROR_RESTARTED = 0x100

BUS_FAILS, BUS_WORKS = "the bus fails", "the bus works again"
_OFF, _ON = "the CAN controller is bus-off", "the CAN controller is on the bus again"

INTERFACE_DOWN = frozenset({errno.ENETDOWN, errno.ENODEV, errno.ENXIO})


class FailureWatch:
    """Sending or receiving: reports a failure once, and its end once that has lasted."""

    def __init__(self, report: Callable[[str], None], trouble: str, recovered: str) -> None:
        self._report = report
        self._trouble = trouble
        self._recovered = recovered
        self._reported = False
        self.failed_s: float | None = None
        """When it last failed; None once its end is reported: :meth:`worked` need not be called then."""

    def failed(self, error: Exception, now: float, *, known: bool = False) -> bool:
        """Note a failure (``known``: reported already); True if the one before was only just now."""
        before, self.failed_s = self.failed_s, now
        if not (self._reported or known):
            self._reported = True
            self._report(f"{self._trouble}: {reason(error)}")
        return before is not None and now - before < RETRY_S

    def worked(self, now: float) -> None:
        """Note that it worked."""
        if self.failed_s is not None and now - self.failed_s >= SETTLED_S:
            self.failed_s = None
            if self._reported:
                self._reported = False
                self._report(self._recovered)


class BusState:
    """Gone or there; `lost` and `returned` say it once each.

    Gone: bus-off, an interface that is down, or reading that fails for LASTING_S. There again: nothing of the
    kind for SETTLED_S after a frame, an error frame "restarted" or, unless bus-off, a frame that could be
    sent.
    """

    def __init__(self, report: Callable[[str], None]) -> None:
        self._report = report
        self.gone = False
        self.troubled = False
        """Whether `reading_worked` and `sending_worked` must be called."""
        self._notified = True
        self._bus_off = False
        self._recovered = ""  # what is to be reported at the end of what was reported
        self._alive_s: float | None = None
        self._failing_since_s: float | None = None

    def error_frame(self, error_class: int, now: float) -> None:
        """An error frame of SocketCAN; `error_class` is its CAN-ID."""
        if error_class & ERROR_BUS_OFF:
            self._say(_OFF, _ON)
            self._bus_off = True
            self._lose()
        elif error_class & ERROR_RESTARTED:
            self._show_life(now)

    def reading_failed(self, error: Exception, now: float) -> None:
        """The bus could not be read."""
        self.troubled = True
        if self._failing_since_s is None:
            self._failing_since_s = now
        if is_down(error):
            self._went_down(error)
        elif now - self._failing_since_s >= LASTING_S:
            self._bus_off = False
            self._lose()

    def reading_worked(self, now: float, *, frame: bool) -> None:
        """The bus could be read; `frame`: and there was a frame."""
        self._failing_since_s = None
        self.troubled = self.gone
        if frame:
            self._show_life(now)

    def sending_failed(self, error: Exception, now: float) -> None:
        """A frame could not be sent."""
        if is_down(error):
            self._went_down(error)

    def sending_worked(self, now: float) -> None:
        """A frame could be sent, or was taken into a queue."""
        if not self._bus_off:
            self._show_life(now)

    def lost(self) -> bool:
        """True once for each failure of the bus."""
        if self._notified:
            return False
        self._notified = True
        return True

    def returned(self, now: float) -> bool:
        """Whether the bus is back; true once."""
        if not self.gone or self._alive_s is None or now - self._alive_s < SETTLED_S:
            return False
        self.gone = self.troubled = self._bus_off = False
        self._alive_s = None
        if self._recovered:
            self._report(self._recovered)
            self._recovered = ""
        return True

    def _went_down(self, error: Exception) -> None:
        self._say(f"{BUS_FAILS}: {reason(error)}", BUS_WORKS)
        self._bus_off = False
        self._lose()

    def _say(self, trouble: str, recovered: str) -> None:
        if not self._recovered:
            self._recovered = recovered
            self._report(trouble)

    def _lose(self) -> None:
        if not self.gone or self._alive_s is not None:
            self._notified = False
        self.gone = self.troubled = True
        self._alive_s = None

    def _show_life(self, now: float) -> None:
        if self.gone and self._alive_s is None:
            self._alive_s = now


def is_down(error: Exception) -> bool:
    """Whether a failure means that the interface is down, or removed."""
    return code_of(error) in INTERFACE_DOWN


def code_of(error: Exception) -> int | None:
    """The errno of a failure, of python-can's too."""
    code: int | None = error.errno if isinstance(error, OSError) else getattr(error, "error_code", None)
    return code
