"""A device that can save: the sample device with 1010h, 1011h and 1020h, and its power switch."""

from __future__ import annotations

from pathlib import Path

import sample_eds
from device_kit import Bench
from sample_eds import I16, U8, U32

from canfb.device.node import Node
from canfb.device.od.dictionary import Dictionary
from canfb.device.storage.image import ParameterGroup
from canfb.device.storage.storage import Store

SAVE, LOAD, VERIFY = 0x1010, 0x1011, 0x1020
SAVE_WORD, LOAD_WORD, WRONG_WORD = 0x65766173, 0x64616F6C, 0x776F726E
ALL, COMMUNICATION, APPLICATION, MANUFACTURER = 1, 2, 3, 4
RESET_NODE, RESET_COMMUNICATION = 129, 130

ROWS = [
    *sample_eds.ROWS,
    *((index, 0, U8, "ro", "4", 0) for index in (SAVE, LOAD)),
    *((index, sub, U32, "rw", "", 0) for index in (SAVE, LOAD) for sub in (1, 2, 3, 4)),
    (VERIFY, 0, U8, "ro", "2", 0),
    *((VERIFY, sub, U32, "rw", "0", 0) for sub in (1, 2)),
    (0x6000, None, I16, "rw", "-7", 0),
    (0x6001, None, U32, "ro", "", 0),
]


def write_eds(path: Path, identity: tuple[int, ...] = ()) -> Path:
    """The EDS of the device; `identity` are vendor-ID, product code and so on, if they are to be there."""
    rows = [row for row in ROWS if not identity or row[0] != 0x1018]
    if identity:
        rows.append((0x1018, 0, U8, "ro", str(len(identity)), 0))
    rows += [(0x1018, sub, U32, "ro", f"0x{number:X}", 0) for sub, number in enumerate(identity, 1)]
    return sample_eds.write(path, sorted(rows, key=lambda row: (row[0], row[1] or 0)))


class StoringBench(Bench):
    """As Bench, speaking with node 32; other node-IDs are read by `value`."""

    def __init__(self, path: Path, store: Store | None, node_id: int = 32) -> None:
        super().__init__(Dictionary.load(path, node_id))
        self.faults: list[dict[ParameterGroup, str]] = []
        self.node = Node(self.dictionary, node_id, self.application, store=store)
        self.application.react(parameters_refused=lambda faults, now: self.faults.append(dict(faults)))

    def command(self, index: int, subindex: int, word: int) -> object:
        return self.write(index, subindex, word, 4)

    def save(self, subindex: int = ALL) -> object:
        return self.command(SAVE, subindex, SAVE_WORD)

    def load(self, subindex: int = ALL) -> object:
        return self.command(LOAD, subindex, LOAD_WORD)

    def value(self, index: int, subindex: int = 0) -> object:
        return self.dictionary.entry(index, subindex).value
