"""docs/encoder-profile.md: the module has what the EDS says; its codes and its examples."""

from __future__ import annotations

import re
from typing import Any

import canopen
import pytest
from module_bench import Bench

from canfb.cia301.codes import EmergencyCode
from canfb.device.od.dictionary import Dictionary
from canfb.device.storage.storage import MemoryStore
from canfb.eds_files import eds_path
from canfb.module.cia406.alarms import CODES
from canfb.module.cia406.profile import ALARM_PARAMETERS, ALARM_POSITION
from documentation import blocks, page

PAGE = page("encoder-profile")
DICTIONARY = Dictionary.load(eds_path("canfb-module"), 32)


def section(title: str) -> str:
    found = PAGE.partition(f"\n## {title}\n")[2].partition("\n## ")[0]
    assert found, title
    return found


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
    for example in blocks(PAGE, "python"):
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
