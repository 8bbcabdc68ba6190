"""docs/storage.md: the examples run, on a module and a master as the page has them."""

from __future__ import annotations

import re
from pathlib import Path

import canopen
import canopen.lss
import pytest

from canfb.cia301.frame import Frame
from canfb.demo.story import EmbeddedNetwork
from canfb.device.storage.storage import MemoryStore
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig
from canfb.simulation.embedded_bus import EmbeddedBus

PAGE = Path(__file__).parents[2] / "docs" / "storage.md"
STORAGE, _, LSS = PAGE.read_text(encoding="utf-8").partition("\n## Tables")[0].partition("\n## LSS")


def examples(page: str, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", page, re.S)


def test_the_frames_of_saving_and_loading() -> None:
    module = FeedbackModule(ModuleConfig(node_id=32), MemoryStore())
    module.start(0.0)
    (commands,) = examples(STORAGE, "sh")
    seen = []
    for can_id, data in re.findall(r"^cansend can0 ([0-9A-F]{3})#(\w+)", commands, re.M):
        answers = module.receive(Frame(int(can_id, 16), bytes.fromhex(data)), 0.0)
        seen.append((answers[0].data[:4].hex(), module.dictionary.entry(0x1017).value))
    assert seen == [("60171000", 500), ("60101001", 500), ("00", 500), ("60111001", 500), ("00", 0)]


def test_the_program_with_a_store_of_its_own() -> None:
    (program,) = examples(STORAGE, "python")
    exec(program, {})


def test_the_master_that_sets_a_node_id(monkeypatch: pytest.MonkeyPatch) -> None:
    bus = EmbeddedBus()
    network = EmbeddedNetwork(bus)
    network.lss.RESPONSE_TIMEOUT = 0
    monkeypatch.setattr(canopen.lss.time, "sleep", lambda seconds: None)
    monkeypatch.setattr(network, "connect", lambda **words: network)
    monkeypatch.setattr(network, "disconnect", lambda: None)
    monkeypatch.setattr(canopen, "Network", lambda: network)
    store = MemoryStore()
    config = ModuleConfig(node_id=32, serial_number=4711)
    module = FeedbackModule(config, store)
    bus.attach(module)
    (program,) = examples(LSS, "python")
    exec(program, {})
    assert module.node.node_id == 0x21
    assert FeedbackModule(config, store).start(0.0) == [Frame(0x721, b"\x00")]


def test_the_files_that_the_page_names_are_those_of_the_program() -> None:
    from canfb.device.storage.image import ParameterGroup
    from canfb.hosting import state_files

    named = set(re.findall(r"`(\w+\.bin)`", STORAGE))
    made = {f"{group.name.lower()}.bin" for group in ParameterGroup}
    assert named == made | {state_files.PENDING}
