"""A converter as a source: a thread waits for its scans, a SYNC takes them."""

from __future__ import annotations

import threading
from collections.abc import Callable

from canfb.errors import reason
from canfb.hosting.realtime import RealtimeThread
from canfb.signal.sample import Sample
from canfb.sources.protocol import Capture, EvenScans, NewestScan, SourceError

REOPEN_S = 1.0
CLOSE_S = 5.0
LATE_SYNCS = 2  # SYNCs that are skipped while a late scan may still arrive; then it is lost


class CapturedSource:
    """The scans of a converter that ``picked`` selects for a SYNC, by default the newest.

    ``opened`` opens the converter, and reopens it ``reopen_s`` after a failure. If a SYNC fires the trigger,
    it waits at most ``wait_s`` for the scan.
    """

    def __init__(
        self,
        opened: Callable[[], Capture],
        name: str,
        wait_s: float,
        picked: EvenScans | NewestScan | None = None,
        *,
        reopen_s: float = REOPEN_S,
    ) -> None:
        self._opened = opened
        self._wait_s = wait_s
        self._reopen_s = reopen_s
        self._changed = threading.Condition()
        # The condition protects the attributes up to `_late`.
        self._capture: Capture | None = opened()
        self._picked = picked or NewestScan()
        self._trouble = ""
        self.scans = 0  # Number of scans captured, used by a SYNC or not.
        self._late = 0  # SYNCs still to be skipped: the next scan may belong to an earlier SYNC
        self.adc_bits = self._capture.adc_bits  # Bits of a count.
        self.samples_per_sync = self._picked.per_sync  # Pairs of sine and cosine in a sample.
        self._stopping = threading.Event()
        self._thread = RealtimeThread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._stopping.set()
        with self._changed:
            if self._capture is not None:
                self._capture.cancel()
        self._thread.join(CLOSE_S)

    def next(self) -> Sample | None:
        """The scans of this SYNC, or None. SourceError while the device fails."""
        with self._changed:
            capture = self._capture
            if capture is not None and capture.is_fired:
                self._picked.forget()  # a late scan of an earlier SYNC
                if self._late:
                    self._late -= 1
                    return None
                try:
                    capture.fire()
                except OSError as error:
                    raise SourceError(f"the trigger cannot be fired: {reason(error)}") from error
                self._late = LATE_SYNCS  # the arrival of the scan clears it
                self._changed.wait_for(lambda: not self._late or self._trouble, self._wait_s)
            sample = self._picked.take()
            if sample is None and self._trouble:
                raise SourceError(self._trouble)
            return sample

    def _run(self) -> None:
        while not self._stopping.is_set():
            try:
                if self._capture is not None:
                    self._take(self._capture.refill())
                elif not self._stopping.wait(self._reopen_s):
                    self._reopen()
            except Exception as error:  # without this the thread would end unnoticed
                with self._changed:
                    self._capture, self._trouble = None, reason(error)
                    self._changed.notify()
        with self._changed:
            self._capture = None  # closes the device

    def _take(self, scan: Sample | None) -> None:
        if scan is not None:
            with self._changed:
                self._picked.came(scan)
                self.scans += 1
                self._late = 0
                self._changed.notify()

    def _reopen(self) -> None:
        capture = self._opened()
        if capture.adc_bits != self.adc_bits:
            raise SourceError(f"the converter has {capture.adc_bits} bits now, not {self.adc_bits}")
        with self._changed:
            self._capture, self._trouble = capture, ""
            self._picked.forget()
            if self._stopping.is_set():
                capture.cancel()
