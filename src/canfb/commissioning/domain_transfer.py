"""Objects of any length over python canopen's SDO streams, aborted when anything goes wrong."""

from __future__ import annotations

import io
from collections.abc import Callable
from typing import Any

from canopen.sdo.exceptions import SdoAbortedError

Client = Any  # canopen.sdo.SdoClient, which has no types
SEGMENT = 7


def fetch(client: Client, index: int, subindex: int, block: bool, heard: Callable[[float], None]) -> bytes:
    """Upload an object, by block transfer if ``block``; ``heard`` gets 0..1 where the size is known."""

    def take(stream: Any) -> bytes:
        chunks: list[bytes] = []
        while chunk := stream.read(SEGMENT):
            chunks.append(chunk)
            if stream.size and len(chunks) % 256 == 0:
                heard(min(1.0, SEGMENT * len(chunks) / stream.size))
        data = b"".join(chunks)
        return data[: stream.size] if stream.size else data

    return _through(client, client.open(index, subindex, "rb", buffering=0, block_transfer=block), take)


def send(client: Client, index: int, subindex: int, data: bytes, block: bool) -> bytes:
    """Download ``data``, by block transfer if ``block``. It gives b"", as what comes back."""

    def give(stream: Any) -> bytes:
        sent = 0
        while sent < len(data):
            sent += stream.write(data[sent : sent + SEGMENT])
        return b""

    stream = client.open(index, subindex, "wb", size=len(data), buffering=0, block_transfer=block)
    return _through(client, stream, give)


def _through(client: Client, stream: io.RawIOBase, act: Callable[[Any], bytes]) -> bytes:
    """``act`` on the stream, which is closed after it. When anything goes wrong the transfer is aborted.

    Closing canopen's streams ends the transfer as if all data had been sent: half a table would be
    taken for a whole one.
    """
    try:
        result = act(stream)
    except BaseException as error:
        io.RawIOBase.close(stream)
        if not isinstance(error, SdoAbortedError):
            client.abort()
        raise
    stream.close()
    return result
