"""docs/several-modules.md: its configuration is good, and its lines are those of the program."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from canfb.bus.module_lines import name_of, summary_of
from canfb.cia301.codes import EmergencyCode
from canfb.cia301.frame import Frame
from canfb.cli.main import main
from canfb.configuration import parse_config
from canfb.errors import ConfigError
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig

PAGE = (Path(__file__).parents[2] / "docs" / "several-modules.md").read_text(encoding="utf-8")
(CONFIG,) = re.findall(r"```yaml\n(.*?)```", PAGE, re.S)
LINES = [line for block in re.findall(r"```text\n(.*?)```", PAGE, re.S) for line in block.splitlines()]


def modules() -> list[FeedbackModule]:
    return [FeedbackModule(config) for config in parse_config(CONFIG).modules]


def test_the_configuration_is_good(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "axes.yaml"
    path.write_text(CONFIG)
    assert main(["config", "check", str(path)]) == 0
    assert "good" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("node_id: 0x21", "node_id: 0x20"),
        ("axis-y", "axis-x"),
        ("node_id: 0x21", "node_id: 255\n    serial_number: 4711"),
    ],
)
def test_what_must_differ(old: str, new: str) -> None:
    assert old in CONFIG
    with pytest.raises(ConfigError, match=r"modules\[[12]\]"):
        parse_config(CONFIG.replace(old, new))


def test_what_may_be_the_same() -> None:
    assert parse_config(CONFIG.replace("encoder_interface: 0x11", "encoder_interface: 0x10"))


def test_the_lines_are_those_of_the_program() -> None:
    names = ", ".join(name_of(module) for module in modules())
    assert LINES[0] == f"running node {names} on socketcan can0; end with Ctrl-C"
    assert [line.replace("81230", "0") for line in LINES[1:4]] == [summary_of(module) for module in modules()]


def test_the_alarm() -> None:
    module = modules()[0]
    module.start(0.0)
    assert module.receive(Frame(0x1A0, bytes(8)), 0.0) == [
        Frame(0x0A0, bytes.fromhex("508111A001000000")),
    ]
    assert EmergencyCode.CAN_ID_COLLISION == 0x8150
    assert "(1A0h)" in LINES[4]


def test_bus_off_with_and_without_the_setting() -> None:
    module = FeedbackModule(ModuleConfig(node_id=32, autostart=True))
    module.start(0.0)
    (request,) = re.findall(r"cansend can0 620#(2F29\w+)", PAGE)
    assert module.receive(Frame(0x620, bytes.fromhex(request)), 0.0)[0].data[0] == 0x60
    module.bus_off(1.0)
    assert module.state == 5
    (save,) = re.findall(r"cansend can0 620#(2310\w+)", PAGE)
    assert bytes.fromhex(save)[4:] == b"save"
