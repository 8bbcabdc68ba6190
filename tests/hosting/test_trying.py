"""The network of canfb try: in simulated time, on a bus that others can open."""

import contextlib
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any
from uuid import uuid4

import can
import pytest

from canfb import BusError, StatusBit
from canfb.bus.bus_master import BusMaster
from canfb.bus.opening import open_bus
from canfb.cia301 import cob
from canfb.cli.config_file import EXAMPLE
from canfb.configuration import Config, parse_config
from canfb.hosting.trying import PRIVATE_GROUPS, START_ALL, NetworkOnBus, private_bus

NODE, NMT = 0x20, 0x000
PATIENCE_S = 60.0


def example(words: dict[str, Any]) -> Config:
    return replace(parse_config(EXAMPLE), bus=words)


def wait_for(bus: can.BusABC, can_id: int, data: bytes | None = None) -> can.Message:
    while (message := bus.recv(PATIENCE_S)) is not None:
        if message.arbitration_id == can_id and data in (None, bytes(message.data)):
            return message
    pytest.fail(f"{can_id:03X} was not heard")


def test_private_buses_side_by_side_are_different_until_none_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    name = uuid4().hex  # tests side by side have private buses, too
    monkeypatch.setattr("platform.node", lambda: name)
    with contextlib.ExitStack() as held:
        one, other = (held.enter_context(private_bus()) for _ in range(2))
        assert one["channel"] != other["channel"]
        assert one["hop_limit"] == other["hop_limit"] == 0, "the frames stay on this computer"
        with pytest.raises(BusError, match=f"{PRIVATE_GROUPS} private buses .* in use"):
            [held.enter_context(private_bus()) for _ in range(PRIVATE_GROUPS)]
    with private_bus() as again:
        assert again == one


def test_a_master_has_started_it_and_others_talk_to_it(multicast_bus: can.BusABC) -> None:
    with private_bus() as words, open_bus(words) as listener:
        with NetworkOnBus(example(words), 100.0) as network:
            wait_for(listener, NMT, bytes(START_ALL.data))
            while not wait_for(listener, cob.TPDO1 + NODE).data[4] & StatusBit.VALID:
                pass  # the first samples confirm the start
            with BusMaster(open_bus(words), PATIENCE_S) as master:
                assert master.sdo(NODE).upload(0x1000, 0) == bytes.fromhex("96010400")
                master.send(NMT, bytes([0x80, NODE]))  # PRE-OPERATIONAL
                while network.module.feedback is not None and network.module.state.name == "OPERATIONAL":
                    wait_for(listener, cob.SYNC)
        counters = network.module.counters
        assert counters.duplicate_frames == 0, "it does not hear itself"


def test_a_bus_that_fails_ends_it_and_what_it_saves_is_gone_at_the_end() -> None:
    ended: list[str] = []
    network = NetworkOnBus(example({"interface": "virtual", "channel": "canfb try fails"}), 100.0)
    network.on_end = lambda: ended.append("end")

    def failing(wait_s: float) -> None:
        raise can.CanOperationError("it is gone")

    with contextlib.ExitStack() as stack:
        stack.enter_context(pytest.raises(BusError, match="the bus fails: it is gone"))
        stack.enter_context(network)
        folder = Path(str(network.config.modules[0].state_dir))
        assert folder.is_dir()
        network._bus.receive = failing  # type: ignore[method-assign]
        network.wait()
    assert ended == ["end"]
    assert not folder.exists()


def test_a_bus_that_cannot_be_opened_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    network = NetworkOnBus(example({"interface": "udp_multicast", "channel": "127.0.0.1"}), 100.0)
    with pytest.raises(BusError, match="cannot open the bus"), network:
        pass
    assert list(tmp_path.iterdir()) == []
