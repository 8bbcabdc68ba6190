"""Module and encoder interface as two processes on python-can's udp_multicast, started by a master."""

from __future__ import annotations

import contextlib
import re
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import can
import pytest

from canfb.objects import StatusBit

SYNC, ADC, POSITION = 0x080, 0x190, 0x1A0
BOOT_UPS = {0x710, 0x720}
LATE_SYNCS = bytes.fromhex("2F 10 20 06 C8 00 00 00")  # 2010:06 = 200 periods
LIMIT_S = 30.0  # for everything that has to happen; it takes about a second
CONFIG = """\
bus: {{interface: udp_multicast, channel: 239.74.163.2, port: {port}, hop_limit: 0}}
modules:
- {{node_id: 32, encoder_interface: 16, times: true}}
simulation:
  pace: sync  # this computer may be busy with other tests
  motion: {{standstill_s: 0, ramp_s: 1.5, rpm: 60}}  # 0.04 cycle per interval^2, less than 2010:0B
"""


@pytest.fixture
def port(multicast_words: dict[str, Any]) -> int:
    return int(multicast_words["port"])


@pytest.fixture
def bus(multicast_bus: can.BusABC) -> can.BusABC:
    return multicast_bus


@pytest.fixture
def start(port: int, tmp_path: Path) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Starts a command with the configuration, its output into pipes; none is left running."""
    config = tmp_path / "network.yaml"
    config.write_text(CONFIG.format(port=port))
    with contextlib.ExitStack() as stack:

        def start_one(command: str, *options: str) -> subprocess.Popen[str]:
            process = subprocess.Popen(
                [sys.executable, "-W", "error", "-m", "canfb", command, str(config), *options],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )
            stack.enter_context(process)
            stack.callback(process.kill)
            return process

        yield start_one


def frames(bus: can.BusABC, *processes: subprocess.Popen[str]) -> Iterator[can.Message]:
    """What is on the bus, until the time is up or one of the processes has ended too soon."""
    deadline = time.monotonic() + LIMIT_S
    while time.monotonic() < deadline:
        message = bus.recv(0.2)
        if message is not None:
            yield message
        for process in processes:
            if process.poll() is not None:
                pytest.fail(f"{process.args!r} has ended: {process.communicate()}")
    pytest.fail(f"not what was waited for within {LIMIT_S:g} s")


def ended(process: subprocess.Popen[str]) -> tuple[int, str, str]:
    """Exit status, standard output and standard error of a process that has been told to end."""
    output, errors = process.communicate(timeout=LIMIT_S)
    return process.returncode, output, errors


def test_a_master_starts_both_sees_positions_and_a_signal_ends_both(
    bus: can.BusABC, start: Callable[..., subprocess.Popen[str]]
) -> None:
    """The other signals are in test_signals_and_realtime.py."""
    module = start("run")
    interface = start("simulate", "--rate", "200")
    waiting = set(BOOT_UPS)
    seen = frames(bus, module, interface)
    while waiting:
        waiting.discard(next(seen).arbitration_id)
    bus.send(can.Message(arbitration_id=0x620, data=LATE_SYNCS, is_extended_id=False))
    bus.send(can.Message(arbitration_id=0x000, data=[1, 0], is_extended_id=False))
    trace = []
    positions: list[tuple[int, int]] = []
    while len(positions) < 100:
        message = next(seen)
        trace.append(message.arbitration_id)
        if message.arbitration_id == POSITION:
            position, status, _ = struct.unpack("<IHH", message.data)
            positions.append((position, status))
    for process, ending in (
        (
            module,
            r"node 32: [0-9]+ samples; missed 0, residual [0-9]+, amplitude 0, coasted [0-9]+, lost [0-9]+",
        ),
        (interface, r"[0-9]+ samples sent"),
    ):
        process.send_signal(signal.SIGTERM)  # the module first: it would miss the SYNC
        status, output, errors = ended(process)
        assert (status, errors) == (0, "")
        first, *_, last = output.splitlines()
        assert re.fullmatch(r".* on udp_multicast 239\.74\.163\.2; end with Ctrl-C", first)
        assert re.fullmatch(ending, last)
    # One sample for each SYNC and one position for each sample, no more: nobody hears his own frames.
    samples = [can_id for can_id in trace if can_id in (SYNC, ADC)]
    samples = samples[samples.index(ADC) - 1 :]  # before, the interface was not started yet
    assert samples[::2] == [SYNC] * len(samples[::2])
    assert samples[1::2] == [ADC] * len(samples[1::2])
    assert trace.count(ADC) >= len(positions)
    places = [position for position, status in positions if status & StatusBit.VALID]
    assert len(places) > len(positions) // 2  # a busy machine may stall the bus
    assert places[-1] - places[0] > 2500 * 8192 // 20, "the machine has begun to turn"
    assert places == sorted(places)
