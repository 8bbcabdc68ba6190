"""docs/canopen.md: its examples run, and its table has the objects of both devices."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from canfb.cia301.codes import AbortCode, EmergencyCode
from canfb.cia301.frame import Frame
from canfb.device.node import Node
from canfb.device.od.dictionary import Dictionary

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "canopen.md").read_text(encoding="utf-8")
OBJECTS = dict(re.findall(r"^\| (1[0-9A-F]{3})h \| (.*) \|$", PAGE, re.M))


@pytest.mark.parametrize(("name", "column"), [("canfb-module", 1), ("encoder-interface", 2)])
def test_every_communication_object_is_there(name: str, column: int) -> None:
    dictionary = Dictionary.load(ROOT / "eds" / f"{name}.eds", 32)
    has = {info.index for info in dictionary.objects() if info.index < 0x2000}
    named = {int(index, 16) for index, cells in OBJECTS.items() if cells.split(" | ")[column] != "-"}
    assert named == has


@pytest.mark.parametrize(("name", "column"), [("canfb-module", 1), ("encoder-interface", 2)])
def test_the_defaults_of_plain_numbers(name: str, column: int) -> None:
    dictionary = Dictionary.load(ROOT / "eds" / f"{name}.eds", 32)
    checked = 0
    for index, cells in OBJECTS.items():
        if int(index, 16) & 0xFF00 in (0x1600, 0x1A00):
            continue
        told = re.match(r"([0-9A-F]{3,8}h|\d+)( \+ id)?(:|,|$)", cells.split(" | ")[column])
        kind = int(index, 16) & 0xFF00
        subindex = 1 if kind in (0x1200, 0x1400, 0x1800) or index in ("1018", "1020", "1029") else 0
        entry = dictionary.find(int(index, 16), subindex)
        if told and entry is not None and isinstance(entry.default, int):
            text = told.group(1)
            value = int(text[:-1], 16) if text.endswith("h") else int(text)
            assert entry.default == value + (32 if told.group(2) else 0), index
            checked += 1
    assert checked >= 12


def test_the_codes_are_those_of_the_program() -> None:
    emergencies, aborts = (section(title) for title in ("EMCY", "SDO"))
    codes = {int(code, 16) for code in re.findall(r"^\| ([0-9A-F]{4})h \|", emergencies, re.M)}
    assert codes <= {int(code) for code in EmergencyCode}
    assert {0x8130, 0x8210, 0x8220, 0x8240, 0x8250} <= codes
    rows = "".join(re.findall(r"^\| (0[^|]*) \|", aborts, re.M))
    named = {int(code, 16) for code in re.findall(r"([0-9A-F]{8})h", rows)}
    assert named <= {int(code) for code in AbortCode}
    assert len(named) > 20


def section(title: str) -> str:
    return PAGE.partition(f"\n## {title}\n")[2].partition("\n## ")[0]


def test_the_python_example_runs(capsys: pytest.CaptureFixture[str]) -> None:
    (example,) = re.findall(r"```python\n(.*?)```", section("Try it"), re.S)
    exec(example, {})
    assert capsys.readouterr().out == "1 1800000\n"


def test_the_frames_of_the_shell_example() -> None:
    node = Node(Dictionary.load(ROOT / "eds" / "canfb-module.eds", 32), 32)
    node.start(0.0)
    sent = []
    for can_id, text in re.findall(r"^cansend can0 ([0-9A-F]{3})#(\w+)", section("Try it"), re.M):
        remote = text == "R"
        data = b"" if remote else bytes.fromhex(text)
        sent += [frame.data[:4].hex() for frame in node.receive(Frame(int(can_id, 16), data, remote), 0.0)]
    assert sent == ["00", "7f", "600c1000", "600d1000", "60171000", "60291001", "60801f00"]
