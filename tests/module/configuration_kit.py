"""Modules in any configuration that SDO writes can bring about, and what a configuration is compared by."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
from hypothesis import strategies as st

from canfb.cia301 import datatypes
from canfb.cia301.codes import SdoAbort
from canfb.cia301.datatypes import DataType
from canfb.cia301.frame import Frame
from canfb.device.od.dictionary import Entry
from canfb.device.od.writes import Write
from canfb.module.device_configuration import configuration_of
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig
from canfb.signal.correction import CorrectionTable
from ideal_tracks import counts_at

NODE_ID = 32
RESET_NODE, START = Frame(0, bytes([0x81, NODE_ID])), Frame(0, bytes([0x01, NODE_ID]))
PDOS = (0x1400, 0x1401, 0x1800, 0x1801, 0x1802, 0x1803)
TEMPLATE = FeedbackModule(ModuleConfig(node_id=NODE_ID))
SETTINGS = list(TEMPLATE.node.storage.entries.settings())


def mappable(access: tuple[str, ...]) -> list[int]:
    """Mapping entries of all objects that a PDO of this direction takes."""
    entries = [entry for entry in TEMPLATE.dictionary if entry.pdo_mappable and entry.access in access]
    return [entry.index << 16 | entry.subindex << 8 | entry.bit_length for entry in entries]


TRANSMITTED, RECEIVED = mappable(("ro", "rw", "rwr", "const")), [*mappable(("rw", "rww")), 0x00050008]
CAN_IDS = st.sampled_from([0x90, 0xA0, 0xB0, 0x181, 0x190, 0x1A0, 0x2A0, 0x320, 0x3A0, 0x4A0, 0x500, 0x6C0])


def write(index: int, subindex: int, size: int, value: int) -> Write:
    return Write(index, subindex, value.to_bytes(size, "little"))


def table(entries: int, amplitude: float) -> CorrectionTable:
    phases = np.arange(entries) / entries
    return CorrectionTable(phases + amplitude * np.sin(2 * np.pi * phases))


@st.composite
def pdo(draw: st.DrawFn) -> list[Write]:
    """A PDO as a master sets it up, in the order of CiA 301."""
    index = draw(st.sampled_from(PDOS))
    mapped = draw(st.lists(st.sampled_from(TRANSMITTED if index >= 0x1800 else RECEIVED), max_size=4))
    flags = draw(st.sampled_from([0, 1 << 30, 1 << 31, 3 << 30]))
    kinds = st.sampled_from([0, 1, 2, 5, 240, 252, 253, 254, 255])
    return [
        write(index, 1, 4, 1 << 31),
        write(index + 0x200, 0, 1, 0),
        *(write(index + 0x200, place, 4, one) for place, one in enumerate(mapped, 1)),
        write(index + 0x200, 0, 1, draw(st.integers(0, len(mapped)))),
        write(index, 2, 1, draw(kinds)),
        *(write(index, sub, size, draw(st.integers(0, 250))) for sub, size in ((3, 2), (5, 2), (6, 1))),
        write(index, 1, 4, draw(CAN_IDS) | flags),
    ]


def value_of(entry: Entry) -> st.SearchStrategy[bytes]:
    """Bytes of any value of an entry, small ones and typical ones more often."""
    size = entry.byte_length
    if entry.data_type == DataType.REAL32:
        reals = st.one_of(st.floats(-2, 2, width=32), st.floats(-2e9, 2e9, width=32))
        return reals.map(lambda value: struct.pack("<f", value))
    numbers = st.one_of(st.integers(0, 255), st.sampled_from([410, 2560, 6554, 40960]), st.integers(0))
    return numbers.map(lambda value: (value % 256**size).to_bytes(size, "little"))


PLAIN = st.sampled_from(SETTINGS).flatmap(
    lambda entry: value_of(entry).map(lambda data: [Write(entry.index, entry.subindex, data)])
)
COB_IDS = st.sampled_from([(0x1005, 0), (0x1012, 0), (0x1014, 0), (0x1201, 1), (0x1201, 2)]).flatmap(
    lambda place: st.tuples(CAN_IDS, st.sampled_from([0, 1 << 30, 1 << 31])).map(
        lambda value: [write(*place, 4, 1 << 31), write(*place, 4, value[0] | value[1])]
    )
)
WATCHED = st.tuples(st.integers(1, 4), st.integers(0, 6), st.integers(0, 500)).map(
    lambda one: [write(0x1016, one[0], 4, one[1] << 16 | one[2])]
)
COUNTED = st.tuples(st.sampled_from([0, 2, 10, 240]), st.sampled_from([0, 1000, 50_000])).map(
    lambda one: [write(0x1006, 0, 4, 0), write(0x1019, 0, 1, one[0]), write(0x1006, 0, 4, one[1])]
)
AMPLITUDES = st.tuples(st.integers(0, 65534), st.integers(1, 65535)).map(
    lambda one: [write(0x2001, 3, 2, 0), write(0x2001, 4, 2, max(one)), write(0x2001, 3, 2, min(one))]
)
TABLES = st.one_of(
    st.just([write(0x2020, 3, 4, 0)]),
    st.tuples(st.integers(16, 40), st.floats(-0.1, 0.1)).map(
        lambda one: [
            Write(0x2020, 1, table(*one).to_bytes()),
            write(0x2020, 3, 4, table(*one).crc32),
        ]
    ),
)
PROGRAMS = st.lists(st.one_of(PLAIN, pdo(), COB_IDS, WATCHED, COUNTED, AMPLITUDES, TABLES), max_size=25).map(
    lambda parts: [one for part in parts for one in part]
)
"""Writes, of which a module takes some and refuses the others."""


def reset(module: FeedbackModule) -> None:
    """As after a power-on, in Pre-operational, at time 0."""
    module.start(0.0)
    module.receive(RESET_NODE, 0.0)


def put(module: FeedbackModule, one: Write) -> int:
    """Write as SDO does it: the abort code, 0 for none."""
    try:
        module.dictionary.lookup(one.index, one.subindex).download(one.data)
    except SdoAbort as abort:
        return int(abort.code)
    return 0


def run(module: FeedbackModule, program: list[Write]) -> None:
    """Write all that the module takes, and put table and conditioning in force together."""
    for one in program:
        put(module, one)
    active = module.dictionary.entry(0x2020, 4).value
    assert put(module, write(0x2020, 3, 4, active)) == 0


def state(module: FeedbackModule) -> dict[Any, Any]:
    """Every parameter, the table, and what of it the signal chain has."""
    active = module.chain.correction.conditioning
    return {
        **configuration_of(module).values(),
        "offset": module.dictionary.entry(0x6509).value,
        "resolution": module.dictionary.entry(0x6501).value,
        "conditioning": [datatypes.encode(DataType.REAL32, value) for value in vars(active).values()],
        "autostart": module.node.autostart,
    }


def played(module: FeedbackModule, samples: int = 40) -> list[Frame]:
    """What it sends in OPERATIONAL: SYNC and ADC counts 1 ms apart, its timers, remote frames."""
    value = {place: int(module.dictionary.entry(*place).value) for place in [(0x1005, 0), (0x1019, 0)]}
    sync_id, overflow = value[0x1005, 0] & 0x7FF, value[0x1019, 0]
    sent = module.receive(START, 0.0)
    for n in range(samples):
        now = 1e-3 * (n + 1)
        while (due := module.deadline()) is not None and due < now:
            sent += module.tick(due)
        counter = bytes([n % overflow + 1]) if overflow > 1 else b""
        sent += module.receive(Frame(sync_id, counter), now)
        counts = struct.pack("<hh", *counts_at(0.003 * n * n))
        for index in (0x1400, 0x1401):
            can_id = module.dictionary.entry(index, 1).value & 0x7FF
            sent += module.receive(Frame(can_id, (counts + bytes([n] * 4))[: 4 + n % 5]), now)
        for index in range(0x1800, 0x1804):
            can_id = module.dictionary.entry(index, 1).value & 0x7FF
            sent += module.receive(Frame(can_id, b"", rtr=True), now)
    return sent
