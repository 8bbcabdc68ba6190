"""docs/encoder-profile.md: its table is the EDS, its codes are those of the program, its examples run."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import canopen
import pytest
from module_bench import Bench

from canfb.cia301.codes import EmergencyCode
from canfb.cia301.datatypes import DataType
from canfb.device.od.dictionary import Dictionary
from canfb.device.storage.storage import MemoryStore
from canfb.eds_files import eds_path
from canfb.module.cia406.alarms import CODES
from canfb.module.cia406.profile import ALARM_PARAMETERS, ALARM_POSITION
from folding import each

PAGE = (Path(__file__).parents[2] / "docs" / "encoder-profile.md").read_text(encoding="utf-8")
TYPES = {"U8": DataType.UNSIGNED8, "U16": DataType.UNSIGNED16, "U32": DataType.UNSIGNED32,
         "U64": DataType.UNSIGNED64, "I16": DataType.INTEGER16, "I32": DataType.INTEGER32}  # fmt: skip
DICTIONARY = Dictionary.load(eds_path("canfb-module"), 32)
OWN = (0x2003, 0x2004)


def section(title: str) -> str:
    found = PAGE.partition(f"\n## {title}\n")[2].partition("\n## ")[0]
    assert found, title
    return found


def rows() -> list[tuple[list[tuple[int, int]], list[str]]]:
    """The places of each row of the table of objects, and its cells."""
    found = []
    for line in section("All objects").splitlines():
        match = re.match(r"\| ([0-9A-F]{4})h(?::(\d\d))?(?: to ([0-9A-F]{4})h:\d\d)? \| (.*) \|$", line)
        if match:
            first, subindex, last, rest = match.groups()
            indices = range(int(first, 16), int(last or first, 16) + 1)
            found.append(([(index, int(subindex or "0")) for index in indices], rest.split(" | ")))
    return found


def number(text: str) -> int:
    return int(text[:-1], 16) if text.endswith("h") else int(text)


def test_the_table_has_every_object_once() -> None:
    there = {
        (entry.index, entry.subindex)
        for entry in DICTIONARY
        if entry.index >= 0x6000 or entry.index in OWN
        if entry.subindex or (entry.index, 1) not in DICTIONARY
    }
    told = [place for places, _ in rows() for place in places]
    assert sorted(told) == sorted(there)


@each("places, cells", rows())
def test_a_row_is_that_of_the_eds(places: list[tuple[int, int]], cells: list[str]) -> None:
    _, data_type, access, _, default = cells
    for place in places:
        entry = DICTIONARY.entry(*place)
        assert entry.data_type == TYPES[data_type]
        assert (entry.access, entry.pdo_mappable) == (access.split(",")[0], access.endswith(", PDO"))
        assert (default == "-") is (entry.pdo_mappable and entry.default is None)
        if default != "-":  # as a module with the defaults has it
            assert Bench().module.dictionary.entry(*place).current() == number(default)


def test_the_alarms_and_warnings_are_those_that_are_supported() -> None:
    told: dict[str, dict[int, int]] = {"6503": {}, "6505": {}}
    for index, bit, code in re.findall(
        r"^\| (650[35])h \| (\d+) \| [^|]* \| ([0-9A-F]{4})h", section("Alarms and warnings"), re.M
    ):
        told[index][1 << int(bit)] = int(code, 16)
    assert told["6505"] == {bit: int(code) for bit, code in CODES.items()}
    assert told["6503"] == {ALARM_POSITION: EmergencyCode.SENSOR, ALARM_PARAMETERS: EmergencyCode.DATA_SET}
    assert sum(told["6503"]) == DICTIONARY.entry(0x6504).default
    assert sum(told["6505"]) == DICTIONARY.entry(0x6506).default


@pytest.mark.parametrize("index", [0x6005, 0x6010, 0x6020, 0x6050, 0x650C])
def test_what_is_not_there(bench: Bench, index: int) -> None:
    assert f"{index:04X}h" in section("All objects")
    with pytest.raises(canopen.SdoAbortedError, match="06020000"):
        bench.remote.sdo.upload(index, 0)


def test_the_examples_run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    bench = Bench(MemoryStore())
    bench.start()
    for _ in range(3):
        bench.at(0.25)
    monkeypatch.setattr(bench.network, "connect", lambda **words: None, raising=False)
    monkeypatch.setattr(canopen, "Network", lambda: bench.network)
    names: dict[str, Any] = {}
    printed = []
    for example in re.findall(r"```python\n(.*?)```", PAGE, re.S):
        exec(example, names)
        printed.append(capsys.readouterr().out)
    offset = 1_800_000 - 3  # a quarter of a cycle is 3.6 units
    assert printed == ["", f"1800000 {offset}\n", "0\n", "0\n", "[]\n"]
    bench.network.send_message(0, b"\x81\x20")
    bench.network.send_message(0, b"\x01\x20")
    bench.at(0.25)
    sdo = names["module"].sdo
    assert (sdo[0x6509].raw, sdo[0x6004].raw, sdo[0x2004][1].raw) == (offset, 1_800_000, 0x3023)


def test_a_preset_in_pre_operational(bench: Bench) -> None:
    for _ in range(3):
        bench.at(0.25)
    bench.remote.nmt.state = "PRE-OPERATIONAL"
    bench.sdo[0x6003].raw = 77
    assert bench.sdo[0x6004].raw == 77
    bench.start()
    assert bench.at(0.25)[0] == 77
