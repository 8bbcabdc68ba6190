"""Object 2020h: tables, staged and in force."""

import math
import struct

import numpy as np
import pytest
from canopen import SdoAbortedError
from module_bench import Bench

from canfb.device.storage.storage import MemoryStore
from ideal_tracks import wavy_table


def change(n: int, value: float) -> bytes:
    entries = wavy_table(256).entries
    entries[n] = value
    return struct.pack(f"<{len(entries)}f", *entries)


@pytest.mark.parametrize(
    "data",
    [
        change(7, math.nan), change(7, math.inf), change(7, 0.5), change(7, 6 / 256), change(0, -0.3),
        bytes(60),
        wavy_table(256).to_bytes()[:-1], wavy_table(256).to_bytes()[:-2],
        struct.pack("<4097f", *(np.arange(4097) / 4097)), bytes(1024),
    ],
)  # fmt: skip
def test_a_bad_table_is_refused_and_leaves_everything_as_it_was(bench: Bench, data: bytes) -> None:
    good, next_one = wavy_table(256, 0.01), wavy_table(256, 0.02)
    bench.activate(good)
    bench.stage(next_one)
    with pytest.raises(SdoAbortedError, match="06090030"):
        bench.sdo.download(0x2020, 1, data)
    assert bench.in_force() == (next_one.crc32, good.crc32, 256)
    assert bench.sdo.upload(0x2020, 1) == good.to_bytes()


def test_the_crc_of_what_is_saved() -> None:
    bench = Bench(MemoryStore())
    saved = bench.sdo[0x2020][6]
    assert saved.raw == 0, "nothing is saved yet"
    bench.activate(wavy_table(256))
    assert saved.raw == 0, "active is not saved"
    bench.save(4)
    assert saved.raw == wavy_table(256).crc32
    bench.sdo[0x2020][3].raw = 0
    assert saved.raw == wavy_table(256).crc32, "a reset brings it back"
    bench.save()
    assert saved.raw == 0
    with pytest.raises(SdoAbortedError):
        saved.raw = 1
