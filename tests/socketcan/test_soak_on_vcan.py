"""A network of processes on a real interface: they stand still, and its link goes down, under load.

tools/soak has 10^7 cycles in simulated time; here is what only a real system has: sockets, `ip link`,
SIGSTOP, file descriptors. The machine goes on with each SYNC that reaches its interface, so its place is
known from the time of the sample, however long the processor was away. A position that is valid is right; in
motion it is lost with the link, and only then or where SYNCs were away for long. No time is asserted.
"""

from __future__ import annotations

import contextlib
import http.client
import signal
import struct
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit
from zlib import crc32

import can
import canopen
import pytest
from network import (
    ADC_COB_ID,
    INTERFACE_ID,
    LOOK_S,
    NODE_ID,
    POSITION_COB_ID,
    SYNC,
    TIMES,
    Master,
    Timer,
    position_fields,
    slow_motion,
    start_command,
    tolerate_late_syncs,
    wait_for_boot_up,
    write_config,
)
from pace import Pace
from test_interface_comes_back import down

from canfb.cia301.codes import AbortCode
from canfb.objects import TABLE_STAGED, StatusBit
from canfb.signal.correction import CorrectionTable
from processes import Process, Started

RPM, RAMP_S = 6.0, 0.02
RAMP_SYNCS = 25  # 1 ms of the motion each
MOTION = f"{{standstill_s: 0.0, ramp_s: {RAMP_S}, rpm: {RPM}}}"
CYCLES_PER_SYNC = RPM / 60.0 * 2500 * 1e-3
UNITS_PER_CYCLE = 8192
CLOSE_CYCLES = 0.05
SAMPLE = struct.Struct("<hhI")
TICKS_PER_S = 10_000_000  # of a sample time
ANSWERS = 20  # after each thing that happens
UNANSWERED = 10  # looks, until a SYNC is given up: the queue of a socket may overflow
SEGMENTS = 16  # of a block: what a master on a busy machine takes in within the SDO time-out
TABLE = CorrectionTable.identity(512).to_bytes()
GIVEN_UP = (AbortCode.TIMEOUT, AbortCode.COMMAND, AbortCode.SEQUENCE_NUMBER)  # the last two: late answers
MOST_GROWTH_KB = 8192
MOST_LINES = 60


class Judged(threading.Thread):
    """SYNC after SYNC, each when the one before is answered, and each position against the machine's."""

    def __init__(self, channel: str, pace: Pace) -> None:
        super().__init__(daemon=True)
        self._channel, self._pace = channel, pace
        self._over, self._answered = threading.Event(), threading.Event()
        self._step_cycles = CYCLES_PER_SYNC / pace.period_s
        self._ticks, self._sampled_s = 0, 0.0
        self._speeding_up = RAMP_SYNCS
        self._apart: float | None = None
        self._answers = 0
        self.is_valid = False
        self.wrong: list[str] = []

    def __enter__(self) -> Judged:
        self.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._over.set()
        self.join()

    def run(self) -> None:
        timer = Timer(self._pace)
        while not self._over.is_set():
            with contextlib.suppress(can.CanError), self._open() as bus:
                while not self._over.is_set():
                    timer.wait()
                    bus.send(SYNC)
                    self._hear(bus)
            self._over.wait(LOOK_S)

    def wait(self) -> None:
        """ANSWERS positions more; none was wrong so far."""
        self._answers = 0
        self._answered.clear()
        assert self._answered.wait(self._pace.patience_s), "no position comes any more"
        assert not self.wrong, self.wrong

    def _open(self) -> can.BusABC:
        heard = [{"can_id": can_id, "can_mask": 0x7FF} for can_id in (ADC_COB_ID, POSITION_COB_ID)]
        return can.Bus(interface="socketcan", channel=self._channel, can_filters=heard)

    def _hear(self, bus: can.BusABC) -> None:
        for _ in range(UNANSWERED):
            message = bus.recv(LOOK_S)
            if message is None:
                if self._over.is_set():
                    return
            elif message.arbitration_id == POSITION_COB_ID:
                self._judge(*position_fields(bytes(message.data))[:2])
                return
            else:
                before, self._ticks = self._ticks, SAMPLE.unpack(message.data)[2]
                self._sampled_s += (self._ticks - before & 0xFFFFFFFF) / TICKS_PER_S

    def _judge(self, position: int, status: int) -> None:
        self._speeding_up -= 1
        self.is_valid = bool(status & StatusBit.VALID)
        if status & StatusBit.LOST:
            self._apart = None
        elif self.is_valid and self._speeding_up < 0:
            apart = position / UNITS_PER_CYCLE - self._step_cycles * self._sampled_s
            if self._apart is None:
                self._apart = apart
            if abs(apart - self._apart) > CLOSE_CYCLES:
                self.wrong.append(f"{apart - self._apart:.3f} cycle off at {self._sampled_s:.3f} s")
        self._answers += 1
        if self._answers >= ANSWERS:
            self._answered.set()


class ResourcesOf:
    """File descriptors and memory of processes, by name."""

    def __init__(self, processes: dict[str, Process]) -> None:
        self._processes = processes
        self.first = self.now()

    def now(self) -> dict[str, tuple[int, int]]:
        return {
            name: (len(list(Path(f"/proc/{one.pid}/fd").iterdir())), rss_kb(one.pid))
            for name, one in self._processes.items()
        }

    def check(self, patience_s: float) -> None:
        """Nothing has leaked since the start; connections that were closed may be so a little later."""
        wait = threading.Event()
        for _ in range(int(patience_s / LOOK_S)):
            if not self.more_descriptors():
                break
            wait.wait(LOOK_S)
        assert not self.more_descriptors()
        for name, (_, memory_kb) in self.now().items():
            assert memory_kb - self.first[name][1] < MOST_GROWTH_KB, name

    def more_descriptors(self) -> list[str]:
        """Processes that have more than at the start."""
        return [name for name, (descriptors, _) in self.now().items() if descriptors > self.first[name][0]]


def rss_kb(pid: int) -> int:
    status = Path(f"/proc/{pid}/status").read_text()
    return int(next(line for line in status.splitlines() if line.startswith("VmRSS")).split()[1])


class Page:
    """The page of the scope, got again and again, and the beginning of its stream."""

    def __init__(self, address: str) -> None:
        self._where = urlsplit(address)

    def get(self) -> None:
        where = self._where
        assert where.hostname is not None
        for path in ("/", f"/events?{where.fragment}"):
            with contextlib.closing(http.client.HTTPConnection(where.hostname, where.port)) as connection:
                connection.request("GET", path)
                answer = connection.getresponse()
                assert answer.status == 200
                assert answer.readline()


@contextlib.contextmanager
def stopped(one: Process) -> Iterator[None]:
    """It gets no processor."""
    one.send(signal.SIGSTOP)
    try:
        yield
    finally:
        one.send(signal.SIGCONT)


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """canopen asks for 127 segments."""
    monkeypatch.setattr("canopen.sdo.client.BlockUploadStream.blksize", SEGMENTS)


@pytest.fixture
def processes(
    process: Started, tmp_path: Path, can_channel: str, can_bus: can.BusABC, pace: Pace
) -> dict[str, Process]:
    """All of them, in PRE-OPERATIONAL."""
    config = write_config(tmp_path, TIMES, slow_motion(pace, MOTION))
    nodes = ("-i", "socketcan", "-c", can_channel, str(NODE_ID))
    started = {
        "run": process("run", config),
        "simulate": process("simulate", config),
        "monitor": process("monitor", "--plain", "--updates", "0.5", *nodes),
        "scope": process("monitor", "--web", *nodes),
    }
    wait_for_boot_up(can_bus, pace, NODE_ID, INTERFACE_ID)
    return started


def test_a_network_goes_on_whatever_happens_to_its_processes_and_its_bus(
    processes: dict[str, Process], can_channel: str, pace: Pace
) -> None:
    page = Page(processes["scope"].wait_for("^open http").removeprefix("open "))
    processes["monitor"].wait_for("module 32|node 32|32")
    operational(can_channel, pace)
    with Judged(can_channel, pace) as judged:
        judged.wait()
        under_load(judged, processes, page, can_channel, pace)
        said = lines(processes["run"])
        assert judged.is_valid or any("SYNC lost" in line for line in said), said
        resources = ResourcesOf(processes)
        with down(can_channel):
            for one in processes.values():
                one.wait_for("the bus fails: .*Network is down")
        for one in processes.values():
            one.wait_for("the bus works again")
        operational(can_channel, pace)
        under_load(judged, processes, page, can_channel, pace)
        resources.check(pace.patience_s)
    for name, one in processes.items():
        assert one.stop() == 0, one
        assert not any("Traceback" in line or "program error" in line for line in one.lines), one
        assert name == "monitor" or len(one.lines) < MOST_LINES, one


def operational(channel: str, pace: Pace) -> None:
    """Both nodes; no position is given up because a SYNC is late."""
    with can.Bus(interface="socketcan", channel=channel) as bus:
        tolerate_late_syncs(bus, pace)
        for message in start_command(NODE_ID, INTERFACE_ID):
            bus.send(message)


def lines(one: Process) -> list[str]:
    """All that it has said so far."""
    one.find("(?!)", 0.0)
    return one.lines


def under_load(judged: Judged, processes: dict[str, Process], page: Page, channel: str, pace: Pace) -> None:
    """Tables by block transfer, pages, and each program stands still for a while."""
    with Master(channel, pace) as master:
        while not transferred(master.module.sdo):
            pass
    for one in processes.values():
        with stopped(one):
            threading.Event().wait(LOOK_S)
        page.get()
        judged.wait()


def transferred(sdo: Any) -> bool:
    """Whether the module has not given it up: a master may be silent for longer than its time-out."""
    try:
        for mode in ("wb", "rb"):
            with sdo.open(*TABLE_STAGED, mode, block_transfer=True, size=len(TABLE)) as file:
                if mode == "wb":
                    file.write(TABLE)
                else:
                    file.read()
    except canopen.SdoAbortedError as aborted:
        if aborted.code not in GIVEN_UP:
            raise
        return False
    return bool(sdo[0x2020][2].raw == crc32(TABLE))
