"""1021h and 1022h: the device hands out its own EDS."""

from __future__ import annotations

from pathlib import Path

import pytest
from device_kit import ID, Bench

from canfb.cia301.codes import AbortCode
from canfb.device.od.dictionary import Dictionary

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


def test_by_segments(device: Bench, path: Path) -> None:
    assert segmented(device) == path.read_bytes()


def test_it_is_not_written(device: Bench) -> None:
    (answer,) = device.sdo("2121100004000000")
    assert bytes.fromhex(answer)[4:] == AbortCode.READ_ONLY.to_bytes(4, "little")
