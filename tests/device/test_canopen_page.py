"""docs/canopen.md: its examples run, and its codes are those of the program."""

import re

import pytest

from canfb import Frame, eds_path
from canfb.cia301.codes import AbortCode, EmergencyCode
from canfb.device.node import Node
from canfb.device.od.dictionary import Dictionary
from documentation import page


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
    return page("canopen").partition(f"\n## {title}\n")[2].partition("\n## ")[0]


def test_the_python_example_runs(capsys: pytest.CaptureFixture[str]) -> None:
    (example,) = re.findall(r"```python\n(.*?)```", section("Try it"), re.S)
    exec(example, {})
    assert capsys.readouterr().out == "1 1800000\n"


def test_the_frames_of_the_shell_example() -> None:
    node = Node(Dictionary.load(eds_path("canfb-module"), 32), 32)
    node.start(0.0)
    sent = []
    for can_id, text in re.findall(r"^cansend can0 ([0-9A-F]{3})#(\w+)", section("Try it"), re.M):
        remote = text == "R"
        data = b"" if remote else bytes.fromhex(text)
        sent += [frame.data[:4].hex() for frame in node.receive(Frame(int(can_id, 16), data, remote), 0.0)]
    assert sent == ["00", "7f", "600c1000", "600d1000", "60171000", "60291001", "60801f00"]
