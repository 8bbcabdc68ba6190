"""Measure how long a position takes: from the SYNC, and from the ADC PDO, to the position PDO.

    python3 -m tools.vcan run -- .venv/bin/python -m tools.bench.latency [--rate HZ] [--cycles N]
    .venv/bin/python -m tools.bench.latency --in-process

On a SocketCAN interface `canfb run` is started as a process of its own, and this program plays SYNC producer
and encoder interface: a SYNC in each period, the ADC PDO right after it. All times are those that the kernel
gives the frames, so what this program needs itself does not count. --in-process takes the time of the two
calls alone. docs/latency.md says how to read the figures.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import os
import select
import signal
import socket
import statistics
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

try:
    import canfb
except ImportError as error:
    sys.exit(f"{error}: run this file with the Python of the virtual environment")

NODE_ID, INTERFACE_ID = 0x20, 0x10
SYNC, ADC_PDO = 0x080, 0x180 + INTERFACE_ID
POSITION_PDO, FINE_PDO = 0x180 + NODE_ID, 0x280 + NODE_ID
SDO_REQUEST, SDO_ANSWER = 0x600 + NODE_ID, 0x580 + NODE_ID
FRAME = struct.Struct("=IB3x8s")
TIMESPEC = struct.Struct("@ll")
SO_TIMESTAMPNS = 35  # Linux; the module socket does not name it
STEP_CYCLES = 0.1
WARM_UP = 20
VARIANTS = ((255, 254, 0), (1, 1, 0), (1, 1, 1), (255, 1, 1))
"""Types of RPDO1 and TPDO1, and 2013:01."""


@dataclass
class Times:
    """What was measured in one variant, in microseconds."""

    name: str
    sync_to_position: list[float] = field(default_factory=list)
    adc_to_position: list[float] = field(default_factory=list)
    missing: int = 0


class Bus:
    """A raw CAN socket whose frames, its own too, come back with the time of the kernel."""

    def __init__(self, channel: str) -> None:
        self._socket = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        self._socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_RECV_OWN_MSGS, 1)
        self._socket.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        self._socket.bind((channel,))
        self._socket.setblocking(False)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def send(self, can_id: int, data: bytes = b"") -> None:
        """A frame, at once."""
        self._socket.send(FRAME.pack(can_id, len(data), data))

    def receive(self, until: float) -> Iterator[tuple[int, bytes, float]]:
        """CAN-ID, data and time (s) of each frame until a moment of time.monotonic()."""
        while (left := until - time.monotonic()) > 0:
            if not select.select([self._socket], [], [], left)[0]:
                return
            packet, extra, _, _ = self._socket.recvmsg(FRAME.size, 64)
            can_id, length, data = FRAME.unpack(packet)
            stamps = [value for _, kind, value in extra if kind == SO_TIMESTAMPNS]
            seconds, nanoseconds = TIMESPEC.unpack(stamps[0][: TIMESPEC.size])
            yield can_id, data[:length], seconds + nanoseconds * 1e-9

    def write_object(self, index: int, subindex: int, value: int, size: int) -> None:
        """An expedited SDO download; ends the program when it is refused."""
        command = 0x23 | (4 - size) << 2
        self.send(SDO_REQUEST, struct.pack("<BHBI", command, index, subindex, value))
        for can_id, data, _ in self.receive(time.monotonic() + 5.0):
            if can_id == SDO_ANSWER:
                if data[0] != 0x60:
                    sys.exit(f"{index:04X}h:{subindex:02X} was refused: {data.hex()}")
                return
        sys.exit("the module does not answer")


def counts(number: int) -> bytes:
    """The ADC PDO of one sample."""
    angle = 2.0 * math.pi * STEP_CYCLES * number
    return struct.pack("<hh", round(1500 * math.sin(angle)), round(1500 * math.cos(angle)))


@contextlib.contextmanager
def module_on(channel: str) -> Iterator[None]:
    """`canfb run` as a process, until the end of the block."""
    with tempfile.TemporaryDirectory() as folder:
        config = Path(folder) / "latency.yaml"
        config.write_text(
            f"bus: {{interface: socketcan, channel: {channel}}}\n"
            f"modules:\n  - {{node_id: {NODE_ID}, encoder_interface: {INTERFACE_ID}}}\n"
        )
        command = [sys.executable, "-m", "canfb", "run", str(config)]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        try:
            assert process.stdout is not None
            if "end with Ctrl-C" not in process.stdout.readline():
                sys.exit("canfb run did not start")
            yield
        finally:
            process.send_signal(signal.SIGTERM)
            process.communicate(timeout=20)


def variant_name(rpdo: int, tpdo: int, predict: int) -> str:
    """How a variant is called in the table."""
    return f"RPDO {rpdo}, TPDO {tpdo}{', predict' if predict else ''}"


def measure(bus: Bus, variant: tuple[int, int, int], rate_hz: float, cycles: int) -> Times:
    """So many SYNC periods of one variant."""
    rpdo, tpdo, predict = variant
    times = Times(variant_name(*variant))
    bus.send(0x000, bytes([0x80, NODE_ID]))
    bus.write_object(0x1400, 2, rpdo, 1)
    bus.write_object(0x1800, 2, tpdo, 1)
    bus.write_object(0x2013, 1, predict, 1)
    bus.send(0x000, bytes([0x01, NODE_ID]))
    next_s = time.monotonic() + 0.05
    sync_s = adc_s = 0.0
    for number in range(cycles + WARM_UP):
        for _ in bus.receive(next_s):  # until the period begins; what is late is not counted twice
            pass
        # Held up: a full period from now on, and no burst of SYNCs that nobody would send.
        next_s = max(next_s, time.monotonic()) + 1.0 / rate_hz
        bus.send(SYNC)
        bus.send(ADC_PDO, counts(number))
        answered = False
        for can_id, _, at in bus.receive(next_s - 0.05 / rate_hz):
            if can_id == SYNC:
                sync_s = at
            elif can_id == ADC_PDO:
                adc_s = at
            elif can_id == POSITION_PDO and not answered and sync_s:
                answered = True
                if number >= WARM_UP:
                    times.sync_to_position.append((at - sync_s) * 1e6)
                    if adc_s > sync_s and rpdo > 240 and tpdo > 240:
                        times.adc_to_position.append((at - adc_s) * 1e6)
        if number >= WARM_UP and not answered:
            times.missing += 1
        sync_s = adc_s = 0.0
    return times


def measure_in_process(variant: tuple[int, int, int], cycles: int) -> Times:
    """The same frames into the module itself: what of the time is computing."""
    rpdo, tpdo, predict = variant
    module = canfb.FeedbackModule(canfb.ModuleConfig(node_id=NODE_ID, autostart=True, predict=predict))
    for index, kind in ((0x1400, rpdo), (0x1800, tpdo)):
        module.dictionary.entry(index, 2).store(kind)
    module.start(0.0)
    times = Times(variant_name(*variant))
    for number in range(cycles + WARM_UP):
        now = number * 1e-3
        started = time.perf_counter()
        at_sync = module.receive(canfb.Frame(SYNC, b""), now)
        synced = time.perf_counter()
        upon_adc = module.receive(canfb.Frame(ADC_PDO, counts(number)), now + 1e-4)
        done = time.perf_counter()
        if number < WARM_UP:
            continue
        if any(frame.can_id == POSITION_PDO for frame in at_sync):
            times.sync_to_position.append((synced - started) * 1e6)
        elif any(frame.can_id == POSITION_PDO for frame in upon_adc):
            times.adc_to_position.append((done - synced) * 1e6)
        else:
            times.missing += 1
    return times


def spread(values: Sequence[float]) -> str:
    """Median, 99th of a hundred, largest; microseconds."""
    if not values:
        return "- | - | -"
    ordered = sorted(values)
    return " | ".join(
        f"{one:.0f}" if one >= 10 else f"{one:.1f}"
        for one in (statistics.median(ordered), ordered[int(len(ordered) * 0.99)], ordered[-1])
    )


def table(rows: Sequence[tuple[str, Times]]) -> str:
    """Markdown."""
    head = "SYNC to position PDO: median | p99 | max | ADC PDO to position PDO: median | p99 | max"
    lines = [f"| where | types | {head} | not in time |", "|---" * 9 + "|"]
    lines += [
        f"| {where} | {times.name} | {spread(times.sync_to_position)} | "
        f"{spread(times.adc_to_position)} | {times.missing} |"
        for where, times in rows
    ]
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print; times in microseconds."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.bench.latency",
        description=__doc__,
        formatter_class=argparse.RawTextHelpFormatter,
    )
    parser.add_argument("--channel", default="vcan0", help="SocketCAN interface (vcan0)")
    parser.add_argument("--rate", type=float, action="append", help="SYNC rate in Hz, may be repeated")
    parser.add_argument("--cycles", type=int, default=3000, help="SYNC periods of each row (3000)")
    parser.add_argument("--in-process", action="store_true", help="without a bus")
    options = parser.parse_args(arguments)
    if options.cycles < 1 or any(not 0.1 <= rate <= 10_000 for rate in options.rate or ()):
        parser.error("--cycles must be at least 1, --rate 0.1 to 10000 Hz")
    rows: list[tuple[str, Times]] = []
    if options.in_process:
        rows = [("in process", measure_in_process(variant, options.cycles)) for variant in VARIANTS]
    else:
        if not os.path.exists(f"/sys/class/net/{options.channel}"):
            sys.exit(f"no interface {options.channel}: see docs/vcan.md, or use --in-process")
        with module_on(options.channel):
            bus = Bus(options.channel)
            try:
                for rate in options.rate or (100.0, 1000.0):
                    for variant in VARIANTS:
                        where = f"{options.channel}, {rate:g} Hz"
                        rows.append((where, measure(bus, variant, rate, options.cycles)))
            finally:
                bus.close()
    print(table(rows))
    print("Times in microseconds.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
