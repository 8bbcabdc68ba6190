"""From the threads of a bus into the one thread in which the page is served."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from typing import Any


class ScopeLoop:
    """Calls what other threads bring, in the thread of the server."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop

    def soon(self, call: Callable[..., object], *arguments: Any) -> None:
        """From any thread; nothing happens once the server has ended."""
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(call, *arguments)
