"""The configuration of a module, loaded into others: whatever they held before, they are that module then."""

import struct
import sys
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest.mock import patch

import canopen
import dcf
import dcf.cli
import pytest
from hypothesis import example, given, strategies as st
from module_bench import Bench

from canfb import Conditioning, FeedbackModule, Frame, ModuleConfig, SecondPositionConfig, StatusBit, eds_path
from canfb.cia301 import datatypes
from canfb.cia301.codes import SdoAbort
from canfb.cia301.datatypes import DataType
from canfb.device.od.dcf import Reals, Write, dcf_text, decode_concise, encode_concise, real_as_text
from canfb.device.od.dictionary import Entry
from canfb.module.device_configuration import DeviceConfiguration, configuration_of, configuration_read
from drawing import examples
from ideal_tracks import counts_at, wavy_table

NODE_ID = 32
RESET_NODE, START = Frame(0, bytes([0x81, NODE_ID])), Frame(0, bytes([0x01, NODE_ID]))
PDOS = (0x1400, 0x1401, 0x1800, 0x1801, 0x1802, 0x1803)
TEMPLATE = FeedbackModule(ModuleConfig(node_id=NODE_ID))
SETTINGS = list(TEMPLATE.storage.entries.settings())


def mappable(access: tuple[str, ...]) -> list[int]:
    """Mapping entries of all objects that a PDO of this direction takes."""
    entries = [entry for entry in TEMPLATE.dictionary if entry.pdo_mappable and entry.access in access]
    return [entry.index << 16 | entry.subindex << 8 | entry.bit_length for entry in entries]


TRANSMITTED, RECEIVED = mappable(("ro", "rw", "rwr", "const")), [*mappable(("rw", "rww")), 0x00050008]
CAN_IDS = st.sampled_from([0x90, 0xA0, 0xB0, 0x181, 0x190, 0x1A0, 0x2A0, 0x320, 0x3A0, 0x4A0, 0x500, 0x6C0])


def write(index: int, subindex: int, size: int, value: int) -> Write:
    return Write(index, subindex, value.to_bytes(size, "little"))


@st.composite
def pdo(draw: st.DrawFn) -> list[Write]:
    """A PDO as a master sets it up, in the order of CiA 301."""
    index = draw(st.sampled_from(PDOS))
    mapped = draw(st.lists(st.sampled_from(TRANSMITTED if index >= 0x1800 else RECEIVED), max_size=4))
    flags = draw(st.sampled_from([0, 1 << 30, 1 << 31, 3 << 30]))
    return [
        write(index, 1, 4, 1 << 31),
        write(index + 0x200, 0, 1, 0),
        *(write(index + 0x200, place, 4, one) for place, one in enumerate(mapped, 1)),
        write(index + 0x200, 0, 1, draw(st.integers(0, len(mapped)))),
        write(index, 2, 1, draw(st.sampled_from([0, 1, 2, 5, 240, 252, 253, 254, 255]))),
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
            Write(0x2020, 1, wavy_table(*one).to_bytes()),
            write(0x2020, 3, 4, wavy_table(*one).crc32),
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
    assert put(module, write(0x2020, 3, 4, module.dictionary.entry(0x2020, 4).value)) == 0


def state(module: FeedbackModule) -> dict[Any, Any]:
    """Every parameter, the table, and what of it the signal chain has."""
    active = module.chain.correction.conditioning
    return {
        **configuration_of(module).values(),
        "offset": module.dictionary.entry(0x6509).value,
        "resolution": module.dictionary.entry(0x6501).value,
        "conditioning": [datatypes.encode(DataType.REAL32, value) for value in vars(active).values()],
        "autostart": module.dictionary.entry(0x1F80).value,
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


SIXTEEN_BITS = [write(0x2001, 2, 2, 32768), write(0x2001, 4, 2, 40960), write(0x2001, 3, 2, 6554)]
NARROW = [write(0x2001, 3, 2, 1), write(0x2001, 4, 2, 2)]
WATCHING = [write(0x1016, sub, 4, sub << 16 | 100) for sub in (1, 2)]
WATCHING_OTHERWISE = [write(0x1016, sub, 4, (3 - sub) << 16 | 100) for sub in (1, 2)]
COUNTING = [write(0x1019, 0, 1, 10), write(0x1006, 0, 4, 1000), write(0x1005, 0, 4, 0x40000080)]
MOVED_EMCY = [write(0x1014, 0, 4, 1 << 31), write(0x1014, 0, 4, 0x90)]


@pytest.fixture(scope="module")
def modules() -> tuple[FeedbackModule, FeedbackModule]:
    """Two of them, as delivered; every example resets both."""
    return FeedbackModule(ModuleConfig(node_id=NODE_ID)), FeedbackModule(ModuleConfig(node_id=NODE_ID))


def begun(modules: tuple[FeedbackModule, FeedbackModule], *programs: list[Write]) -> Iterator[FeedbackModule]:
    for module, program in zip(modules, programs, strict=True):
        reset(module)
        run(module, program)
        yield module


@given(PROGRAMS, PROGRAMS)
@example(SIXTEEN_BITS, [])
@example([], SIXTEEN_BITS)
@example(NARROW, SIXTEEN_BITS)
@example(SIXTEEN_BITS, NARROW)
@example(WATCHING, WATCHING_OTHERWISE)
@example(COUNTING, [])
@example([], COUNTING)
@example([*COUNTING[:2], write(0x1005, 0, 4, 0x40000090)], COUNTING)
@example([*COUNTING, *MOVED_EMCY], [write(0x1014, 0, 4, 0xA1)])
@examples(60)
def test_the_writes_are_taken_whatever_the_module_held_and_make_it_the_same(
    modules: tuple[FeedbackModule, FeedbackModule], wanted: list[Write], before: list[Write]
) -> None:
    source, target = begun(modules, wanted, before)
    configuration = configuration_of(source)
    refused = [(one, code) for one in configuration.writes() if (code := put(target, one))]
    assert refused == []
    assert state(target) == state(source)
    assert configuration_of(target).writes() == configuration.writes()


@given(PROGRAMS)
@examples(25)
def test_a_module_that_was_loaded_answers_the_same_frames_with_the_same_frames(
    modules: tuple[FeedbackModule, FeedbackModule], wanted: list[Write]
) -> None:
    source, target = begun(modules, wanted, [])
    for one in configuration_of(source).writes():
        assert put(target, one) == 0
    # Both begin here: what was sent and cleared while they were written is another matter.
    for module in modules:
        module.tick(0.0)
    assert played(target) == played(source)


def test_over_the_bus_with_a_table_from_bytes() -> None:
    """A master that knows nothing but the concise DCF: SDO writes in Pre-operational, one after the other."""
    source = FeedbackModule(ModuleConfig(node_id=NODE_ID, conditioning=Conditioning(phase_error_rad=0.25)))
    source.start(0.0)
    wanted = wavy_table(100, 0.02)
    run(source, [Write(0x2020, 1, wanted.to_bytes()), write(0x2020, 3, 4, wanted.crc32)])
    bench = Bench()
    for one in decode_concise(encode_concise(configuration_of(source).writes())):
        bench.sdo.download(one.index, one.subindex, one.data)
    assert bench.module.chain.correction.table == wanted
    assert bench.module.chain.correction.conditioning == Conditioning(phase_error_rad=0.25)
    assert state(bench.module) == state(source)
    read = configuration_read(
        NODE_ID, lambda entry: bench.module.dictionary.entry(entry.index, entry.subindex).value, 0,
        bench.sdo.upload(0x2020, 1),
    )  # fmt: skip
    assert read.writes() == configuration_of(source).writes()
    assert read.table_crc32 == wanted.crc32 == zlib.crc32(wanted.to_bytes())
    assert read.values().items() - read.values(with_table=False).items() == {((0x2020, 1), wanted.to_bytes())}


@pytest.mark.parametrize(("program", "refused"), [
    (COUNTING, [(0x1019, 0)]),
    (MOVED_EMCY, [(0x1014, 0)]),
    (SIXTEEN_BITS, []),
    ([write(0x1006, 0, 4, 1000)], []),
])  # fmt: skip
def test_what_a_master_cannot_write_in_the_order_of_the_indices(
    modules: tuple[FeedbackModule, FeedbackModule], program: list[Write], refused: list[tuple[int, int]]
) -> None:
    reset(modules[0])
    run(modules[0], program)
    assert configuration_of(modules[0]).refused_in_index_order() == refused


def test_amplitudes_in_disorder_accept_nothing_and_are_loaded_as_they_are() -> None:
    bench = Bench()
    bench.start()
    assert bench.at(0.0)[1] & StatusBit.VALID
    for one in (write(0x2001, 2, 2, 32768), write(0x2001, 3, 2, 6554), write(0x2001, 2, 2, 2048)):
        assert put(bench.module, one) == 0
    assert bench.at(0.0)[1] & StatusBit.AMPLITUDE
    target = FeedbackModule(ModuleConfig(node_id=NODE_ID))
    target.start(0.0)
    assert not any(put(target, one) for one in configuration_of(bench.module).writes())
    assert state(target) == state(bench.module)
    assert put(bench.module, write(0x2001, 4, 2, 40960)) == 0, "that ends the disorder"
    assert not any(put(target, one) for one in configuration_of(bench.module).writes())
    assert {put(one, write(0x2001, 3, 2, 40960)) for one in (bench.module, target)} == {0x06090030}


TABLE = wavy_table(256, 0.015)
WITH_TABLE = [Write(0x2020, 1, TABLE.to_bytes()), write(0x2020, 3, 4, TABLE.crc32)]
OTHER_PDOS = [write(*one) for one in (
    (0x1802, 1, 4, 0x800003A0), (0x1A02, 1, 4, 0x20110740),  # 64 bits of a REAL32: refused
    (0x1A02, 1, 4, 0x20110720), (0x1A02, 2, 4, 0x20110510), (0x1A02, 0, 1, 2), (0x1802, 2, 1, 254),
    (0x1802, 3, 2, 15), (0x1802, 5, 2, 100), (0x1802, 1, 4, 0x400003A0),
    (0x1401, 1, 4, 0x80000310), (0x1601, 1, 4, 0x20000310), (0x1601, 2, 4, 0x00050008),  # a gap
    (0x1601, 0, 1, 2), (0x1401, 2, 1, 1), (0x1401, 1, 4, 0x310),
)]  # fmt: skip
APPLICATION = [write(*one) for one in (
    (0x1017, 0, 2, 500), (0x1016, 1, 4, 0x0005_0064), (0x1029, 1, 1, 2), (0x6000, 0, 2, 4),
    (0x6001, 0, 4, 3600), (0x6301, 1, 1, 0x0F), (0x6310, 1, 4, (1 << 32) - 200),  # -200
    (0x6330, 1, 2, 25),
)]  # fmt: skip
CONDITIONING = Conditioning(12.5, -3.25, 1.0371, 0.93, -0.0213)
SECOND = SecondPositionConfig(increments=4096, revolutions=3, reversed=True, cob_id=0x1B0, before_bytes=3,
                              tolerance_revolutions=0.01, invalidates=True)  # fmt: skip
SOURCES: dict[str, tuple[dict[str, Any], list[Write]]] = {
    "as delivered": ({}, []),
    "16 bits": (
        {"adc_bits": 16, "cycles_per_revolution": 1024, "encoder_interface": 0x11, "frozen_samples": 3},
        [],
    ),
    "conditioning": (
        {"conditioning": CONDITIONING, "max_acceleration_rad_s2": 1234.567, "residual_limit": 0.25},
        [],
    ),
    "a second position": ({"second_position": SECOND}, []),
    "table": ({"conditioning": CONDITIONING, "adc_bits": 14}, WITH_TABLE),
    "not valid": ({}, [write(0x1801, 2, 1, 0xFC), write(0x1801, 1, 4, 0xC0000500)]),
    "PDOs": ({"coast_samples": 11, "autostart": True}, OTHER_PDOS),
    "all": ({"adc_bits": 16, "conditioning": CONDITIONING}, [*OTHER_PDOS, *APPLICATION, *WITH_TABLE]),
}


def source(name: str) -> FeedbackModule:
    fields, program = SOURCES[name]
    module = FeedbackModule(ModuleConfig(node_id=NODE_ID, **fields))
    module.start(0.0)
    run(module, program)
    return module


def write_dcf(folder: Path, configuration: DeviceConfiguration, reals: Reals = Reals.DECIMAL) -> Path:
    text = dcf_text(
        eds_path("canfb-module"),
        configuration.values(),
        file_name="module.dcf",
        description="A module",
        date="11-21-2026",
        time="08:00AM",
        node_id=configuration.node_id,
        node_name="module_20h",
        bit_rate_kbit_s=500,
        network_name="CANopen",
        serial_number=configuration.serial_number,
        reals=reals,
    )
    path = folder / "module.dcf"
    path.write_bytes(text.encode("ascii"))
    return path


@pytest.mark.parametrize("name", SOURCES)
def test_python_canopen_makes_a_module_as_delivered_the_same(name: str, tmp_path: Path) -> None:
    wanted = source(name)
    bench, dcf = Bench(), write_dcf(tmp_path, configuration_of(wanted))
    remote = canopen.RemoteNode(NODE_ID, canopen.import_od(str(dcf)))
    bench.network.add_node(remote)
    remote.load_configuration()
    assert state(bench.module) == state(wanted)
    assert configuration_of(bench.module).writes() == configuration_of(wanted).writes()
    frames = played(wanted)
    assert played(bench.module) == frames
    assert len(frames) > 30


def test_python_canopen_knows_node_and_bit_rate(tmp_path: Path) -> None:
    od: Any = canopen.import_od(str(write_dcf(tmp_path, configuration_of(source("all")))))
    assert (od.node_id, od.bitrate) == (NODE_ID, 500_000)
    assert od[0x1800][1].value == 0x400001A0
    assert od[0x2020][1].value == TABLE.to_bytes()
    assert od[0x6003].value is None


def dcfchk(path: Path) -> None:
    """As the command; what it warns of is an error."""
    with patch.object(sys, "argv", ["dcfchk", "-n", str(NODE_ID), str(path)]):
        dcf.cli.main()


@pytest.mark.parametrize(("name", "reals"), [
    ("as delivered", Reals.DECIMAL), ("16 bits", Reals.DECIMAL), ("PDOs", Reals.DECIMAL),
    *((name, Reals.IEEE754) for name in SOURCES),
])  # fmt: skip
def test_dcfchk_accepts_it(name: str, reals: Reals, tmp_path: Path) -> None:
    dcfchk(write_dcf(tmp_path, configuration_of(source(name)), reals))


def test_dcfchk_takes_bits_for_a_real32_and_no_decimal_fraction(tmp_path: Path) -> None:
    """Why there are two ways to write them."""
    path = write_dcf(tmp_path, configuration_of(source("conditioning")))
    with pytest.warns(match="invalid ParameterValue") as said, pytest.raises(SystemExit):
        dcfchk(path)
    assert str(said[0].message) == "invalid ParameterValue in [2002sub1]: 12.5"


@pytest.mark.parametrize("name", SOURCES)
def test_the_concise_form_is_what_dcf_tools_make_of_the_values(name: str, tmp_path: Path) -> None:
    """Each write that sets an object for good, byte for byte.

    dcfgen itself takes ParameterValue for what the device holds already, and writes none of them.
    """
    configuration = configuration_of(source(name))
    device = dcf.Device.from_dcf(str(write_dcf(tmp_path, configuration, Reals.IEEE754)), {"NODEID": NODE_ID})
    final = {(one.index, one.subindex): one for one in configuration.writes()}
    assert set(final) == set(configuration.values())
    for place, one in final.items():
        object_ = device[place[0]][place[1]]
        if object_.data_type.index == 0x0F:
            assert object_.parse_value() == one.data
        else:
            packed = object_.data_type.concise_value(*place, object_.parse_value())
            assert encode_concise([one])[4:] == packed, place


@given(st.floats(width=32, allow_nan=False, allow_infinity=False))
@examples(100)
def test_every_real32_comes_back_from_both_ways(value: float) -> None:
    data = struct.pack("<f", value)
    assert struct.pack("<f", float(real_as_text(8, value, Reals.DECIMAL))) == data
    assert struct.pack("<I", int(real_as_text(8, value, Reals.IEEE754), 0)) == data
