"""The master on a bus, alone or shared: what it hears and sends, failures, and turns of SDO clients."""

import contextlib
import queue
import re
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from datetime import datetime
from pathlib import Path
from typing import Any

import can
import pytest
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError
from hypothesis import given, strategies as st

from canfb import BusError, FeedbackModule, Frame, ModuleConfig
from canfb.bus.bus_master import BusMaster
from canfb.bus.clocks import date_and_time
from canfb.bus.frame_bus import PythonCanBus
from canfb.bus.runner import Runner
from canfb.bus.sdo_channel import SharedClient, sdo_turn
from canfb.bus.shared_bus import SharedBus, beside, only_reads
from canfb.master.access import NodeAccess
from commissioning_kit import Bench
from fake_bus import message
from folding import each


def open_virtual(**options: Any) -> can.BusABC:
    return can.Bus(interface="virtual", channel="canfb-master", **options)


@pytest.fixture
def peer() -> Iterator[can.BusABC]:
    with open_virtual() as bus:
        yield bus


def test_it_hears_what_it_has_subscribed_to_and_nothing_else(peer: can.BusABC) -> None:
    heard: queue.Queue[tuple[int, bytes]] = queue.Queue()

    def hear(can_id: int, data: bytes, timestamp: float) -> None:
        assert timestamp > 0.0
        heard.put((can_id, bytes(data)))

    with BusMaster(open_virtual()) as master:
        master.subscribe(0x190, hear)
        for one in (
            message(0x191, b"no"),
            message(0x190, b"no", is_extended_id=True),
            message(0x190, is_remote_frame=True),
            message(0x190, b"yes"),
        ):
            peer.send(one)
        assert heard.get(timeout=5.0) == (0x190, b"yes")
        master.unsubscribe(0x190, hear)
        master.subscribe(0x191, hear)
        peer.send(message(0x190, b"no"))
        peer.send(message(0x191, b"yes"))
        assert heard.get(timeout=5.0) == (0x191, b"yes")
    assert heard.empty()


def test_what_it_sends(peer: can.BusABC) -> None:
    with BusMaster(open_virtual()) as master:
        master.send(0x720, b"", remote=True)
        master.send(0x000, b"\x01\x20")
    for want in ((0x720, b"", True, False), (0x000, b"\x01\x20", False, False)):
        got = peer.recv(5.0)
        assert got is not None
        assert (got.arbitration_id, bytes(got.data), got.is_remote_frame, got.is_extended_id) == want


def test_the_sync_is_produced_until_the_end_and_heard_by_itself(peer: can.BusABC) -> None:
    heard: queue.Queue[int] = queue.Queue()
    with BusMaster(open_virtual(receive_own_messages=True)) as master:
        master.subscribe(0x80, lambda can_id, data, timestamp: heard.put(can_id))
        master.produce_sync(200.0)
        for _ in range(5):
            assert heard.get(timeout=5.0) == 0x80
    while peer.recv(0.0) is not None:
        pass
    assert peer.recv(0.05) is None, "no more of it"


class FailingBus(can.BusABC):
    """Receives and sends only errors."""

    def __init__(self) -> None:
        super().__init__(channel="failing")

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        raise OSError(100, "Network is down")

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        raise can.CanOperationError("no buffer space")


def test_a_bus_that_fails_is_one_line_and_no_traceback(capfd: pytest.CaptureFixture[str]) -> None:
    with BusMaster(FailingBus()) as master:
        for _ in range(2):
            with pytest.raises(BusError, match=re.escape("the bus fails: Network is down")):
                master.wait(5.0)
        with pytest.raises(
            BusError, match=r"the bus fails: Network is down|could not be sent: no buffer space"
        ):
            master.send(0x80, b"")
    assert capfd.readouterr().err == ""


def test_a_bus_that_failed_once_is_used_again() -> None:
    """SocketCAN says once that its interface goes down."""
    with BusMaster(open_virtual()) as master:
        master._network.notifier.exception = OSError(100, "Network is down")  # type: ignore[union-attr]
        with pytest.raises(BusError, match="the bus fails: Network is down"):
            master.wait(5.0)
        master.wait(0.1)


def test_time_passes(peer: can.BusABC) -> None:
    with BusMaster(open_virtual()) as master:
        began = master.now()
        master.wait(0.02)
        assert master.now() - began >= 0.02
        master.wait(0.0)
    before = datetime.now().astimezone().replace(microsecond=0)
    assert before <= datetime.fromisoformat(date_and_time()) <= datetime.now().astimezone()


AT_ONCE_S, PATIENCE_S = 0.0, 30.0
NODE = 0x20
UPLOAD = b"\x40" + bytes(7)


@pytest.fixture
def shared() -> Iterator[SharedBus]:
    with SharedBus(open_virtual()) as bus:
        yield bus


def test_all_hear_and_all_send(shared: SharedBus, peer: can.BusABC) -> None:
    branch = shared.branch()
    peer.send(message(0x1A0))
    for bus in (shared, branch):
        heard = bus.recv(PATIENCE_S)
        assert heard is not None
        assert heard.arbitration_id == 0x1A0
        bus.send(message(0x601, UPLOAD))
        sent = peer.recv(PATIENCE_S)
        assert sent is not None
        assert sent.arbitration_id == 0x601
    branch.shutdown()
    peer.send(message(0x1A1))
    assert shared.recv(PATIENCE_S) is not None  # it still runs
    assert branch.recv(AT_ONCE_S) is None


def test_what_is_no_upload_is_not_sent(shared: SharedBus, peer: can.BusABC) -> None:
    for bus in (shared, shared.branch()):
        with pytest.raises(can.CanOperationError, match="SDO uploads alone"):
            bus.send(message(0x601, b"\x23" + UPLOAD[1:]))
    assert peer.recv(AT_ONCE_S) is None


FRAMES = st.builds(
    can.Message,
    arbitration_id=st.one_of(st.integers(0, 0x7FF), st.integers(0x600, 0x680)),
    data=st.binary(max_size=8),
    is_extended_id=st.booleans(),
    is_remote_frame=st.booleans(),
)


@given(FRAMES)
def test_only_uploads_may_be_sent(sent: can.Message) -> None:
    upload = (
        0x601 <= sent.arbitration_id <= 0x67F
        and len(sent.data) == 8
        and sent.data[0] >> 5 in (2, 3, 4, 5)
        and not sent.is_extended_id
        and not sent.is_remote_frame
    )
    assert only_reads(sent) is upload


def test_a_bus_that_fails_fails_for_all() -> None:
    with SharedBus(FailingBus()) as shared, BusMaster(shared.branch()) as master:
        with pytest.raises(OSError, match="Network is down"):
            shared.recv(AT_ONCE_S)
        with pytest.raises(BusError, match="Network is down"):
            master.wait(PATIENCE_S)


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
    assert is_free("\udcff", NODE)  # a byte of the command line that is no UTF-8
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


@pytest.fixture
def node() -> Iterator[None]:
    with PythonCanBus(open_virtual()) as bus:
        runner = Runner(bus, [FeedbackModule(ModuleConfig(node_id=NODE))])
        with beside(runner.run, runner.stop, runner.stop):
            yield


@pytest.mark.usefixtures("node")
def test_a_master_reads_while_another_thread_receives(shared: SharedBus) -> None:
    """An SDO upload over a branch; the frames arrive in the other thread."""
    done = threading.Event()

    def receive() -> None:
        while not done.is_set():
            shared.recv(0.05)

    with BusMaster(shared.branch(), PATIENCE_S) as master, beside(receive, done.set, done.set):
        assert master.sdo(NODE) is master.sdo(NODE)
        assert master.sdo(NODE).upload(0x1000, 0) == bytes.fromhex("96010400")


@pytest.mark.usefixtures("node")
@each("turns", [True, False])
def test_clients_side_by_side_read_what_they_asked_for(turns: bool) -> None:
    """With turns also transfers of segments; without, answers to others are ignored."""
    expected = {(0x1000, 0): bytes.fromhex("96010400"), (0x1018, 0): b"\x04", (0x1017, 0): bytes(2)}
    if turns:
        expected[0x1008, 0] = b"canfb drive feedback module"

    def read(client: int) -> set[tuple[tuple[int, int], bytes]]:
        with BusMaster(open_virtual(), 5.0) as master:
            if not turns:
                master.sdo(NODE).turn = contextlib.nullcontext
            node = NodeAccess(master, NODE, "node")
            return {(place, node.read_bytes(*place)) for _ in range(25) for place in expected}

    with ThreadPoolExecutor(3) as clients:
        assert list(clients.map(read, range(3))) == [set(expected.items())] * 3


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
