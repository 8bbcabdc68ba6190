"""docs/attach.md: what must differ in its configuration, and its frames."""

from __future__ import annotations

import re

import pytest

from canfb.cia301.frame import Frame
from canfb.configuration import parse_config
from canfb.errors import ConfigError
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig
from documentation import blocks, page

PAGE = page("attach").partition("\n## Several")[2]
(CONFIG,) = blocks(PAGE, "yaml")


def modules() -> list[FeedbackModule]:
    return [FeedbackModule(config) for config in parse_config(CONFIG).modules]


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


def test_bus_off_with_and_without_the_setting() -> None:
    module = FeedbackModule(ModuleConfig(node_id=32, autostart=True))
    module.start(0.0)
    (request,) = re.findall(r"cansend can0 620#(2F29\w+)", PAGE)
    assert module.receive(Frame(0x620, bytes.fromhex(request)), 0.0)[0].data[0] == 0x60
    module.bus_off(1.0)
    assert module.state == 5
    (save,) = re.findall(r"cansend can0 620#(2310\w+)", PAGE)
    assert bytes.fromhex(save)[4:] == b"save"
