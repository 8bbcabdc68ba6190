"""docs/storage.md: its commands and its examples run, one after the other."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import canopen
import pytest

from canfb.bus.sdo_channel import SharedClient
from canfb.cia301.frame import Frame
from canfb.cli import config_file
from canfb.cli.main import main
from canfb.configuration import load_config
from canfb.demo.demo_network import EmbeddedNetwork
from canfb.device.storage.storage import MemoryStore
from canfb.hosting.hosting import saved_configuration
from canfb.module.device_configuration import configuration_of
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig
from canfb.simulation.embedded_bus import EmbeddedBus

PAGE = (Path(__file__).parents[2] / "docs" / "storage.md").read_text(encoding="utf-8")
PAGE = PAGE.partition("\n## A file for the PLC")[2]
COMMANDS = [
    shlex.split(line, comments=True)
    for block in re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL)
    for line in block.splitlines()
]
EXAMPLES = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
YAML = "bus: {bitrate: 500000}\nmodules: [{node_id: 0x20, adc_bits: 16, conditioning: {sine_gain: 1.07}}]\n"


class Network(EmbeddedNetwork):
    """In place of the bus of the examples: a module that can save is on it."""

    def __init__(self) -> None:
        bus = EmbeddedBus()
        super().__init__(bus)
        self.module = FeedbackModule(ModuleConfig(node_id=0x20), MemoryStore())
        bus.attach(self.module)

    def connect(self, *args: Any, **words: Any) -> Any:
        assert words == {"interface": "socketcan", "channel": "can0"}
        return self

    def sdo(self, node_id: int) -> Any:
        return SharedClient(self, node_id, 1.0)

    def wait(self, duration_s: float) -> None:
        """Nothing happens meanwhile, and the bus has not failed."""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "feedback.yaml").write_text(YAML)
    return tmp_path


def test_commands_and_examples_make_the_module_of_the_configuration(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert [words[:3] for words in COMMANDS] == [["canfb", "config", "dcf"]] * 3
    for words in COMMANDS[:2]:
        assert main(words[1:]) == 0
    network = Network()
    monkeypatch.setattr(canopen, "Network", lambda: network)
    names: dict[str, Any] = {}
    exec(compile(EXAMPLES[0], "docs/storage.md", "exec"), names)
    wanted = saved_configuration(load_config("feedback.yaml").modules[0])
    assert configuration_of(network.module).values() == wanted.values()

    # The third command reads the module; the second example writes what it has read.
    monkeypatch.setattr(config_file, "master_of", lambda options: network)
    assert main(COMMANDS[2][1:]) == 0
    fresh = Network()
    names["node"] = fresh.add_node(0x20, canopen.import_od("module-20h.dcf"))
    exec(compile(EXAMPLES[1], "docs/storage.md", "exec"), names)
    assert configuration_of(fresh.module).values() == wanted.values()


def test_the_heartbeat_of_the_page_is_in_the_concise_form() -> None:
    def heartbeats(module: FeedbackModule) -> list[int]:
        return [
            int.from_bytes(one.data, "little")
            for one in configuration_of(module).writes()
            if (one.index, one.subindex) == (0x1017, 0)
        ]

    module = Network().module
    assert heartbeats(module) == [0]
    (request,) = re.findall(r"`cansend can0 620#(\w+)`", PAGE)
    module.receive(Frame(0x620, bytes.fromhex(request)), 0.0)
    assert heartbeats(module) == [500]
