from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.eds_files import eds_path
from tools.eds import check

MODULE, INTERFACE = "canfb-module.eds", "encoder-interface.eds"
TEXTS = {name: eds_path(name).read_text(encoding="ascii") for name in (MODULE, INTERFACE)}


def put(section: str, key: str, value: str) -> Callable[[str], str]:
    """Give one key of one section another value, or add it."""

    def mutate(text: str) -> str:
        head, start, rest = text.partition(f"[{section}]\n")
        body, gap, tail = rest.partition("\n\n")
        lines = [line for line in body.splitlines() if not line.startswith(f"{key}=")]
        return head + start + "\n".join([*lines, f"{key}={value}"]) + gap + tail

    return mutate


def drop(section: str, key: str | None = None) -> Callable[[str], str]:
    """Delete one key of one section, or the whole section."""

    def mutate(text: str) -> str:
        head, start, rest = text.partition(f"[{section}]\n")
        body, gap, tail = rest.partition("\n\n")
        if key is None:
            return head + tail
        lines = [line for line in body.splitlines() if not line.startswith(f"{key}=")]
        return head + start + "\n".join(lines) + gap + tail

    return mutate


def swap(old: str, new: str) -> Callable[[str], str]:
    return lambda text: text.replace(old, new, 1)


MUTATIONS = [
    # form of the file
    ("DummyUsage", "section is missing", drop("DummyUsage")),
    ("Comments", "section is missing", drop("Comments")),
    (MODULE, "already exists", swap("[6001]", "[6000]")),
    (MODULE, "already exists", swap("[6000]\n", "[6000]\nObjectType=0x7\n")),
    (MODULE, "not an EDS", swap("[6000]\n", "[6000]\nno value here\n")),
    ("line 6", "is not ASCII", swap("EDSVersion=4.0\n", "EDSVersion=4.0\n;°\n")),
    ("line 6", "longer than 255", swap("EDSVersion=4.0\n", "EDSVersion=4.0\n" + ";" * 256 + "\n")),
    ("Comments", "Lines is not", put("Comments", "Lines", "1")),
    ("Comments", "line2 is longer than 249", put("Comments", "Line2", "x" * 249 + "y")),
    # FileInfo, DeviceInfo, DummyUsage
    ("FileInfo", "FileVersion is above 255", put("FileInfo", "FileVersion", "256")),
    ("FileInfo", "modified before", put("FileInfo", "ModificationDate", "11-20-2026")),
    ("DeviceInfo", "ProductName is missing or longer", put("DeviceInfo", "ProductName", "x" * 244)),
    ("DeviceInfo", "OrderCode is missing or longer", put("DeviceInfo", "OrderCode", "")),
    ("DeviceInfo", "CompactPDO is not 0", put("DeviceInfo", "CompactPDO", "1")),
    ("DeviceInfo", "DynamicChannelsSupported is not 0", put("DeviceInfo", "DynamicChannelsSupported", "1")),
    ("DeviceInfo", "no multiplexed PDOs", put("DeviceInfo", "GroupMessaging", "1")),
    ("DeviceInfo", "are multiplexed PDOs", put("1A03sub0", "DefaultValue", "254")),
    ("DeviceInfo", "no BaudRate", lambda text: re.sub(r"(BaudRate_\d+)=1", r"\1=0", text)),
    ("FileInfo", "FileName is not", put("FileInfo", "FileName", "other.eds")),
    ("DeviceInfo", "BaudRate_125", put("DeviceInfo", "BaudRate_125", "2")),
    ("DeviceInfo", "Granularity", put("DeviceInfo", "Granularity", "65")),
    ("DeviceInfo", "Granularity is 0 where", put("DeviceInfo", "Granularity", "0")),
    ("1600sub1", "shorter than Granularity", put("DeviceInfo", "Granularity", "32")),
    ("DummyUsage", "shorter than Granularity", put("DeviceInfo", "Granularity", "16")),
    ("DeviceInfo", "NrOfRXPDO is not 3", put("DeviceInfo", "NrOfRXPDO", "4")),
    ("DeviceInfo", "NrOfTXPDO is not 4", put("DeviceInfo", "NrOfTXPDO", "0")),
    ("6004", "but NrOfTXPDO=0", put("DeviceInfo", "NrOfTXPDO", "0")),
    ("DummyUsage", "Dummy0003", drop("DummyUsage", "Dummy0003")),
    # object lists
    ("OptionalObjects", "not in ascending order", swap("2=0x1005\n3=0x1006\n", "2=0x1006\n3=0x1005\n")),
    # objects and entries
    ("2011sub0", "highest sub-index", put("2011sub0", "DefaultValue", "9")),
    ("1016sub2", "CiA 301 gives it DataType=0x0007", put("1016sub2", "DataType", "0x0006")),
    ("1018", "CiA 301 gives it ObjectType=0x9", put("1018", "ObjectType", "0x8")),
    ("1800sub2", "CiA 301 gives it DataType=0x0005", put("1800sub2", "DataType", "0x0006")),
    ("2012", "not one of ours", put("2012", "ObjectType", "0x5")),
    ("6004", "ObjectType does not fit", put("6004", "ObjectType", "0x2")),
    ("2020sub1", "ObjectType does not fit", put("2020sub1", "ObjectType", "0x7")),
    ("6004", "ParameterName is missing", put("6004", "ParameterName", "")),
    ("6004", "PDOMapping is missing", drop("6004", "PDOMapping")),
    ("1021", "PDOMapping is not for a DOMAIN", put("1021", "PDOMapping", "0")),
    ("2000sub1", "gives no PDO direction", put("2000sub1", "AccessType", "rw")),
    ("6000", "is for PDO mapping", put("6000", "AccessType", "rww")),
    ("1008", "VISIBLE_STRING cannot be mapped", put("1008", "PDOMapping", "1")),
    ("2001sub1", "HighLimit=$NODEID", put("2001sub1", "HighLimit", "$NODEID+0x1000")),
    ("2020sub1", "row of hexadecimal", put("2020sub1", "DefaultValue", "abc")),
    ("6004", "ParameterName is longer than 241", put("6004", "ParameterName", "x" * 242)),
    ("2011sub1", "ParameterName is longer than 241", put("2011sub1", "ParameterName", "x" * 242)),
    ("6004", "ObjFlags is not", put("6004", "ObjFlags", "4")),
    # what CiA 301 gives the objects below 2000h
    ("1000", "AccessType=rw is not ro or const", put("1000", "AccessType", "rw")),
    ("1018sub1", "AccessType=rw is not ro or const", put("1018sub1", "AccessType", "rw")),
    ("1016sub1", "AccessType=ro is not rw", put("1016sub1", "AccessType", "ro")),
    ("1003sub1", "AccessType=rw is not ro", put("1003sub1", "AccessType", "rw")),
    ("1003sub0", "AccessType=ro is not rw", put("1003sub0", "AccessType", "ro")),
    ("1017", "AccessType=wo is not ro or const or rw", put("1017", "AccessType", "wo")),
    ("2011sub0", "AccessType=rw is not ro or const", put("2011sub0", "AccessType", "rw")),
    ("1A00sub0", "AccessType=wo is not ro or const or rw", put("1A00sub0", "AccessType", "wo")),
    ("1006", "CiA 301 lets no PDO carry it", put("1006", "PDOMapping", "1")),
    ("1005", "the CAN-ID 80h", put("1005", "DefaultValue", "0x81")),
    ("1014", "the CAN-ID $NODEID+80h", put("1014", "DefaultValue", "0x80")),
    ("1019", "means nothing without 1005h", drop("1005")),
    ("1015", "means nothing without 1014h", drop("1014")),
    ("OptionalObjects", "neither heartbeat", lambda text: drop("100C")(drop("1017")(text))),
    (
        "DeviceInfo",
        "there is no 1F80h",
        lambda t: drop("1F80")(put("DeviceInfo", "SimpleBootUpMaster", "1")(t)),
    ),
    ("1F80", "makes it the NMT master", put("1F80", "DefaultValue", "1")),
    # PDO and COB-ID
    ("1A03", "only one of communication and mapping", drop("1803")),
    ("1803", "sub-index 1 or 2", drop("1803sub2")),
    ("1800", "no communication parameter 04h", swap("[1800sub5]", "[1800sub4]")),
    ("1400", "no communication parameter 06h", swap("[1400sub5]", "[1400sub6]")),
    ("1800sub2", "no transmission type of a TPDO", put("1800sub2", "DefaultValue", "241")),
    ("1400sub2", "no transmission type of a RPDO", put("1400sub2", "DefaultValue", "252")),
    ("1A00", "does not count 0..8", put("1A00sub0", "DefaultValue", "9")),
    ("1A00sub0", "writable or not", put("1A00sub0", "AccessType", "ro")),
    ("1A00sub1", "6005h:00 does not exist", put("1A00sub1", "DefaultValue", "0x60050020")),
    ("1A00sub1", "2000h:05 must not be mapped into a TPDO", put("1A00sub1", "DefaultValue", "0x20000520")),
    ("1600sub1", "2011h:01 must not be mapped into a RPDO", put("1600sub1", "DefaultValue", "0x20110110")),
    ("1A00sub1", "6004h:00 must not be mapped", put("6004", "PDOMapping", "0")),
    ("1A00sub4", "1017h:00 must not be mapped", put("1A00sub4", "DefaultValue", "0x10170010")),
    ("1A00sub4", "not a dummy", put("1A00sub4", "DefaultValue", "0x00050008")),
    ("1600sub2", "not a dummy", put("1600sub2", "DefaultValue", "0x00010001")),
    ("1A00sub3", "0000h:00 is not a dummy", put("1A00sub3", "DefaultValue", "0x00000000")),
    ("1801sub1", "CAN-ID 1A0h is also that of [1800sub1]", put("1801sub1", "DefaultValue", "$NODEID+0x180")),
    ("1400sub1", "CAN-ID 080h is also that of [1005]", put("1400sub1", "DefaultValue", "0x80")),
    ("1802sub1", "restricted", put("1802sub1", "DefaultValue", "$NODEID+0xC0000600")),
    ("1005", "restricted", put("1005", "DefaultValue", "0x20000080")),
    ("1014", "restricted", put("1014", "DefaultValue", "$NODEID+0x800")),
    ("1014", "no DefaultValue", drop("1014", "DefaultValue")),
    ("1200sub1", "600h and 580h", put("1200sub1", "DefaultValue", "$NODEID+0x580")),
]


@pytest.mark.parametrize(
    ("section", "text", "mutate"), MUTATIONS, ids=[f"{section}: {text}" for section, text, _ in MUTATIONS]
)
def test_a_mistake_is_found(section: str, text: str, mutate: Callable[[str], str]) -> None:
    mutated = mutate(TEXTS[MODULE])
    assert mutated != TEXTS[MODULE]
    findings = check.check_text(mutated, MODULE)
    assert [finding for finding in findings if finding.section == section and text in finding.text], findings


def test_too_many_bits_are_found() -> None:
    text = put("1A00sub0", "DefaultValue", "4")(TEXTS[MODULE])
    findings = check.check_text(put("1A00sub4", "DefaultValue", "0x20110510")(text), MODULE)
    assert findings == [check.Finding("1A00", "80 bits are mapped, a PDO has 64")]


def test_a_dummy_may_fill_an_rpdo() -> None:
    text = put("1600sub0", "DefaultValue", "3")(TEXTS[MODULE])
    assert check.check_text(put("1600sub3", "DefaultValue", "0x00070020")(text), MODULE) == []


def test_a_module_must_not_share_the_node_id_of_its_encoder_interface() -> None:
    findings = check.check_text(TEXTS[MODULE], MODULE, node_id=16)
    assert findings == [check.Finding("1800sub1", "CAN-ID 190h is also that of [1400sub1]")]


LINES = TEXTS[INTERFACE].splitlines()


@given(
    place=st.integers(0, len(LINES) - 1),
    line=st.one_of(
        st.text(max_size=20),
        st.sampled_from(
            ["[", "[]", "[1000sub0]", "=", "1=", "SubNumber=-1", "DefaultValue=$NODEID", "DataType=0x8"]
        ),
        st.sampled_from(LINES),
    ),
)
def test_the_check_never_fails_on_a_damaged_file(place: int, line: str) -> None:
    text = "\n".join([*LINES[:place], line, *LINES[place + 1 :]])
    for finding in check.check_text(text, INTERFACE):
        assert finding.text


def test_the_command_prints_one_line_per_finding(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / MODULE
    path.write_text(drop("DummyUsage")(TEXTS[MODULE]), encoding="ascii")
    assert check.main([str(path)]) == 1
    assert f"{path}:DummyUsage: section is missing\n" in capsys.readouterr().out


def test_the_command_checks_all_files_of_ours(capsys: pytest.CaptureFixture[str]) -> None:
    assert check.main([]) == 0
    assert capsys.readouterr().out == ""
