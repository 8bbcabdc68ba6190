"""What the tests on a real bus share: a configuration, a SYNC, waiting for frames, a master."""

import json
import math
import os
import struct
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Self

import can
import canopen
import pytest
import yaml
from pace import Pace

from canfb.eds_files import eds_path

NODE_ID, INTERFACE_ID = 0x20, 0x10
POSITION_COB_ID, ADC_COB_ID = 0x180 + NODE_ID, 0x180 + INTERFACE_ID
SYNC = can.Message(arbitration_id=0x80, is_extended_id=False)
LOOK_S = 0.2
CLOSEST = 0.75  # periods between two SYNCs
PERIODS = 200  # 2010:06: a SYNC may be so late
TIMES = "    times: true\n"
OpenBus = Callable[..., can.BusABC]


def skip_unless_required(reason: str) -> None:
    """Skip the test; where CANFB_REQUIRE_VCAN=1 says that nothing may be missing, fail it."""
    if os.environ.get("CANFB_REQUIRE_VCAN") == "1":
        pytest.fail(reason, pytrace=False)
    pytest.skip(reason)


def slow_motion(pace: Pace, motion: str, encoder: str = "{}") -> str:
    """The simulation of a machine that goes on by ``pace.period_s`` with each SYNC. Its module needs TIMES.

    ``motion`` holds its keys for 1 kHz: it is the same here, in cycles from SYNC to SYNC.
    """
    milliseconds = 1e3 * pace.period_s
    keys = {
        key: value / milliseconds if key.endswith(("rpm", "hz")) else value * milliseconds
        for key, value in yaml.safe_load(motion).items()
    }
    return (
        f"simulation:\n  pace: sync\n  sync_period_us: {1e6 * pace.period_s}\n"
        f"  encoder: {encoder}\n  motion: {json.dumps(keys)}\n"
    )


def write_config(folder: Path, text: str = "", simulation: str = "") -> str:
    """A configuration for vcan0 in ``folder``; ``text`` are more keys of the module."""
    path = folder / "feedback.yaml"
    path.write_text(
        "bus: {interface: socketcan, channel: vcan0}\n"
        f"modules:\n  - node_id: {NODE_ID}\n    encoder_interface: {INTERFACE_ID}\n{text}{simulation}"
    )
    return str(path)


def frame(can_id: int, data: bytes = b"") -> can.Message:
    return can.Message(arbitration_id=can_id, data=data, is_extended_id=False)


def start_command(*nodes: int) -> list[can.Message]:
    """NMT start of each node."""
    return [frame(0, bytes([1, node])) for node in nodes]


def frames(bus: can.BusABC, pace: Pace, what: str) -> Iterator[can.Message]:
    """What comes; the test fails when nothing comes any more, and says what it has waited for."""
    while (message := bus.recv(pace.patience_s)) is not None:
        yield message
    pytest.fail(f"waited for {what}, and nothing comes any more", pytrace=False)


def wait_for(bus: can.BusABC, pace: Pace, *can_ids: int) -> dict[int, bytes]:
    """Data of the next frame with each of these CAN-IDs."""
    found: dict[int, bytes] = {}
    for message in frames(bus, pace, " and ".join(f"{can_id:03X}h" for can_id in can_ids)):
        if message.arbitration_id in can_ids:
            found.setdefault(message.arbitration_id, bytes(message.data))
        if len(found) == len(can_ids):
            break
    return found


def next_frame(bus: can.BusABC, pace: Pace, can_id: int) -> bytes:
    """Data of the next frame with this CAN-ID."""
    return wait_for(bus, pace, can_id)[can_id]


def tolerate_late_syncs(bus: can.BusABC, pace: Pace, *nodes: int) -> None:
    """2010:06 of each module, until its next reset: no position is given up because a SYNC is late."""
    for node in nodes or (NODE_ID,):
        bus.send(frame(0x600 + node, struct.pack("<BHBI", 0x2F, 0x2010, 6, PERIODS)))
        assert next_frame(bus, pace, 0x580 + node)[0] == 0x60


def wait_for_boot_up(bus: can.BusABC, pace: Pace, *nodes: int) -> None:
    """Until each of the nodes has sent its boot-up: from then on it answers."""
    missing = set(nodes)
    for message in frames(bus, pace, f"the boot-up of {sorted(missing)}"):
        if message.data == b"\0":
            missing.discard(message.arbitration_id - 0x700)
        if not missing:
            break


def reset(bus: can.BusABC, pace: Pace) -> None:
    """NMT reset node, until it is back with its defaults; frames from before are dropped."""
    while bus.recv(0.0) is not None:
        pass
    bus.send(frame(0, bytes([0x81, NODE_ID])))
    wait_for_boot_up(bus, pace, NODE_ID)


def position_fields(data: bytes) -> tuple[int, int, int]:
    """6004h, status word and residual of a position PDO."""
    position, status, residual = struct.unpack("<IHH", data)
    return position, status, residual


class Timer:
    """The timer of a SYNC producer: it rings each ``period_s``, unless nobody waits for it.

    After a ring that was heard late the next is left out: too soon after the last SYNC, a module would take
    it for a duplicate.
    """

    def __init__(self, pace: Pace) -> None:
        self.period_s = pace.period_s
        self._next_s: float | None = None

    def wait(self) -> None:
        """Until it rings; times that are over are left out."""
        now = time.monotonic()
        if self._next_s is None:
            self._next_s = now
        late = max(0, math.ceil((now - self._next_s) / self.period_s))
        ring_s = self._next_s + late * self.period_s
        self._next_s = ring_s + self.period_s
        time.sleep(max(0.0, ring_s - now))
        if self._next_s - time.monotonic() < CLOSEST * self.period_s:
            self._next_s += self.period_s


class Syncs(threading.Thread):
    """SYNC after SYNC while it is entered, at the period of ``pace``; each when the one before is answered.

    ``rate_hz`` is the rate that this machine holds.
    """

    def __init__(self, channel: str, pace: Pace) -> None:
        super().__init__(daemon=True)
        self._bus = can.Bus(
            interface="socketcan",
            channel=channel,
            can_filters=[{"can_id": POSITION_COB_ID, "can_mask": 0x7FF}],
        )
        self._patience_s = pace.patience_s
        self._timer = Timer(pace)
        self._over = threading.Event()
        self.count = 0
        self.rate_hz = 0.0

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._over.set()
        self.join()
        self._bus.shutdown()

    def run(self) -> None:
        """Send them."""
        began = time.monotonic()
        while not self._over.is_set():
            self._timer.wait()
            self._bus.send(SYNC)
            if not self._answered(time.monotonic() + self._patience_s):
                return  # who needs a SYNC says that there is none
            self.count += 1
            self.rate_hz = self.count / (time.monotonic() - began)

    def wait(self, count: int) -> None:
        """Until so many more have been answered."""
        end = self.count + count
        while self.count < end:
            if not self.is_alive():
                pytest.fail(f"a SYNC was not answered by {POSITION_COB_ID:03X}h", pytrace=False)
            self._over.wait(LOOK_S)

    def _answered(self, deadline: float) -> bool:
        while not self._over.is_set() and time.monotonic() < deadline:
            if self._bus.recv(LOOK_S) is not None:
                return True
        return False


class Master:
    """python canopen's master with a RemoteNode for each of the two nodes."""

    def __init__(self, channel: str, pace: Pace) -> None:
        self.network = canopen.Network()
        self.network.connect(interface="socketcan", channel=channel)
        self.module = self.network.add_node(NODE_ID, str(eds_path("canfb-module")))
        self.interface = self.network.add_node(INTERFACE_ID, str(eds_path("encoder-interface")))
        for node in (self.module, self.interface):
            node.sdo.RESPONSE_TIMEOUT = pace.patience_s

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.network.disconnect()
