"""`canfb run` with an ADC of libiio's local backend: for `canfb run`, and for python canopen."""

import os
import sys
import time
from collections.abc import Callable
from ctypes.util import find_library
from pathlib import Path

import can
import canopen
import pytest
from emulated_iio_tree import position_cycles
from network import (
    ADC_COB_ID,
    INTERFACE_ID,
    NODE_ID,
    PERIODS,
    POSITION_COB_ID,
    SYNC,
    TIMES,
    Master,
    Timer,
    position_fields,
    skip_unless_required,
    start_command,
    tolerate_late_syncs,
    wait_for_boot_up,
    write_config,
)
from pace import Pace

from canfb import StatusBit, eds_path
from canfb.device.od.dictionary import Dictionary
from processes import Process, Started

CHANNEL = "bus: {interface: socketcan, channel: vcan0}\n"
SOURCE = "{kind: iio, device: ads7950, trigger: sysfstrig0, wait_us: 1000000, buffer_scans: 8}"
UNITS_PER_CYCLE, RANGE_CYCLES = 8192, 209 * 2500
SERIAL = 0x7E570001
SYNCS = 400
UNANSWERED_S = 5.0
TREE = Path(__file__).with_name("emulated_iio_tree.py")


@pytest.fixture(autouse=True)
def libiio() -> None:
    if find_library("iio") is None:
        skip_unless_required("no libiio; run: apt-get install libiio0")


@pytest.fixture
def interface(tmp_path: Path, command: Started, pace: Pace) -> Callable[[int], Process]:
    """Starts `canfb run` with this node-ID, where the emulated ADC is."""
    path = tmp_path / "interface.yaml"

    def start(node_id: int) -> Process:
        path.write_text(
            f"{CHANNEL}interfaces:\n  - {{node_id: {node_id}, serial_number: {SERIAL}, times: true,"
            f" state_dir: {tmp_path / 'state'}, source: {SOURCE}}}\n"
        )
        canfb = [sys.executable, "-m", "canfb", "run", str(path)]
        # In a mount namespace of its own, with the rights that it takes.
        namespace = ["unshare", "--mount"] if os.geteuid() == 0 else ["unshare", "--map-root-user", "--mount"]
        return command(*namespace, sys.executable, str(TREE), str(1e3 * pace.period_s), *canfb)

    return start


def answers(can_bus: can.BusABC) -> tuple[int | None, bytes | None]:
    """Sample time of the ADC PDO, 100 ns, and the position PDO; None for one that does not come.

    The interface waits a second for a scan. A machine that stands still for so long costs that sample.
    """
    time_100ns, position = None, None
    while position is None and (message := can_bus.recv(UNANSWERED_S)) is not None:
        if message.arbitration_id == ADC_COB_ID:
            time_100ns = int.from_bytes(message.data[4:8], "little")
        elif message.arbitration_id == POSITION_COB_ID and time_100ns is not None:
            position = bytes(message.data)
    return time_100ns, position


def test_a_module_follows_the_encoder_at_the_interface(
    interface: Callable[[int], Process], process: Started, tmp_path: Path, can_bus: can.BusABC, pace: Pace
) -> None:
    """Each SYNC fires one scan, and its position is that of the machine at this scan."""
    served = interface(INTERFACE_ID)
    run = process("run", write_config(tmp_path, TIMES))
    wait_for_boot_up(can_bus, pace, NODE_ID, INTERFACE_ID)
    tolerate_late_syncs(can_bus, pace)
    for message in start_command(INTERFACE_ID, NODE_ID):
        can_bus.send(message)
    timer, valid, stalled, last_s = Timer(pace), 0, False, time.monotonic()
    for _ in range(SYNCS):
        timer.wait()
        can_bus.send(SYNC)
        time_100ns, position = answers(can_bus)
        now = time.monotonic()
        stalled |= position is None or now - last_s > 0.5 * PERIODS * pace.period_s
        last_s = now
        if time_100ns is None or position is None:
            continue
        units, status, _ = position_fields(position)
        if status & StatusBit.VALID:
            valid += 1
            scan = round(1e-7 * time_100ns / pace.period_s)
            error = units / UNITS_PER_CYCLE - position_cycles(scan)
            assert abs((error + RANGE_CYCLES / 2) % RANGE_CYCLES - RANGE_CYCLES / 2) < 0.02, scan
    assert stalled or valid > 0.9 * SYNCS
    assert stalled or position_cycles(scan) > 50
    assert run.stop() == 0
    assert served.stop() == 0
    if not stalled:
        run.wait_for(f"node {NODE_ID}: {SYNCS} samples; missed 0, ")
        served.wait_for(f"node {INTERFACE_ID}: {SYNCS} samples sent$")


def first_sample(can_bus: can.BusABC, pace: Pace) -> bytes:
    """The ADC PDO of a SYNC; another one is sent where a machine that stood still has cost the sample."""
    end = time.monotonic() + pace.patience_s
    while time.monotonic() < end:
        can_bus.send(SYNC)
        next_s = time.monotonic() + UNANSWERED_S
        while time.monotonic() < next_s:
            message = can_bus.recv(UNANSWERED_S)
            if message is not None and message.arbitration_id == ADC_COB_ID:
                return bytes(message.data)
    pytest.fail("no SYNC is answered by the ADC PDO", pytrace=False)


def test_python_canopen_reads_its_objects_and_saves(
    interface: Callable[[int], Process], can_bus: can.BusABC, can_channel: str, pace: Pace
) -> None:
    for heartbeat_ms in (0, 2000):  # the second time it has been saved
        served = interface(INTERFACE_ID)
        wait_for_boot_up(can_bus, pace, INTERFACE_ID)
        with Master(can_channel, pace) as master:
            sdo = master.interface.sdo
            assert sdo[0x1000].raw == 0x00040191
            assert sdo[0x1018][4].raw == SERIAL
            assert sdo[0x1017].raw == heartbeat_ms
            sdo[0x1017].raw = 2000
            sdo[0x1010][1].raw = 0x65766173
            master.interface.nmt.state = "OPERATIONAL"
            data = first_sample(can_bus, pace)
            values = [sdo[0x6401][1].raw, sdo[0x6401][2].raw]
            assert values == [int.from_bytes(data[n : n + 2], "little", signed=True) for n in (0, 2)]
            assert sdo[0x2000][1].raw == int.from_bytes(data[4:8], "little")
            assert master.interface.nmt.wait_for_heartbeat(pace.patience_s) == "OPERATIONAL"
        assert served.stop() == 0


def test_an_lss_master_gives_it_a_node_id_that_stays(
    interface: Callable[[int], Process], can_bus: can.BusABC, can_channel: str, pace: Pace
) -> None:
    served = interface(255)
    served.wait_for(rf"encoder interface: node without a node-ID yet \(LSS, serial number {SERIAL}\)")
    with canopen.Network() as network:
        network.connect(interface="socketcan", channel=can_channel)
        lss, node_id = network.lss, 0x15
        lss.RESPONSE_TIMEOUT = pace.patience_s
        dictionary = Dictionary.load(eds_path("encoder-interface"), node_id)
        address = [dictionary.entry(0x1018, n).value for n in (1, 2, 3)]
        assert lss.send_switch_state_selective(*address, SERIAL)
        lss.configure_node_id(node_id)
        lss.store_configuration()
        lss.send_switch_state_global(lss.WAITING_STATE)
    wait_for_boot_up(can_bus, pace, node_id)
    assert served.stop() == 0
    again = interface(255)
    wait_for_boot_up(can_bus, pace, node_id)
    assert again.stop() == 0
