"""Pickled messages on a pipe, each with its length before it."""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from typing import Any

LENGTH_BYTES = 4


def pack(message: object) -> bytes:
    """One message."""
    data = pickle.dumps(message)
    return len(data).to_bytes(LENGTH_BYTES, "little") + data


class Inbox:
    """Puts together what comes in pieces."""

    def __init__(self) -> None:
        self._data = bytearray()

    def add(self, piece: bytes) -> None:
        """The next piece."""
        self._data += piece

    def messages(self) -> Iterator[Any]:
        """The messages that are complete, each once. What pickle raises if one is none."""
        while len(self._data) >= LENGTH_BYTES:
            end = LENGTH_BYTES + int.from_bytes(self._data[:LENGTH_BYTES], "little")
            if len(self._data) < end:
                return
            message = bytes(self._data[LENGTH_BYTES:end])
            del self._data[:end]
            yield pickle.loads(message)
