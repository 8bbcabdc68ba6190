"""Several SDO clients of one node: they take turns on one computer, and ignore what answers others."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import can
import pytest
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError
from hypothesis import given
from hypothesis import strategies as st

from canfb.bus.bus_master import BusMaster
from canfb.bus.sdo_channel import SharedClient, sdo_turn
from canfb.cia301.frame import Frame
from canfb.errors import BusError
from canfb.master.access import NodeAccess
from commissioning_kit import Bench
from folding import each

NODE = 0x20
READS = 40


def is_free(bus: str, node: int) -> bool:
    try:
        with sdo_turn(bus, node, 0.0):
            return True
    except BusError:
        return False


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where the locks are."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    return tmp_path


def test_one_at_a_time_for_each_bus_and_node(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with sdo_turn("can0", NODE):
        assert [is_free("can0", NODE), is_free("can0", NODE + 1), is_free("can1", NODE)] == [
            False,
            True,
            True,
        ]
        for locked in folder.iterdir():  # a link is not followed, and nobody waits where there is no file
            locked.unlink()
            locked.symlink_to(folder / "elsewhere")
        assert is_free("can0", NODE)
        assert not (folder / "elsewhere").exists()
        monkeypatch.setattr("tempfile.tempdir", str(folder / "missing"))
        assert is_free("can0", NODE)
    assert is_free("can0", NODE)


def test_a_program_that_ends_in_its_turn_leaves_it_to_others(folder: Path) -> None:
    code = "import os\nfrom canfb.bus.sdo_channel import sdo_turn\nwith sdo_turn('can0', 32): os._exit(7)\n"
    ended = subprocess.run(
        [sys.executable, "-c", code], check=False, env=os.environ | {"TMPDIR": str(folder)}
    )
    assert ended.returncode == 7
    assert is_free("can0", NODE)


class Node:
    """Answers an upload of index:sub with index and sub-index; 3003h has four segments."""

    def __init__(self, channel: str) -> None:
        self._bus = can.Bus(interface="virtual", channel=channel)
        self._left = 0
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def _serve(self) -> None:
        while not self._done.is_set():
            asked = self._bus.recv(0.02)
            if asked is not None and asked.arbitration_id == 0x600 + NODE:
                data = self._answer(bytes(asked.data))
                if data:
                    self._bus.send(can.Message(arbitration_id=0x580 + NODE, data=data, is_extended_id=False))

    def _answer(self, asked: bytes) -> bytes:
        if asked[0] == 0x40:
            self._left = 4 if asked[2] == 0x30 else 0
            if self._left:
                return b"\x41" + asked[1:4] + (28).to_bytes(4, "little")
            return b"\x43" + asked[1:4] + asked[1:4] + b"\x00"
        if asked[0] in (0x60, 0x70):
            if not self._left:
                return b"\x80" + bytes(3) + (0x05040001).to_bytes(4, "little")
            self._left -= 1
            return bytes((asked[0] & 0x10 | (self._left == 0),)) + bytes([self._left] * 7)
        return b""

    def end(self) -> None:
        self._done.set()
        self._thread.join()
        self._bus.shutdown()


@pytest.fixture
def channel(tmp_path: Path) -> Iterator[str]:
    """A virtual bus with a node."""
    node = Node(str(tmp_path))
    yield str(tmp_path)
    node.end()


@each("turns", [True, False])
def test_clients_side_by_side_read_what_they_asked_for(channel: str, turns: bool) -> None:
    """With turns also transfers of segments; without, answers to others are ignored."""
    failures: list[object] = []

    def read(index: int) -> None:
        with BusMaster(can.Bus(interface="virtual", channel=channel), 5.0) as master:
            if not turns:
                master.sdo(NODE).turn = contextlib.nullcontext
            node = NodeAccess(master, NODE, "node")
            for subindex in range(READS):
                data = node.read_bytes(index, subindex)
                whole = b"".join(bytes([left] * 7) for left in (3, 2, 1, 0))
                expected = whole if index >> 8 == 0x30 else index.to_bytes(2, "little") + bytes((subindex, 0))
                if data != expected:
                    failures.append((index, subindex, data))

    indices = (0x2001, 0x2002, 0x3003) if turns else (0x2001, 0x2002, 0x2003)
    threads = [threading.Thread(target=read, args=(index,)) for index in indices]
    for one in threads:
        one.start()
    for one in threads:
        one.join()
    assert failures == []


class Silent:
    """A network that delivers what it is told when something is sent."""

    def __init__(self, *answers: bytes) -> None:
        self.answers, self.sent = answers, list[bytes]()

    def subscribe(self, can_id: int, callback: object) -> None:
        self.callback = callback

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        self.sent.append(bytes(data))
        answers, self.answers = self.answers, ()
        for one in answers:
            self.callback(0x5A0, one, 0.0)  # type: ignore[operator]


def client(*answers: bytes) -> tuple[SharedClient, Silent]:
    network = Silent(*answers)
    return SharedClient(network, NODE, 0.01), network  # type: ignore[arg-type]


OWN = bytes.fromhex("4B012002 34120000")


@given(st.lists(st.binary(max_size=8).filter(lambda data: data[1:4] != OWN[1:4]), max_size=5))
def test_whatever_answers_others_is_ignored(foreign: list[bytes]) -> None:
    aborts = [data for data in foreign if data[:1] == b"\x80" and (data + bytes(8))[1:4] == bytes(3)]
    channel, _ = client(*(data for data in foreign if data not in aborts), OWN)
    assert channel.upload(0x2001, 2) == b"\x34\x12"
    assert channel.disturbed == any(data not in aborts for data in foreign)


def test_an_abort_is_that_of_the_object_or_of_none() -> None:
    abort = bytes.fromhex("80 012002 00000206")
    with pytest.raises(SdoAbortedError):
        client(abort)[0].upload(0x2001, 2)
    with pytest.raises(SdoAbortedError):
        client(abort[:1] + bytes(3) + abort[4:])[0].upload(0x2001, 2)
    channel, network = client(abort[:1] + bytes.fromhex("012003") + abort[4:])
    with pytest.raises(SdoCommunicationError, match="another master uses this node"):
        channel.upload(0x2001, 2)
    assert network.sent[-1] == bytes.fromhex("80 012002 00000405"), "it aborts its own transfer"


def test_a_transfer_that_another_master_has_ended_is_begun_again() -> None:
    """The server refuses the second segment, as an upload of somebody else has begun."""
    bench = Bench(sync=False)
    receive, broken = bench.module.receive, list[bytes]()

    def disturbed(frame: Frame, now: float) -> list[Frame]:
        if frame.can_id == 0x620 and frame.data[0] == 0x70 and len(broken) < 3:
            broken.append(frame.data)
            receive(Frame(0x620, b"\x80" + bytes(7)), now)
            abort = b"\x80" + bytes(3) + (0x05040001).to_bytes(4, "little")
            return [Frame(0x5A0, b"\x4f\x05\x10\x01\x07" + bytes(3)), Frame(0x5A0, abort)]
        return receive(frame, now)

    bench.module.receive = disturbed  # type: ignore[method-assign]
    assert bench.access.read_bytes(0x1008, 0) == b"canfb drive feedback module"
    assert len(broken) == 3
