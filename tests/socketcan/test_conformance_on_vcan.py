"""A selection of the conformance cases over a real SocketCAN, with masters of others.

All cases run without a bus in tests/conformance; here it is python canopen, and can-utils alone.
"""

import subprocess
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Any

import can
import canopen
import pytest
from network import NODE_ID, Master, OpenBus, next_frame, reset, wait_for_boot_up, write_config
from pace import Pace

from canfb.eds_files import eds_path
from processes import Started


@pytest.fixture(scope="module")
def running(lasting_process: Started, tmp_path_factory: pytest.TempPathFactory, pace: Pace) -> None:
    """The module on the bus, as a user starts it."""
    with can.Bus(interface="socketcan", channel="vcan0") as bus:
        lasting_process("run", write_config(tmp_path_factory.mktemp("conformance")))
        wait_for_boot_up(bus, pace, NODE_ID)


@pytest.fixture
def fresh(running: None, open_bus: OpenBus, pace: Pace) -> None:
    """With its defaults."""
    reset(open_bus(), pace)


@pytest.fixture
def master(fresh: None, can_channel: str, pace: Pace) -> Iterator[Master]:
    with Master(can_channel, pace) as made:
        yield made


def check_sdo(node: canopen.RemoteNode) -> None:
    assert node.sdo[0x1000].raw == 0x00040196  # SDO 01
    with pytest.raises(canopen.SdoAbortedError, match="0x06010002"):  # SDO 03
        node.sdo.download(0x1000, 0, bytes(4))
    for index, subindex, code in ((0x1000, 1, "0x06090011"), (0x1004, 0, "0x06020000")):  # SDO 05, 06
        with pytest.raises(canopen.SdoAbortedError, match=code):
            node.sdo.upload(index, subindex)
    assert node.sdo[0x1008].raw == "canfb drive feedback module"  # SDO 18: segmented
    node.sdo.download(0x1017, 0, bytes.fromhex("F4 01"), force_segment=True)  # SDO 15
    assert node.sdo[0x1017].raw == 500
    with node.sdo.open(0x1021, 0, "rb", block_transfer=True) as stream:  # SDO 23: by block, with CRC
        assert stream.read() == eds_path("canfb-module").read_bytes()


def check_states(node: canopen.RemoteNode, bus: can.BusABC, pace: Pace) -> None:
    """Trans 02, by heartbeats."""
    for state, number in (
        ("OPERATIONAL", 5),
        ("PRE-OPERATIONAL", 127),
        ("STOPPED", 4),
        ("PRE-OPERATIONAL", 127),
    ):
        while bus.recv(0.0) is not None:  # heartbeats of the state before
            pass
        node.nmt.state = state
        while next_frame(bus, pace, 0x700 + NODE_ID) != bytes([number]):
            pass
    reset(bus, pace)
    node.sdo[0x1017].raw = 500


def check_pdo_and_sync(network: canopen.Network, node: canopen.RemoteNode, pace: Pace) -> None:
    """PDO 22 and PDO 06: map an object into TPDO3, and get it with each SYNC."""
    pdo = node.tpdo[3]
    pdo.read()
    pdo.clear()
    pdo.add_variable(0x1001)
    pdo.add_variable(0x2011, 8)
    pdo.cob_id, pdo.trans_type, pdo.enabled = 0x3A0, 1, True
    pdo.save()
    node.nmt.state = "OPERATIONAL"
    network.sync.start(pace.slower(0.05))
    try:
        for _ in range(3):
            assert pdo.wait_for_reception(pace.patience_s) is not None
        assert len(pdo.data) == 5
    finally:
        network.sync.stop()


def wait_for_emergency(node: canopen.RemoteNode, code: int, pace: Pace) -> Any:
    """The EMCY, whether it has come already or not."""
    deadline = time.monotonic() + pace.patience_s
    while time.monotonic() < deadline:
        for emergency in node.emcy.log:
            if emergency.code == code:
                return emergency
        node.emcy.wait(timeout=0.2)
    pytest.fail(f"no EMCY {code:04X}h, only {node.emcy.log}", pytrace=False)


def check_emergency(network: canopen.Network, node: canopen.RemoteNode, pace: Pace) -> None:
    """EMCY 04 to 06."""
    network.send_message(0x190, b"")
    emergency = wait_for_emergency(node, 0x8210, pace)
    assert node.sdo[0x1001].raw == emergency.register
    assert node.sdo[0x1003][1].raw & 0xFFFF == 0x8210
    network.send_message(0x190, bytes(4))
    wait_for_emergency(node, 0x0000, pace)


def test_python_canopen_as_the_master(master: Master, can_bus: can.BusABC, pace: Pace) -> None:
    node, network = master.module, master.network
    check_sdo(node)
    check_states(node, can_bus, pace)
    check_pdo_and_sync(network, node, pace)
    check_emergency(network, node, pace)
    network.send_message(0x100, bytes(6))  # a TIME, which nobody has asked for
    assert node.sdo[0x1000].raw == 0x00040196


def test_python_canopen_guards_the_node(master: Master, open_bus: OpenBus, pace: Pace) -> None:
    """Guard 02, 03 and 06: the toggle bit, and what becomes of a node whose master has gone."""
    node = master.module
    life_time_ms = round(1000 * min(60.0, pace.slower(2.0)))
    node.sdo[0x100C].raw = life_time_ms
    node.sdo[0x100D].raw = 1
    bus = open_bus()
    node.nmt.state = "OPERATIONAL"
    node.nmt.start_node_guarding(life_time_ms / 1e4)
    seen = [next_frame(bus, pace, 0x700 + NODE_ID) for _ in range(8)]
    answers = [data[0] for data in seen if data]  # the remote frame itself is heard, too, without data
    assert len(answers) >= 4
    assert {answer & 0x7F for answer in answers} <= {5}
    assert all(one ^ other == 0x80 for one, other in pairwise(answers))
    node.nmt.stop_node_guarding()
    wait_for_emergency(node, 0x8130, pace)
    bus.send(can.Message(arbitration_id=0x700 + NODE_ID, is_remote_frame=True, is_extended_id=False, dlc=1))
    while not (data := next_frame(bus, pace, 0x700 + NODE_ID)) or data[0] & 0x7F != 0x7F:
        pass  # what came before


# What cansend sends, and the line of candump that must follow.
RAW = [
    ("620#4000100000000000", "5A0#4300100096010400"),  # SDO 01
    ("620#4000100100000000", "5A0#8000100111000906"),  # SDO 05
    ("620#4004100000000000", "5A0#8004100000000206"),  # SDO 06
    ("620#E000100000000000", "5A0#80......01000405"),  # SDO 07
    ("620#2F031000FF000000", "5A0#800310003[01]000906"),  # SDO 10
    ("620#2117100002000000", "5A0#6017100000000000"),  # SDO 15 ...
    ("620#0BC8000000000000", "5A0#2000000000000000"),  # ... and HB 02: every 200 ms
    ("000#8020", "720#7F"),
    ("000#0120", "720#05"),  # Trans
    ("000#0220", "720#04"),
    ("000#8020", "720#7F"),
    ("620#2B17100000000000", "5A0#6017100000000000"),
    ("620#4008100000000000", "5A0#410810001B000000"),  # SDO 17
    ("620#7000000000000000", "5A0#8008100000000305"),
    ("620#A000100014000000", "5A0#C[26]00100004000000"),  # SDO 19
    ("620#A300000000000000", "5A0#8196010400000000"),
    ("620#A201140000000000", "5A0#CD00000000000000"),
    ("620#A100000000000000", ""),
    ("620#A000100080000000", "5A0#8000100002000405"),  # SDO 26
    ("720#R", "720#7F"),  # Guard 03
    ("720#R", "720#FF"),
    ("000#0120", ""),
    ("190#", "0A0#108211"),  # EMCY 04
    ("620#2300140105020000", "5A0#8000140130000906"),  # Beyond 14
    ("2A0#R", "2A0#"),  # PDO 03
    ("080#", "2A0#"),  # PDO 06
    ("000#8120", "720#00"),
]


@pytest.mark.usefixtures("can_utils", "fresh")
def test_cansend_and_candump(can_channel: str, command: Callable[..., Any]) -> None:
    candump = command("candump", "-L", can_channel)
    request, heard = "620#4000100000000000", None
    while heard is None:  # candump does not say when it has begun to listen
        assert not candump.has_ended(), str(candump)
        subprocess.run(["cansend", can_channel, request], check=True)
        heard = candump.find("620#40", 0.1)
    candump.wait_for("5A0#43")
    for request, answer in RAW:
        subprocess.run(["cansend", can_channel, request], check=True)
        candump.wait_for(f"{can_channel} {request}")
        if answer:
            candump.wait_for(rf"{can_channel} {answer}")
