"""What an interruption must not leave half done."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator


class Guard:
    """Keeps an interruption (Ctrl-C, SIGTERM, SIGHUP) away from what must not be left half done.

    Call :meth:`interrupt` from a signal handler: it raises KeyboardInterrupt, but not while held, and
    once only. A second signal, as a shell sends it to its jobs, must not stop what the first one began.
    """

    def __init__(self) -> None:
        self._held = self._interrupted = False

    def interrupt(self) -> None:
        """The end is requested."""
        if not self._held and not self._interrupted:
            self._interrupted = True
            raise KeyboardInterrupt

    @contextlib.contextmanager
    def held(self) -> Iterator[None]:
        """No interruption in here: what is done here is the end anyway."""
        self._held = True
        try:
            yield
        finally:
            self._held = False
