"""docs/encoder-profile.md: the module has what the EDS says; its codes and its examples."""

from __future__ import annotations

import re
import struct
import tomllib
from pathlib import Path
from typing import Any, NamedTuple

import canopen
import pytest
from module_bench import Bench

from canfb.cia301.codes import EmergencyCode
from canfb.cia301.datatypes import FORMATS, DataType
from canfb.device.od.dictionary import Dictionary
from canfb.device.storage.storage import MemoryStore
from canfb.eds_files import eds_path
from canfb.module.cia406.alarms import CODES
from canfb.module.cia406.profile import ALARM_PARAMETERS, ALARM_POSITION
from folding import each

PROJECT = Path(__file__).parents[2]
PAGE = (PROJECT / "docs" / "encoder-profile.md").read_text(encoding="utf-8")
DICTIONARY = Dictionary.load(eds_path("canfb-module"), 32)
OWN = (0x2003, 0x2004)


def section(title: str) -> str:
    found = PAGE.partition(f"\n## {title}\n")[2].partition("\n## ")[0]
    assert found, title
    return found


class Row(NamedTuple):
    """One object of the profile as the EDS has it; default: None for a value that is measured."""

    place: tuple[int, int]
    data_type: DataType
    access: str
    mappable: bool
    default: int | None

    @property
    def size(self) -> int:
        return struct.calcsize(FORMATS[self.data_type])


ROWS = [
    Row(
        (entry.index, entry.subindex),
        DataType(entry.data_type),
        entry.access,
        entry.pdo_mappable,
        entry.default,
    )
    for entry in DICTIONARY
    if entry.index >= 0x6000 or entry.index in OWN
    if entry.subindex or (entry.index, 1) not in DICTIONARY
]


@pytest.fixture(scope="module")
def module() -> Bench:
    return Bench(serial_number=4711)


@each("row", ROWS)
def test_an_object_is_that_of_the_eds(module: Bench, row: Row) -> None:
    sdo, entry = module.remote.sdo, module.module.dictionary.entry(*row.place)
    assert (entry.data_type, entry.access, entry.pdo_mappable) == row[1:4]
    data = sdo.upload(*row.place)
    assert len(data) == row.size
    value = int.from_bytes(data, "little", signed=row.data_type in (DataType.INTEGER16, DataType.INTEGER32))
    if row.place[0] in (0x650B, 0x6508):
        assert value == {0x650B: 4711, 0x6508: 0xFFFFFFFF}[row.place[0]]
    elif row.default is not None:
        assert value == row.default
    there = entry.subindex if row.place[0] not in (*OWN, 0x650A) else 4
    with pytest.raises(canopen.SdoAbortedError, match="06090011"):
        sdo.upload(row.place[0], there + 1)


@each("row", ROWS)
def test_it_can_be_written_if_it_is_rw(module: Bench, row: Row) -> None:
    place, sdo = row.place, module.remote.sdo
    if row.access == "ro":
        with pytest.raises(canopen.SdoAbortedError, match="06010002"):
            sdo.download(*place, bytes(row.size))
        return
    with pytest.raises(canopen.SdoAbortedError, match="06070012"):
        sdo.download(*place, bytes(row.size + 1))
    if row.place[0] in (0x6003, 0x6009):
        with pytest.raises(canopen.SdoAbortedError, match="08000022"):  # there is no position yet
            sdo.download(*place, bytes(row.size))
        return
    before = sdo.upload(*place)
    sdo.download(*place, b"\1".ljust(row.size, b"\0"))
    assert sdo.upload(*place) == b"\1".ljust(row.size, b"\0")
    sdo.download(*place, before)


@each("row", ROWS)
def test_it_can_be_mapped_if_the_eds_says_so(module: Bench, row: Row) -> None:
    sdo = module.sdo
    sdo[0x1802][1].raw = 0x800003A0
    sdo[0x1A02][0].raw = 0
    mapped = row.place[0] << 16 | row.place[1] << 8 | row.size * 8
    if not row.mappable:
        with pytest.raises(canopen.SdoAbortedError, match="06040041"):
            sdo[0x1A02][1].raw = mapped
        return
    sdo[0x1A02][1].raw = mapped
    sdo[0x1A02][0].raw = 1
    assert sdo[0x1A02][1].raw == mapped


def test_the_software_version_is_that_of_the_package(module: Bench) -> None:
    version = tomllib.loads((PROJECT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    major, minor, *_ = map(int, version.split("."))
    assert module.sdo[0x6507].raw >> 16 == major << 8 | minor
    assert module.sdo[0x6507].raw & 0xFFFF == 0x0302


@pytest.mark.parametrize(("cycles", "resolution", "revolutions"), [
    (1, 8192, 65535), (8, 65536, 65535), (16, 131072, 32767), (2500, 20480000, 209), (524288, 2**31, 1),
    (1048576, 2**31, 1), (1048575, 1048575 * 4096, 1),
])  # fmt: skip
def test_resolution_and_revolutions(cycles: int, resolution: int, revolutions: int) -> None:
    bench = Bench(cycles_per_revolution=cycles)
    assert bench.sdo[0x6501].raw == resolution
    assert bench.sdo[0x6502].raw == revolutions
    assert bench.sdo[0x6002].raw == resolution * revolutions  # where it wraps without scaling, too


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
    assert f"{index:04X}h" in section("Objects")
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
