"""Dictionaries of EDS: what is read of the file, however it looks, what is refused, and what is shared."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest
import sample_eds

from canfb.cia301.codes import AbortCode, SdoAbort
from canfb.cia301.datatypes import DataType
from canfb.device.od import eds
from canfb.device.od.dictionary import Dictionary, Entry
from canfb.eds_files import eds_path
from folding import each


@pytest.fixture
def dictionary(tmp_path: Path) -> Dictionary:
    return Dictionary.load(sample_eds.write(tmp_path / "sample.eds"), 32)


def load_text(tmp_path: Path, text: str, node_id: int = 5) -> Dictionary:
    path = tmp_path / "device.eds"
    path.write_text(sample_eds.HEAD + text)
    return Dictionary.load(path, node_id)


def variable(section: str, data_type: int, **options: str) -> str:
    fields = {"ParameterName": section, "DataType": str(data_type), "AccessType": "rw", **options}
    return "\n".join([f"[{section}]", *(f"{key}={text}" for key, text in fields.items())]) + "\n"


def abort_of(call: object, *arguments: object) -> AbortCode:
    assert callable(call)
    with pytest.raises(SdoAbort) as caught:
        call(*arguments)
    return caught.value.code


def test_what_is_there_and_what_is_missing(dictionary: Dictionary) -> None:
    assert {0x1000, 0x1018, 0x2020} <= set(dictionary.indices(range(0x1000, 0x3000)))
    assert dictionary.entry(0x2020).data_type == DataType.DOMAIN
    assert dictionary.dummies == set(range(1, 8))
    assert (5, 0) not in dictionary
    with pytest.raises(KeyError, match="2FFFh:03 is not in"):
        dictionary.entry(0x2FFF, 3)
    assert dictionary.find(0x2FFF) is None
    assert abort_of(dictionary.lookup, 0x2FFF, 0) is AbortCode.NO_OBJECT
    assert abort_of(dictionary.lookup, 0x1000, 1) is AbortCode.NO_SUBINDEX
    assert abort_of(dictionary.lookup, 0x0005, 0) is AbortCode.NO_OBJECT
    assert abort_of(dictionary.lookup, 0x1003, 5) is AbortCode.NO_SUBINDEX


@each("index, data, code", [
    (0x2027, b"\xf5\xff", AbortCode.VALUE_TOO_LOW),
    (0x2027, b"\x0b\x00", AbortCode.VALUE_TOO_HIGH),
    (0x2023, bytes.fromhex("00002140"), None),
    (0x2023, bytes.fromhex("0000F040"), AbortCode.VALUE_TOO_HIGH),
    (0x2023, bytes.fromhex("000030C0"), AbortCode.VALUE_TOO_LOW),
    (0x2023, bytes.fromhex("0000C07F"), AbortCode.INVALID_VALUE),
])  # fmt: skip
def test_refused_values(dictionary: Dictionary, index: int, data: bytes, code: AbortCode | None) -> None:
    entry = dictionary.entry(index)
    before = entry.value
    if code is None:
        entry.download(data)
        assert entry.value != before
    else:
        assert abort_of(entry.download, data) is code
        assert entry.value == before


def test_compact_arrays_are_expanded(tmp_path: Path) -> None:
    dictionary = load_text(
        tmp_path,
        "[2100]\nParameterName=Level\nObjectType=8\nDataType=6\nAccessType=rw\nDefaultValue=7\n"
        "PDOMapping=1\nCompactSubObj=12\n"
        "[2100Name]\nNrOfEntries=1\n2=Second\n[2100Value]\nNrOfEntries=1\n12=0x10\n"
        + variable("2100sub3", 7, DefaultValue="99")  # wins
        + variable("2100sub103", 7),  # is none
    )
    assert [dictionary.entry(0x2100, sub).data_type for sub in (2, 3)] == [6, 7]
    assert dictionary.entry(0x2100, 0).value == 12
    assert dictionary.entry(0x2100, 0).access == "ro"
    assert [dictionary.entry(0x2100, sub).value for sub in (1, 2, 3, 11, 12)] == [7, 7, 99, 7, 16]
    assert dictionary.entry(0x2100, 2).name == "Second"
    assert dictionary.entry(0x2100, 12).pdo_mappable
    assert abort_of(dictionary.lookup, 0x2100, 13) is AbortCode.NO_SUBINDEX
    assert dictionary.indices(range(0x10000)) == [0x2100]
    assert [entry.subindex for entry in dictionary] == [*range(13)]


@each("text, message", [
    (variable("2100", 5, DefaultValue="many"), "DefaultValue"),
    (variable("2100", 5, DefaultValue="256"), r"\[2100\]"),
    (variable("2100", 5, DefaultValue="3", LowLimit="4"), "too low"),
    (variable("2100", 5, AccessType="rx"), r"\[2100\] AccessType 'rx'"),
    (variable("2100", 8, LowLimit="half"), r"\[2100\] LowLimit"),
    (variable("2100", 8, HighLimit="0x1FFFFFFFF"), r"\[2100\] HighLimit"),
    (variable("2100", 8, HighLimit="nan"), r"\[2100\] HighLimit"),
    (variable("2100", 5, DefaultValue="09"), r"\[2100\] DefaultValue"),
    (variable("2100", 5, ObjectType="4"), r"\[2100\] ObjectType"),
    (variable("2100", 0x17), r"\[2100\] DataType: unknown data type 0x0017"),
    ("[2100]\nParameterName=x\nObjectType=8\nCompactSubObj=300\nDataType=5\n", "CompactSubObj"),
    ("[2100]\nParameterName=x\n", r"\[2100\] DataType is missing"),
    ("no section\n", "not an EDS"),
])  # fmt: skip
def test_an_impossible_file_is_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        load_text(tmp_path, text)


@pytest.mark.parametrize("node_id", [0, 128, -1])
def test_node_id_range(tmp_path: Path, node_id: int) -> None:
    with pytest.raises(ValueError, match="1 to 127"):
        load_text(tmp_path, "", node_id)


def test_text_time_bytes_limits_and_a_domain(tmp_path: Path) -> None:
    text = (
        variable("2100", 0x0B, DefaultValue="μm")
        + variable("2101", 0x0C)
        + variable("2102", 0x0A, DefaultValue="01 02 FF")
        + variable("2103", 0x10, LowLimit="0x800000", HighLimit="-1")
        + variable("2105", 0x01, DefaultValue="1")
        + "[2104]\nParameterName=Table\nObjectType=0x2\n"
    )
    dictionary = load_text(tmp_path, text)
    assert dictionary.entry(0x2100).upload() == "μm".encode("utf-16-le")
    dictionary.entry(0x2100).download("Ωx".encode("utf-16-le"))
    assert dictionary.entry(0x2100).value == "Ωx"
    assert dictionary.entry(0x2101).value == bytes(6)
    assert dictionary.entry(0x2101).bit_length == 48
    dictionary.entry(0x2101).download(b"\x01\x02\x03\x04\x05\x06")
    assert dictionary.entry(0x2101).value == b"\x01\x02\x03\x04\x05\x06"
    assert dictionary.entry(0x2102).value == b"\x01\x02\xff"
    assert (dictionary.entry(0x2103).low, dictionary.entry(0x2103).high) == (-(1 << 23), -1)
    assert dictionary.entry(0x2105).value is True
    domain = dictionary.entry(0x2104)
    assert (domain.data_type, domain.access, domain.value) == (15, "rw", b"")


def test_a_text_that_the_type_cannot_hold(dictionary: Dictionary) -> None:
    entry = dictionary.entry(0x2021)
    entry.value = "Ω"
    with pytest.raises(ValueError, match="2021h:00"):
        entry.encode()


def test_a_file_without_dummies(tmp_path: Path) -> None:
    path = tmp_path / "plain.eds"
    path.write_text("[DeviceInfo]\nVendorName=x\n" + variable("2100", 5))
    assert Dictionary.load(path, 1).dummies == frozenset()


SHIPPED = sorted(eds_path("drive").parent.glob("*.eds"))
HOOKS = ("on_read", "on_check", "on_written", "on_download")


def facts(entry: Entry) -> tuple[object, ...]:
    return tuple(getattr(entry, name) for name in Entry.__slots__)


def all_facts(dictionary: Dictionary) -> list[tuple[object, ...]]:
    return [facts(entry) for entry in dictionary]


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: str(path.stem))
def test_what_is_done_to_one_dictionary_reaches_no_other(path: Path) -> None:
    untouched = all_facts(Dictionary.load(path, 7))
    first, other = Dictionary.load(path, 7), Dictionary.load(path, 7)
    for entry in first:
        entry.value, entry.default, entry.low, entry.high = b"value", b"default", 1.0, 2.0
        entry.access, entry.name = "const", "another name"
        for hook in HOOKS:
            setattr(entry, hook, lambda *_: pytest.fail("the hook of another dictionary"))
    first.dummies = frozenset({1})
    assert all_facts(other) == untouched
    assert all_facts(Dictionary.load(path, 7)) == untouched
    assert other.dummies == Dictionary.load(path, 7).dummies != first.dummies
    assert not {id(entry) for entry in first} & {id(entry) for entry in other}
    assert all(getattr(entry, hook) is None for entry in other for hook in HOOKS)


def test_one_content_is_parsed_once_for_every_node_and_every_path(tmp_path: Path) -> None:
    eds.content_described.cache_clear()
    paths = [sample_eds.write(tmp_path / f"{number}.eds") for number in range(3)]
    for path in paths:
        for node_id in (1, 32, 32, 127, 255):
            assert Dictionary.load(path, node_id).entry(0x1014).value == 0x80 + node_id
    assert eds.content_described.cache_info().misses == 1


def test_a_file_that_has_changed_is_read_again(tmp_path: Path) -> None:
    path = sample_eds.write(tmp_path / "device.eds")
    before = Dictionary.load(path, 3)
    path.write_text(path.read_text().replace("a sample device!", "another sample!!"))
    assert Dictionary.load(path, 3).entry(0x1008).value == "another sample!!"
    assert before.entry(0x1008).value == "a sample device!"


def test_a_file_that_is_refused_is_refused_again_with_its_own_name(tmp_path: Path) -> None:
    for name in ("one.eds", "two.eds", "two.eds"):
        path = tmp_path / name
        path.write_text(sample_eds.HEAD + "[2100]\nParameterName=x\nDataType=0x17\nAccessType=rw\n")
        with pytest.raises(ValueError, match=rf"{name}: \[2100\] DataType: unknown data type"):
            Dictionary.load(path, 5)


def octal(text: str) -> str:
    """Every number of the keys that have one, with a leading 0 (CiA 306)."""
    numbers = r"^((?:DataType|ObjectType|PDOMapping|LowLimit|HighLimit)=)(0x[0-9A-Fa-f]+|\d+)$"
    return re.sub(numbers, lambda found: f"{found[1]}0{int(found[2], 0):o}", text, flags=re.M)


def cased(case: Callable[[str], str], pattern: str, text: str) -> bytes:
    return re.sub(pattern, lambda found: case(found[0]), text, flags=re.M).encode()


# How files of the field look, all of which mean the same.
ODD: dict[str, Callable[[str], bytes]] = {
    "byte order mark": lambda text: b"\xef\xbb\xbf" + text.encode(),
    "Unicode of Windows": lambda text: text.encode("utf-16"),
    "Ctrl-Z": lambda text: text.encode() + b"\x1a\x00[nonsense",
    "Windows-1252": lambda text: f"; M\u00fcller GmbH, 20 \u00b5s, \u20ac\n{text}".encode("cp1252"),
    "lines of DOS and Mac": lambda text: text.replace("\n", "\r\n").replace("=0\r\n", "=0\r").encode(),
    "separators of Unicode": lambda text: text.replace("=", "=\u2028").encode(),
    "indented": lambda text: text.replace("\n", "\n\t ").encode(),
    "upper-case keys": lambda text: cased(str.upper, r"^\w+=", text),
    "lower-case keys": lambda text: cased(str.lower, r"^\w+=", text),
    "upper-case sections": lambda text: cased(str.upper, r"^\[.*", text),
    "lower-case sections": lambda text: cased(str.lower, r"^\[.*", text),
    "blanks around =": lambda text: text.replace("=", " = ").encode(),
    "octal": lambda text: octal(text).encode(),
    "the node-ID last": lambda text: re.sub(r"\$NODEID\+(\w+)", r"\1 + $nodeid", text).encode(),
    "blank numbers": lambda text: text.replace(
        "[DeviceInfo]", "[DeviceInfo]\nVendorNumber=\nProductNumber=\n[DeviceComissioning]\nNodeID=\n[Other]"
    ).encode(),
    "types of its own": lambda text: f"{text}[0040]\nObjectType=6\n[0041]\nObjectType=5\n".encode(),
}


@pytest.mark.parametrize("odd", ODD)
@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: str(path.stem))
def test_an_odd_file_means_the_same(path: Path, odd: str, tmp_path: Path) -> None:
    content = ODD[odd](path.read_text(encoding="utf-8"))
    assert content != path.read_bytes()
    (tmp_path / "odd.eds").write_bytes(content)
    read, usual = Dictionary.load(tmp_path / "odd.eds", 7), Dictionary.load(path, 7)
    own_eds = (0x1021, 0)
    for one, other in zip(read, usual, strict=True):
        assert (one.index, one.subindex) == own_eds or facts(one) == facts(other)
    found, wanted = (eds.content_described(data) for data in (content, path.read_bytes()))
    assert [one.parent for one in found.entries] == [one.parent for one in wanted.entries]
    assert (found.objects, found.dummies) == (wanted.objects, wanted.dummies)


def test_numbers_as_tools_write_them() -> None:
    assert {eds.number(text, 0x03, 1) for text in ("-0144", "0xFF9C", "0xFFFFFF9C", "0177634")} == {-100}
    assert [eds.number(text, 0x15, 1) for text in ("0x64", "0xFFFFFFFFFFFFFF9C")] == [100, -100]
    assert eds.number("+100", 0x03, 1) == 100
    assert eds.number("0x42C80000", 0x08, 1) == eds.number("100.0", 0x08, 1) == 100.0
    assert eds.number("0xFFFFFFFFFFFFFF9C", 0x03, 1) == eds.number("0xC059000000000000", 0x11, 1) == -100.0
