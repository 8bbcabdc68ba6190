"""`canfb sdo`: objects by name and number, values by the EDS, aborts in words; and docs/monitor.md."""

import math
import re
from decimal import Decimal
from pathlib import Path
from typing import Any

import canopen
import pytest
from hypothesis import example, given, strategies as st

from canfb import CorrectionTable, StatusBit, eds_path
from canfb.cia301 import datatypes
from canfb.cia301.codes import AbortCode
from canfb.cia301.datatypes import DataType
from canfb.device.storage.storage import MemoryStore
from canfb.sdo.object_description import ObjectDescriptions, numbered
from canfb.sdo.sdo_tasks import MODULE, abort_words, in_words, parse_value, short_real, value_range
from commissioning_kit import INTERFACE_ID, MODULE_ID, Bench, running
from documentation import blocks, commands, page
from folding import each
from node_commands import Commands, abort, between, drop_answer, is_write

NODE = hex(MODULE_ID)
PAGE = page("monitor")
PAGE = PAGE.partition("\n## One object of a node")[2].partition("\n## Who is there")[0]
OF_MODULE = ObjectDescriptions(eds_path("canfb-module"), MODULE_ID)


@pytest.fixture
def bench() -> Bench:
    return Bench(sync=False)


@each("text, line", [
    ("residual limit", "2010:01 Supervision: Residual limit: 21845 (0.333328 cycle)"),
    ("RESIDUAL LIM", "2010:01 Supervision: Residual limit: 21845 (0.333328 cycle)"),
    ("residual", "2011:02 Feedback: Residual: 0 (0 cycle)"),
    ("supervision: residual", "2010:01 Supervision: Residual limit: 21845 (0.333328 cycle)"),
    ("recording command", "2050:01 Recording: Command: 0"),
    ("2010:03", "2010:03 Supervision: Samples to coast: 3 samples"),
    ("0x2010:3", "2010:03 Supervision: Samples to coast: 3 samples"),
    ("2002h:03", "2002:03 Conditioning: Sine gain: 1.0"),
    ("6402:01", "6402:01 Work area high limit: Work area high limit channel 1: -1 measuring units"),
    ("1800:01", "1800:01 TPDO 1 communication parameter: COB-ID used by TPDO: 0x400001A0"),
    ("inhibit time emcy", "1015:00 Inhibit time EMCY: 0 x 100 us"),
    ("1008", "1008:00 Manufacturer device name: canfb drive feedback module"),
    ("2020:01", "2020:01 Correction table: Staged table: 1024 bytes; --out FILE writes them to a file"),
    ("crc-32 of the active", "2020:04 Correction table: CRC-32 of the active table: 0x00000000"),
])  # fmt: skip
def test_reading_by_name_and_by_number(canfb: Commands, bench: Bench, text: str, line: str) -> None:
    assert canfb(bench, "sdo", "read", NODE, text)[0] == f"{line}\n"


def test_a_record_is_read_as_a_whole(canfb: Commands, bench: Bench) -> None:
    out = canfb(bench, "sdo", "read", NODE, "supervision")[0]
    assert [line[:7] for line in out.splitlines()] == [f"2010:{n:02X}" for n in range(1, 15)]
    assert canfb(bench, "sdo", "read", NODE, "2010")[0] == out
    mapping = canfb(bench, "sdo", "read", NODE, "1a00")[0].splitlines()
    assert "Number of mapped objects: 3" in mapping[0]
    assert "2020:03" not in canfb(bench, "sdo", "read", NODE, "2020")[0], "write only"
    assert canfb(bench, "sdo", "read", NODE, "1003")[0].startswith("1003:00 "), "no error, and so no more"


def test_the_eds_follows_from_the_node(canfb: Commands, bench: Bench) -> None:
    out = canfb(bench, "sdo", "read", INTERFACE_ID, "sine")[0]
    assert canfb(bench, "sdo", "list", NODE, "nothing")[0] == "no object has 'nothing' in number or name\n"
    assert re.fullmatch(r"6401:01 Read analog input 16-bit: Sine: -?\d+ ADC counts\n", out)


def test_bits_and_states_in_words(canfb: Commands) -> None:
    bench = running(0.2)
    assert canfb(bench, "sdo", "read", NODE, "status word")[0].endswith(": 1 (valid)\n")
    out = canfb(bench, "sdo", "write", NODE, "2030:01", "Start")[0]
    assert out == "2030:01 Reference measurement in the module: Command: 0 -> 1 (start)\n"
    assert "State: 1 (recording)\n" in canfb(bench, "sdo", "read", NODE, "2030:02")[0]
    assert "Residual rms: nan cycles\n" in canfb(bench, "sdo", "read", NODE, "residual rms")[0]
    both = StatusBit.VALID | StatusBit.TABLE_ACTIVE
    assert in_words(MODULE, (0x2011, 1), int(both)) == "valid, table active"
    assert in_words(MODULE, (0x2011, 1), 1 << 15 | 1) == "valid, bit 15"
    assert in_words("another product", (0x2011, 1), 1) == ""
    assert in_words("another product", (0x1001, 0), 0x11) == "generic, communication"


@pytest.mark.parametrize(("text", "value", "data"), [
    ("samples to coast", "0x10", b"\x10"),
    ("largest acceleration", "12.5 rad/s^2", b"\x00\x00\x48\x41"),
    ("residual limit", "0.25", b"\x00\x40"),
    ("residual limit", "0.25cycle", b"\x00\x40"),
    ("inhibit time emcy", "5 x 100 us", b"\x05\x00"),
    ("2002:01", "-3.25", b"\x00\x00\x50\xc0"),
    ("2002:01", "-.325e1", b"\x00\x00\x50\xc0"),
    ("cam 1 low", "-77", b"\xb3\xff\xff\xff"),
    ("1017", "500", b"\xf4\x01"),
])  # fmt: skip
def test_the_canopen_client_reads_what_was_written(
    canfb: Commands, bench: Bench, text: str, value: str, data: bytes
) -> None:
    out = canfb(bench, "sdo", "write", NODE, text, value)[0]
    assert " -> " in out
    index, _, subindex = out.partition(" ")[0].partition(":")
    remote = canopen.RemoteNode(MODULE_ID, canopen.ObjectDictionary())
    bench.master.network.add_node(remote)
    assert remote.sdo.upload(int(index, 16), int(subindex, 16)) == data


def test_a_domain_goes_by_file(canfb: Commands, bench: Bench, tmp_path: Path) -> None:
    path = tmp_path / "table.bin"
    out = canfb(bench, "sdo", "read", NODE, "2020:01", "--out", path)[0]
    assert out == f"{path}: Correction table: Staged table, 1024 bytes\n"
    out = canfb(bench, "sdo", "write", NODE, "2020:01", "--file", path)[0]
    assert out.endswith(", written\n")
    assert bench.value(0x2020, 2) == CorrectionTable.identity().crc32


def test_for_programs(canfb: Commands, bench: Bench) -> None:
    (found,) = canfb(bench, "sdo", "read", NODE, "residual limit", "--json").json
    assert found == {
        "object": "2010:01",
        "name": "Supervision: Residual limit",
        "type": "UNSIGNED16",
        "value": 21845,
        "unit": "1/65536 cycle",
        "words": None,
        "bytes": "5555",
    }
    (nothing,) = canfb(bench, "sdo", "read", NODE, "residual rms", "--json").json
    assert nothing["value"] is None
    said = canfb(bench, "sdo", "write", NODE, "2010:03", "9", "--json").json
    assert (said["before"]["value"], said["now"]["value"], said["written"]["value"]) == (3, 9, 9)


@pytest.mark.parametrize(("arguments", "words"), [
    (("read", "resid"), "'resid' means several objects: 2010:01 Supervision: Residual limit, 2011:02"),
    (("read", "command"), "'command' means several objects: 2030:01 Reference measurement in the module"),
    (("read", "largest amplitude"), "has no object of this name; did you mean 2001:03 Encoder and ADC"),
    (("read", "residul limit"), "no object of this name; did you mean 2010:01 Supervision: Residual limit?"),
    (("read", "zebra"), "canfb drive feedback module has no object of this name; canfb-module.eds has"),
    (("read", "2099"), "2099: canfb drive feedback module has no such object (canfb-module.eds)"),
    (("read", "2010:77"), "2010:77: canfb drive feedback module has no such sub-index"),
    (("read", "--", " : "), "a number such as 2010:01, or the name of an object, is required"),
    (("write", "supervision", "1"), "'supervision' has several entries; which one: 2010:01 Residual limit"),
    (("write", "2010:03", "300"), "Supervision: Samples to coast must be a whole number 0..255, not 300"),
    (("write", "2010:06", "1"), "must be a whole number 2..255, not 1"),
    (("write", "2010:01", "7"), "Residual limit must be 1.52588e-05..0.5 cycle, not '7' (1/65536"),
    (("write", "2010:01", "7 rad"), "..0.5 cycle, not '7 rad' (1/65536 cycle with --raw)"),
    (("write", "2010:01", "inf"), "cycle, not 'inf'"),
    (("write", "2010:03", "x"), "Samples to coast must be a whole number, not 'x'"),
    (("write", "2010:02", "1e99"), "1e+99 is beyond what a REAL32 holds"),
    (("write", "2030:01", "begin"), "or one of the words start, stop, accept, check, finish"),
    (("write", "2020:01", "xyz"), "must be bytes in hexadecimal such as 01FF, not 'xyz'"),
    (("write", "2010:03"), "a VALUE or --file FILE is required, one of them"),
    (("write", "2010:03", "--file", __file__), "Samples to coast: UNSIGNED8 has 1 bytes, not"),
])  # fmt: skip
def test_wrong_use_is_one_line_and_writes_nothing(
    canfb: Commands, bench: Bench, arguments: tuple[str, ...], words: str
) -> None:
    part, *rest = arguments
    _, err = canfb(bench, "sdo", part, NODE, *rest, code=2)
    assert words in err
    sent = [frame for frame in bench.master.sent if frame.can_id == 0x620]
    assert [frame for frame in sent if is_write(frame)] == []


def test_what_the_node_refuses_is_said_in_words(canfb: Commands, bench: Bench) -> None:
    _, err = canfb(bench, "sdo", "write", NODE, "1010:01", "save", code=1)
    (example,) = [line for line in PAGE.splitlines() if line.startswith("canfb: node 32")]
    assert err == f"{example}\n"
    _, err = canfb(bench, "sdo", "write", NODE, "2011:01", "3", code=1)
    assert err == "canfb: 2011:01 Feedback: Status word is read only\n"
    assert "2040:04 is 0" in canfb(bench, "sdo", "write", NODE, "2040:02", "3", code=1)[1], "it has no code"
    _, err = canfb(bench, "sdo", "read", NODE, "activate", code=1)
    assert err == "canfb: 2020:03 Correction table: Activate is write only\n"
    _, err = canfb(bench, "sdo", "write", NODE, "2040:01", "2", code=1)
    assert err.endswith("the node does not take this value; its manual says which ones it takes\n")
    between(bench, lambda frame: abort(frame, 0x06090031) if is_write(frame) else None)
    _, err = canfb(bench, "sdo", "write", NODE, "2010:06", "7", code=1)
    assert "is refused: value of parameter written too high (06090031h); the EDS allows 2.." in err


def test_an_answer_that_is_lost(canfb: Commands, bench: Bench) -> None:
    drop_answer(bench, (0x2010, 3))
    _, err = canfb(bench, "sdo", "write", NODE, "2010:03", "9", code=1)
    assert "writing 2010:03: no answer; is the node on the bus" in err
    between(bench, lambda frame: [] if frame.data[0] == 0x40 and bench.value(0x2010, 3) == 8 else None)
    _, err = canfb(bench, "sdo", "write", NODE, "2010:03", "8", code=1)
    assert "canfb: done: 2010:03 Supervision: Samples to coast is written; but then node 32" in err


FULL = "canfb: /dev/full: cannot be written: No space left on device\n"


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("sdo read 99 2010:03", "node 99 (63h): reading 1018:01: no answer"),
        ("table show 99", "module 99 (63h): reading 2020:04: no answer; is the node on the bus"),
        ("table show 0x10", "module 16 (10h) has no correction table (2020h)"),
        ("backup save 99 backup.yaml", "module 99 (63h): reading 1000:00: no answer"),
        ("backup save 0x10 backup.yaml", "module 16 (10h) is not a feedback module of canfb"),
        ("why 0x10", "canfb: not a feedback module, give the NODE of one: module 16 (10h): reading 2011:08"),
        ("sdo read 0x20 2020:01 --out /dev/full", FULL),
        ("table read 0x20 /dev/full", FULL),
        ("backup save 0x20 /dev/full", FULL),
    ],
)
def test_a_node_that_is_not_there_another_device_and_a_full_disk(
    canfb: Commands, bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, line: str, words: str
) -> None:
    monkeypatch.chdir(tmp_path)
    assert words in canfb(bench, *line.split(), code=1)[1]
    assert not list(tmp_path.iterdir())


def test_a_node_of_another_maker(canfb: Commands, bench: Bench, tmp_path: Path) -> None:
    bench.module.dictionary.entry(0x1018, 2).value = 99
    _, err = canfb(bench, "sdo", "read", NODE, "2010:03", code=2)
    assert "product 99 of vendor 0, which is not of canfb: give its EDS with --eds FILE" in err
    eds = tmp_path / "their.eds"
    eds.write_text(
        "[DeviceInfo]\nProductName=their drive\n"
        "[2010]\nParameterName=Something\nObjectType=0x9\nSubNumber=2\n"
        "[2010sub3]\nParameterName=Gain\nDataType=0x0006\nAccessType=rw\nUnit=apples\n"
        "[2020]\nParameterName=Blob\nObjectType=0x2\nDefaultValue=none\n"
        "[1010]\nParameterName=Store\n[1010sub1]\nParameterName=All\nDataType=0x0005\nAccessType=rw\n"
    )
    out = canfb(bench, "sdo", "read", NODE, "gain", "--eds", eds)[0]
    assert out == "2010:03 Something: Gain: 03 (1 bytes, the EDS has UNSIGNED16)\n"
    _, err = canfb(bench, "sdo", "write", NODE, "gain", "3", "--eds", eds, code=1)
    assert "the type in the EDS differs from that of the node: give its own EDS with --eds" in err
    _, err = canfb(bench, "sdo", "write", NODE, "1010:01", "save", "--eds", eds, code=2)
    assert err.startswith("canfb: 1010:01 Store: All 1702257011 is not a UNSIGNED8")


@pytest.mark.parametrize("unused", [b"", b"\0", b"\x12\x34"])
def test_the_type_says_how_many_bytes_of_an_expedited_answer_are_used(unused: bytes) -> None:
    (limit,) = OF_MODULE.meant("2010:01")  # UNSIGNED16
    assert limit.decode(b"\x07\x01" + unused) == 0x107
    with pytest.raises(ValueError, match="has 2 bytes, not 1"):
        limit.decode(b"\x07")


def test_an_eds_that_is_none(canfb: Commands, bench: Bench, tmp_path: Path) -> None:
    path = tmp_path / "bad.eds"
    path.write_text("nonsense")
    _, err = canfb(bench, "sdo", "read", NODE, "2010:01", "--eds", path, code=1)
    assert "not an EDS: " in err
    _, err = canfb(bench, "sdo", "read", NODE, "2010:01", "--eds", tmp_path / "none.eds", code=1)
    assert "cannot be read: No such file" in err


def test_the_commands_of_the_page_run(
    canfb: Commands, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    bench = running(0.2, store=MemoryStore())
    Path("drive.eds").write_bytes(eds_path("drive").read_bytes())
    *good, bad = (words for words in commands(PAGE) if words[0] == "sdo")
    said = [canfb(bench, *words)[0] for words in good]
    shown = blocks(PAGE, "text")[0].splitlines()
    assert [said[0], said[3]] == [f"{shown[0]}\n", f"{shown[2]}\n"]
    assert said[2].startswith(shown[1].partition("129")[0])
    _, err = canfb(bench, *bad, code=1)
    assert "no answer" in err


def test_every_entry_of_ours_is_found_by_its_full_name() -> None:
    names = [entry.name for entry in OF_MODULE]
    for entry in OF_MODULE:
        if (entry.subindex or not entry.parent) and (entry.parent or names.count(entry.name) == 1):
            assert entry in OF_MODULE.meant(entry.title)


@given(st.integers(0x1000, 0xFFFF), st.integers(0, 255))
def test_numbers_of_objects(index: int, subindex: int) -> None:
    for text in (f"{index:04X}:{subindex:02X}", f"0x{index:x}:{subindex:x}", f"{index:04x}h:{subindex:02x}h"):
        assert numbered(text) == (index, subindex)
    assert numbered(f"{index:04X}") == (index, None)


INTEGERS = sorted(
    code for code in datatypes.KNOWN if value_range(code)[1] > 1 and code not in {*datatypes.FLOATS, 12, 13}
)


@given(st.data(), st.sampled_from(INTEGERS))
def test_integers_of_every_type_within_their_range(data: st.DataObject, code: int) -> None:
    low, high = map(int, value_range(code))
    value = data.draw(st.integers(low, high))
    for text in (str(value), hex(value)):
        assert datatypes.decode(code, datatypes.encode(code, parse_value(code, text))) == value
    for beyond in (low - 1, high + 1):
        with pytest.raises(ValueError, match="must be a whole number"):
            parse_value(code, str(beyond))


def digits(value: float) -> int:
    """Significant ones, as it is written."""
    return len(Decimal(repr(value)).normalize().as_tuple().digits)


@given(st.floats(width=32, allow_nan=False))
@example(999999986991104.0)
def test_the_short_form_of_a_real32_is_the_same_number(value: float) -> None:
    short = short_real(value)
    assert parse_value(DataType.REAL32, str(short), short, short) == value
    if math.isfinite(value):
        with pytest.raises(ValueError, match="must be a number"):
            parse_value(DataType.REAL32, str(short), math.nextafter(short, math.inf))
    assert digits(short) <= digits(value)
    assert math.copysign(1, short) == math.copysign(1, value)


@given(st.integers(0, 0xFFFFFFFF))
def test_every_abort_code_has_words(code: int) -> None:
    (status,) = OF_MODULE.meant("2011:01")
    for one in (code, *AbortCode):
        words: Any = abort_words(int(one), status, "")
        assert f"({int(one):08X}h)" in words
        assert "\n" not in words


def test_a_preset_in_motion_says_what_it_needs(canfb: Commands) -> None:
    bench = running(rpm=600.0)
    for preset in ("6003", "6009"):
        _, err = canfb(bench, "sdo", "write", NODE, preset, "0", code=1)
        assert "(08000022h); a preset needs a valid position at standstill: stop the machine" in err
        assert "preop" not in err
    of_others = abort_words(AbortCode.DEVICE_STATE, OF_MODULE.meant("6003")[0], "drive of somebody")
    assert "canfb node preop" in of_others, "the general advice"
