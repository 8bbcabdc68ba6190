"""1021h and 1022h: the device hands out its own EDS."""

from __future__ import annotations

from pathlib import Path

import pytest
from device_kit import ID, Bench

from canfb.cia301.codes import AbortCode
from canfb.device.od.dictionary import Dictionary
from canfb.device.sdo.block import crc16

SHIPPED = Path(__file__).parents[2] / "eds"


@pytest.fixture(params=["canfb-module.eds", "encoder-interface.eds"])
def path(request: pytest.FixtureRequest) -> Path:
    return SHIPPED / str(request.param)


@pytest.fixture
def device(path: Path) -> Bench:
    bench = Bench(Dictionary.load(path, ID))
    bench.start()
    return bench


def segmented(bench: Bench) -> bytes:
    (answer,) = (bytes.fromhex(text) for text in bench.sdo("40211000"))
    assert answer[:4] == bytes.fromhex("41211000")
    content, toggle = b"", 0
    while True:
        (answer,) = (bytes.fromhex(text) for text in bench.sdo(f"{0x60 | toggle:02X}"))
        assert answer[0] & 0xF0 == toggle
        content += answer[1 : 8 - (answer[0] >> 1 & 7)]
        toggle ^= 0x10
        if answer[0] & 1:
            return content


def block(bench: Bench) -> bytes:
    (answer,) = (bytes.fromhex(text) for text in bench.sdo("A42110007F00"))
    assert answer[:4] == bytes.fromhex("C6211000")
    size = int.from_bytes(answer[4:], "little")
    content, request = b"", "A3"
    while len(content) < size:
        segments = bench.sdo(request) + [text.split("#")[1] for _, text in bench.run(0.5)]
        content += b"".join(bytes.fromhex(text)[1:] for text in segments)
        assert [int(text[:2], 16) & 0x7F for text in segments] == list(range(1, len(segments) + 1))
        request = f"A2{len(segments):02X}7F"
    (answer,) = (bytes.fromhex(text) for text in bench.sdo(request))
    content = content[: len(content) - (answer[0] >> 2 & 7)]
    assert len(content) == size
    assert int.from_bytes(answer[1:3], "little") == crc16(content)
    assert bench.sdo("A1") == []
    return content


def test_by_segments(device: Bench, path: Path) -> None:
    assert segmented(device) == path.read_bytes()


def test_by_blocks(device: Bench, path: Path) -> None:
    assert block(device) == path.read_bytes()


def test_what_comes_out_describes_the_device(device: Bench, tmp_path: Path) -> None:
    copy = tmp_path / "copy.eds"
    copy.write_bytes(block(device))
    read = Dictionary.load(copy, ID)
    assert list(map(repr, read)) == list(map(repr, Dictionary.load(copy, ID)))
    assert {(entry.index, entry.subindex) for entry in read} == {
        (entry.index, entry.subindex) for entry in device.dictionary
    }


def test_it_is_not_written(device: Bench) -> None:
    (answer,) = device.sdo("2121100004000000")
    assert bytes.fromhex(answer)[4:] == AbortCode.READ_ONLY.to_bytes(4, "little")
