"""``canfb run`` with a state_dir: parameters outlive the process, however it ends."""

from __future__ import annotations

import contextlib
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import can
import canopen
import pytest

from canfb.eds_files import eds_path
from processes import Process, python

LIMIT_S = 30.0


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
        second = python("-m", "canfb", "run", str(config))
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
