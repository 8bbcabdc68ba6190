"""The SDO server against a client that is not ours: that of canopen."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import canopen
import pytest
from device_kit import ID, Bench

from canfb.cia301.frame import Frame

CONTENT = bytes(place * 13 & 0xFF for place in range(5001))


class Wire:
    """Stands for the network of canopen: no thread and no clock, each send runs the node."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.listener: Callable[..., None] | None = None

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        frames = self.bench.node.receive(Frame(can_id, bytes(data)), self.bench.now)
        self._deliver(frames)
        while (due := self.bench.node.deadline()) is not None and due - self.bench.now < 0.5:
            self.bench.now = due
            self._deliver(self.bench.node.tick(due))

    def _deliver(self, frames: list[Frame]) -> None:
        for frame in frames:
            if frame.can_id == 0x580 + ID and self.listener is not None:
                self.listener(frame.can_id, bytearray(frame.data), 0.0)


@pytest.fixture
def client(bench: Bench, sample_path: Path) -> canopen.sdo.SdoClient:
    wire = Wire(bench)
    dictionary = canopen.import_od(str(sample_path), ID)
    client = canopen.sdo.SdoClient(0x600 + ID, 0x580 + ID, dictionary)
    client.network = wire  # type: ignore[assignment]
    wire.listener = client.on_response
    return client


def test_numbers_and_strings(client: canopen.sdo.SdoClient) -> None:
    assert client.upload(0x1000, 0) == b"\x91\x01\x04\x00"
    assert client.upload(0x1008, 0) == b"a sample device!"
    client.download(0x1017, 0, b"\x10\x27")
    assert client.upload(0x1017, 0) == b"\x10\x27"
    with pytest.raises(canopen.SdoAbortedError, match="06010002"):
        client.download(0x1000, 0, bytes(4))


def test_segmented(client: canopen.sdo.SdoClient) -> None:
    client.download(0x2020, 0, CONTENT)
    assert client.upload(0x2020, 0) == CONTENT


@pytest.mark.parametrize("crc", [False, True])
def test_block_upload(bench: Bench, client: canopen.sdo.SdoClient, crc: bool) -> None:
    bench.dictionary.entry(0x2020).value = CONTENT
    with client.open(0x2020, 0, "rb", block_transfer=True, request_crc_support=crc) as stream:
        assert stream.read() == CONTENT


@pytest.mark.parametrize("crc", [False, True])
def test_block_download(bench: Bench, client: canopen.sdo.SdoClient, crc: bool) -> None:
    with client.open(
        0x2020, 0, "wb", size=len(CONTENT), block_transfer=True, request_crc_support=crc
    ) as stream:
        stream.write(CONTENT)
    assert bench.dictionary.entry(0x2020).value == CONTENT
