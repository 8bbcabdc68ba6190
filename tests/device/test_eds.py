"""A file is parsed once in a process, and no dictionary sees what another one does."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest
import sample_eds

from canfb.device.od import eds
from canfb.device.od.dictionary import Dictionary, Entry

SHIPPED = sorted((Path(__file__).parents[2] / "eds").glob("*.eds"))
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
    numbers = re.compile(
        r"^((?:DataType|ObjectType|PDOMapping|LowLimit|HighLimit)=)(0x[0-9A-Fa-f]+|\d+)$", re.M
    )
    return numbers.sub(lambda found: f"{found[1]}0{int(found[2], 0):o}", text)


def cased(case: Callable[[str], str], pattern: str, text: str) -> bytes:
    return re.sub(pattern, lambda found: case(found[0]), text, flags=re.M).encode()


# How files of the field look, all of which mean the same.
ODD: dict[str, Callable[[str], bytes]] = {
    "byte order mark": lambda text: b"\xef\xbb\xbf" + text.encode(),
    "Ctrl-Z": lambda text: text.encode() + b"\x1a\x00[nonsense",
    "Windows-1252": lambda text: f"; M\u00fcller GmbH, 20 \u00b5s, \u20ac\n{text}".encode("cp1252"),
    "lines of DOS": lambda text: text.replace("\n", "\r\n").encode(),
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
    "types of its own": lambda text: (
        f"{text}[0040]\nParameterName=x\nObjectType=6\n[0041]\nObjectType=5\n".encode()
    ),
}


@pytest.mark.parametrize("odd", ODD)
@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: str(path.stem))
def test_an_odd_file_means_the_same(path: Path, odd: str, tmp_path: Path) -> None:
    content = ODD[odd](path.read_text(encoding="utf-8"))
    assert content != path.read_bytes()
    (tmp_path / "odd.eds").write_bytes(content)
    read, usual = Dictionary.load(tmp_path / "odd.eds", 7), Dictionary.load(path, 7)
    own_eds = (0x1021, 0)
    assert [facts(one) for one in read if (one.index, one.subindex) != own_eds] == [
        facts(one) for one in usual if (one.index, one.subindex) != own_eds
    ]
    assert (list(read.objects()), read.dummies) == (list(usual.objects()), usual.dummies)


def test_reals_may_be_written_as_their_bits() -> None:
    assert eds.number("0x42C80000", 0x08, 1) == eds.number("100.0", 0x08, 1) == 100.0
    assert eds.number("0xC059000000000000", 0x11, 1) == -100.0
