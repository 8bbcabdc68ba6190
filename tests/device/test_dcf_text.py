"""A DCF from an EDS: where the values stand, how they are written; and the concise one of CiA 302-3."""

from pathlib import Path
from typing import Any

import pytest
import sample_eds
from hypothesis import given, strategies as st

from canfb.device.od import eds
from canfb.device.od.dcf import Write, dcf_text, decode_concise, encode_concise
from canfb.device.od.dictionary import Dictionary

INFO: dict[str, Any] = {"file_name": "node.dcf", "description": "A node", "date": "11-21-2026"}
INFO |= {"time": "08:15PM", "node_id": 5, "node_name": "node", "network_name": "can0", "serial_number": 4711}
COMPACT = """
[2A00]
ParameterName=List
ObjectType=0x8
DataType=0x0003
AccessType=rw
DefaultValue=0x0010
CompactSubObj=3
[2A01]
ParameterName=Command
ObjectType=0x7
DataType=0x0005
AccessType=wo
ObjFlags=0x3
[2A02]
ParameterName=Content
ObjectType=0x2
ObjFlags=001
[2A03]
ParameterName=Name
ObjectType=0x7
DataType=011
AccessType=rw
[2A04]
ParameterName=Switch
ObjectType=0x7
DataType=0x0001
AccessType=rw
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = sample_eds.write(tmp_path / "sample.eds", sample_eds.ROWS)
    path.write_text(path.read_text() + COMPACT)
    return path


def written(path: Path, values: dict[tuple[int, int], Any], **more: Any) -> eds.Contents:
    """The DCF, read again as an EDS is."""
    dcf = path.with_suffix(".dcf")
    dcf.write_bytes(dcf_text(path, values, **{"bit_rate_kbit_s": 250} | INFO | more).encode("ascii"))
    return eds.read(dcf)


def test_file_info_and_commissioning(path: Path) -> None:
    dcf = written(path, {})
    assert dcf["DeviceComissioning"] == {
        "NodeID": "0x05",
        "NodeName": "node",
        "Baudrate": "250",
        "NetNumber": "0",
        "NetworkName": "can0",
        "CANopenManager": "0",
        "LSS_SerialNumber": "4711",
    }
    info = dcf["FileInfo"]
    assert (info["FileName"], info["LastEDS"]) == ("node.dcf", "sample.eds")
    assert (info["CreationDate"], info["CreationTime"]) == ("11-21-2026", "08:15PM")
    assert (info["ModificationDate"], info["ModificationTime"]) == ("11-21-2026", "08:15PM")
    assert list(dcf).index("DeviceComissioning") == list(dcf).index("DeviceInfo") + 1


def test_a_bit_rate_that_is_not_known_is_left_out(path: Path) -> None:
    text = dcf_text(path, {}, bit_rate_kbit_s=None, **INFO)
    assert "Baudrate" not in text
    assert text.count("\n") == text.count("\r\n") > 100, "lines end as on the systems of the masters"


def test_values_are_written_as_the_eds_writes_its_defaults(path: Path) -> None:
    values = {(0x1005, 0): 0x90, (0x2A00, 2): -2, (0x2A00, 3): 255, (0x2A01, 0): 7}
    dcf = written(path, values | {(0x2A02, 0): b"\x01\xab", (0x2A03, 0): "left", (0x2A04, 0): True})
    assert dcf["1005"]["ParameterValue"] == "0x00000090"
    assert dcf["2A00sub2"]["ParameterValue"] == "-2"
    assert dcf["2A00sub3"]["ParameterValue"] == "0x00FF"
    assert dcf["2A01"]["ParameterValue"] == "7"
    assert [dcf[name]["ParameterValue"] for name in ("2A02", "2A03", "2A04")] == ["01AB", "left", "1"]
    assert "ParameterValue" not in dcf["2A00sub1"]
    assert dcf["2A00sub2"]["DefaultValue"] == "0x0010"


def test_what_has_a_value_or_a_file_may_be_loaded(path: Path) -> None:
    dcf = written(path, {(0x2A01, 0): 1}, files={(0x2A02, 0): "content.bin"})
    assert dcf["2A01"]["ObjFlags"] == "0x2"
    assert dcf["2A02"]["ObjFlags"] == "0x0"
    assert dcf["2A02"]["DownloadFile"] == "content.bin"
    assert "ParameterValue" not in dcf["2A02"]
    assert written(path, {})["2A01"]["ObjFlags"] == "0x3"


def test_the_rest_is_the_eds(path: Path) -> None:
    """And so it can be loaded as one."""
    before, after = eds.read(path), written(path, {(0x1005, 0): 0x90})
    kept = [name for name in before if name not in ("FileInfo", "1005")]
    assert {name: before[name] for name in kept} == {name: after[name] for name in kept}
    loaded = Dictionary.load(path.with_suffix(".dcf"), 5)
    assert [(one.index, one.subindex) for one in loaded] == [
        (one.index, one.subindex) for one in Dictionary.load(path, 5)
    ]


def test_a_value_for_what_the_eds_does_not_have(path: Path) -> None:
    with pytest.raises(ValueError, match="2A00h:04 is not in the EDS"):
        written(path, {(0x2A00, 4): 1})


WRITES = st.lists(st.builds(Write, st.integers(0, 0xFFFF), st.integers(0, 0xFF), st.binary(max_size=20)))


def test_the_bytes_of_the_standard() -> None:
    writes = [Write(0x1017, 0, b"\xf4\x01"), Write(0x1400, 1, bytes.fromhex("90010080"))]
    wanted = "02000000 1710 00 02000000 f401 0014 01 04000000 90010080"
    assert encode_concise(writes) == bytes.fromhex(wanted.replace(" ", ""))


@given(WRITES)
def test_there_and_back(writes: list[Write]) -> None:
    assert decode_concise(encode_concise(writes)) == writes


@given(WRITES, st.integers(1, 30))
def test_a_part_of_it_is_refused(writes: list[Write], cut: int) -> None:
    data = encode_concise(writes)
    with pytest.raises(ValueError, match="concise DCF"):
        decode_concise(data[: max(0, len(data) - cut)])
    with pytest.raises(ValueError, match="follow the last entry"):
        decode_concise(data + bytes(cut))


@given(st.binary(max_size=60))
def test_any_bytes_are_one_or_are_refused(data: bytes) -> None:
    try:
        writes = decode_concise(data)
    except ValueError:
        return
    assert encode_concise(writes) == data
