"""``canfb run`` with a state_dir: parameters outlive the process, however it ends."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import can
import canopen
import pytest

from canfb.cia301.frame import Frame
from canfb.eds_files import eds_path
from canfb.hosting.hosting import make_module
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig
from processes import Process

LIMIT_S = 30.0
SAVE = bytes.fromhex("2310100173617665")
SAVED = Frame(0x5A0, bytes.fromhex("6010100100000000"))
CHANGE = bytes.fromhex("2B171000F4010000")  # 1017h = 500
READ = bytes.fromhex("4017100000000000")


def exchanged(config: ModuleConfig, *requests: bytes) -> list[str]:
    """The answers of a module that is made, switched on, asked and taken away again."""
    with contextlib.ExitStack() as resources:
        module = make_module(config, resources, {})
        module.start(0.0)
        return [answer for data in requests for answer in answers(module, data)]


def answers(module: FeedbackModule, data: bytes) -> list[str]:
    """Those to one request; that of a save comes when the thread of the store is done."""
    frames, end_s = module.receive(Frame(0x620, data), 0.0), time.monotonic() + LIMIT_S
    while not frames and time.monotonic() < end_s:
        frames = [frame for frame in module.tick(module.deadline() or 0.0) if frame.can_id == SAVED.can_id]
    return [frame.data.hex() for frame in frames]


def test_a_module_of_the_command_keeps_its_parameters(tmp_path: Path) -> None:
    config = ModuleConfig(node_id=32, state_dir=str(tmp_path / "state"))
    assert exchanged(config, CHANGE, SAVE)[-1] == SAVED.data.hex()
    assert exchanged(config, READ) == ["4b171000f4010000"]


def test_without_a_state_dir_it_says_that_nothing_is_kept() -> None:
    assert exchanged(ModuleConfig(node_id=32), SAVE) == ["8010100120000008"]


# In processes of their own.


class Run(Process):
    """``canfb run`` in a process of its own, on a multicast bus, and a master."""

    def __init__(self, config: Path, network: canopen.Network) -> None:
        super().__init__((sys.executable, "-W", "error", "-m", "canfb", "run", str(config)))
        self.wait_for(r"^running node 32 \(20h\) on")
        self.master = network.add_node(canopen.RemoteNode(32, str(eds_path("canfb-module"))))
        self.master.sdo.RESPONSE_TIMEOUT = LIMIT_S
        deadline = time.monotonic() + LIMIT_S
        while network.scanner.nodes.count(32) == 0 and time.monotonic() < deadline:
            network.check()
            self.master.nmt.send_command(0x82)  # a boot-up tells that it listens
            with contextlib.suppress(canopen.nmt.NmtError):
                self.master.nmt.wait_for_bootup(0.2)

    def kill(self) -> None:
        self.send(signal.SIGKILL)
        self.stop()


@pytest.fixture
def words(multicast_words: dict[str, Any], multicast_bus: can.BusABC) -> dict[str, Any]:
    """A multicast bus of this machine alone, which works."""
    return multicast_words


@pytest.fixture
def network(words: dict[str, object]) -> Iterator[canopen.Network]:
    network = canopen.Network()
    network.connect(**words)
    yield network
    network.disconnect()


def test_what_was_saved_is_there_after_a_kill(
    tmp_path: Path, words: dict[str, object], network: canopen.Network
) -> None:
    config = tmp_path / "feedback.yaml"
    bus = ", ".join(f"{key}: {value}" for key, value in words.items())
    config.write_text(f"bus: {{{bus}}}\nmodules: [{{node_id: 32, state_dir: {tmp_path}/state}}]\n")
    first = Run(config, network)
    try:
        assert first.master.sdo[0x1010][1].raw == 1
        first.master.sdo[0x2010][3].raw = 9
        first.master.sdo.download(0x1010, 1, b"save")
        first.master.sdo[0x2010][3].raw = 10
        second = subprocess.run(
            [sys.executable, "-m", "canfb", "run", str(config)],
            capture_output=True,
            text=True,
            timeout=LIMIT_S,
            check=False,
        )
        assert second.returncode == 1
        assert second.stderr.startswith(f"canfb: state_dir {tmp_path}/state cannot be used: another process")
    finally:
        first.kill()
    again = Run(config, network)
    try:
        assert again.master.sdo[0x2010][3].raw == 9
        again.wait_for(r"^node 32 \(20h\): saved values take precedence over the configuration: 2010h:03$")
    finally:
        again.kill()
