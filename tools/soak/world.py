"""The network of the soak, what happens to it, and what must hold whatever happens."""

from __future__ import annotations

import logging
import math
import random
import struct
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from canfb import objects as od
from canfb.bus.event_log import EventLog
from canfb.cia301.frame import Frame
from canfb.cia301.nmt import NmtCommand, NmtState
from canfb.commissioning.access import NodeAccess
from canfb.errors import CanfbError
from canfb.interface.encoder_interface import EncoderInterface
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig
from canfb.monitoring.bus_model import BusModel
from canfb.objects import StatusBit
from canfb.signal.correction import CorrectionTable
from canfb.signal.feedback import Feedback
from canfb.simulation.embedded_bus import EmbeddedBus
from canfb.simulation.sync_producer import SyncProducer
from tools.soak.embedded_master import EmbeddedMaster
from tools.soak.machine import MAX_ACCELERATION_CYCLES_S2, MAX_JERK_CYCLES_S3, Machine, is_fast, rests
from tools.soak.parts import Cable, OtherNode, SlowStore

MODULE, INTERFACE, OTHER = 32, 16, 5
CYCLES = 2500
INTERVAL_S = 1e-3
RADIANS = 2.0 * math.pi / CYCLES
SPARE = 1.05  # declared beyond what the machine does
WRONG_CYCLES = 0.05
RECOVERY_S = 12.0
LOST_S = 1.0  # then the master resets the module at the next rest, as canfb reset does
PAUSE_S = 1.2  # longest time without SYNC or OPERATIONAL
MASTER_S, HEARTBEAT_S, LOST_HEARTBEAT_MS = 0.1, 0.1, 500
ANSWER_S = 0.2
EDS, NAME, HEARTBEATS = (0x1021, 0), (0x1008, 0), (0x1016, 1)
TABLE = CorrectionTable.identity(64)
FLOOD = [one for one in range(0x101, 0x7E0) if one & 0x7F not in (MODULE, INTERFACE, OTHER)]


@dataclass(frozen=True)
class Setup:
    """How the module is configured."""

    name: str
    config: dict[str, Any] = field(default_factory=dict)
    stamps: bool = False


ACCELERATION = {"max_acceleration_rad_s2": SPARE * MAX_ACCELERATION_CYCLES_S2 * RADIANS}
JERK = {"prediction_order": 3, "max_jerk_rad_s3": SPARE * MAX_JERK_CYCLES_S3 * RADIANS}
SETUPS = (
    Setup("plain", ACCELERATION),
    Setup("times", ACCELERATION | {"times": True}),
    Setup("third order", JERK | {"times": True}),
    Setup("receive times", ACCELERATION | {"times": True}, stamps=True),
)


@dataclass
class Findings:
    """What was seen. `bad` must stay 0 each."""

    cycles: int = 0
    valid: int = 0
    done: Counter[str] = field(default_factory=Counter)
    refused: int = 0
    lost: int = 0
    log_lines: int = 0
    longest_recovery_s: float = 0.0
    wrong: int = 0
    uncounted: int = 0
    not_recovered: int = 0
    first_wrong: str = ""

    @property
    def bad(self) -> int:
        return self.wrong + self.uncounted + self.not_recovered


class _Lines(logging.Handler):
    def __init__(self, found: Findings) -> None:
        super().__init__()
        self._found = found

    def emit(self, record: logging.LogRecord) -> None:
        self._found.log_lines += 1


class World:
    """Module, encoder interface, SYNC, master, monitor, and a node that comes and goes."""

    def __init__(self, setup: Setup, seed: int) -> None:
        self.found = Findings()
        self._rng = random.Random(f"{seed} {setup.name}")
        self._bus = bus = EmbeddedBus()
        self._machine = Machine()
        config = ModuleConfig(
            node_id=MODULE, encoder_interface=INTERFACE, cycles_per_revolution=CYCLES, **setup.config
        )
        self.module = FeedbackModule(config, SlowStore())
        self._cable = Cable(self.module)
        if setup.stamps:
            self._cable.stamp_s = 0.0
        self._interface = EncoderInterface(INTERFACE, self._machine, times=config.times, autostart=True)
        self._monitor = BusModel()
        self._offset: int | None = None
        self._other = OtherNode(OTHER, HEARTBEAT_S)
        self._next_s = 0.0
        self._events = EventLog()
        self._log = logging.getLogger("canfb.bus.event_log")
        self._log.setLevel(logging.INFO)
        self._log.propagate = False
        self._log.handlers = [_Lines(self.found)]
        self._events.watch(self.module, self.module.events)
        self._events.begin()
        self.module.on_feedback = self._judge
        bus.taps.append(self._hear)
        for device in (self._cable, self._interface, self._other, SyncProducer(INTERVAL_S)):
            bus.attach(device)
        self._master = EmbeddedMaster(bus, ANSWER_S)
        self._access = NodeAccess(self._master, MODULE, "module")
        self._access.write(*HEARTBEATS, "I", OTHER << 16 | LOST_HEARTBEAT_MS)
        self._nmt(NmtCommand.START)

    # -- what goes on all the time ---------------------------------------------------------------------

    def run(self, cycles: int, look: Callable[[], None] = lambda: None) -> Findings:
        """So many cycles of SYNC, with one disturbance after the other."""
        found = self.found
        while found.cycles < cycles:
            self._pass(self._rng.uniform(0.05, 0.5))
            name = self._rng.choice(sorted(DISTURBANCES))
            try:
                DISTURBANCES[name](self)
            except CanfbError:
                found.refused += 1
            found.done[name] += 1
            self._recover()
            look()
        return found

    def _hear(self, frame: Frame, now: float) -> None:
        if frame.can_id == 0x080:
            self._machine.now = now
            self.found.cycles += 1
        self._monitor.receive(frame, now)

    def _pass(self, seconds: float) -> None:
        """Time passes; the master starts a module that has stopped."""
        end = self._bus.now + seconds
        while self._bus.now < end:
            self._bus.run_until(min(end, self._bus.now + HEARTBEAT_S / 2.0))
            now = self._bus.now
            if now >= self._next_s:
                self._next_s = now + MASTER_S
                self._events.tick(now)
                if self.module.state is NmtState.PRE_OPERATIONAL:
                    self._nmt(NmtCommand.START)

    def _recover(self) -> None:
        """The position is valid again: by itself or, if it is lost, by a reset at a rest (docs/lost.md)."""
        began = reset_s = self._bus.now
        while not self._valid():
            if self._bus.now - began > RECOVERY_S:
                self.found.not_recovered += 1
                return
            if self._bus.now - reset_s > LOST_S and rests(self._bus.now, 0.5):
                reset_s = self._bus.now
                self.found.lost += 1
                self._reset(NmtCommand.RESET_NODE)
            self._pass(0.02)
        self.found.longest_recovery_s = max(self.found.longest_recovery_s, self._bus.now - began)

    def _valid(self) -> bool:
        return bool(self.module.dictionary.entry(*od.FEEDBACK_STATUS).current() & StatusBit.VALID)

    def _judge(self, feedback: Feedback, now: float) -> None:
        if feedback.status & StatusBit.LOST:
            self._offset = None
        if not feedback.status & StatusBit.VALID:
            return
        self.found.valid += 1
        error = feedback.cycles + feedback.phase - self._machine.sampled_cycles
        if self._offset is None:
            self._offset = round(error)
        if abs(error - self._offset) > WRONG_CYCLES:
            self.found.wrong += 1
            if not self.found.first_wrong:
                did = dict(self.found.done)
                self.found.first_wrong = f"{now:.3f} s, off by {error - self._offset:.3f} cycle, after {did}"

    def _nmt(self, command: NmtCommand) -> None:
        self._bus.send(Frame(0x000, bytes((command, MODULE))))

    # -- what happens ----------------------------------------------------------------------------------

    def samples_lost(self) -> None:
        """Up to three ADC PDOs in a row, and each of them is counted."""
        lost, before = self._rng.randint(1, 3), self._counter()
        self._cable.losing[0x180 + INTERFACE] = lost
        self._pass(0.02)
        self.found.uncounted += abs(self._counter() - before - lost)

    def _counter(self) -> int:
        return int(self.module.dictionary.entry(*od.COUNTER_MISSED).value)

    def _before_a_pause(self) -> None:
        """What stands when a pause begins must not move in it: docs/supervision.md, Start of the module."""
        rest = self._rng.random() < 0.5
        while not (rests(self._bus.now, PAUSE_S) if rest else is_fast(self._bus.now)):
            self._pass(0.02)

    def bus_off(self) -> None:
        """The bus is gone for a while, or the cable is pulled out."""
        self._before_a_pause()
        told = self._rng.random() < 0.7
        if told:
            self.module.bus_off(self._bus.now)
        self._cable.pulled = True
        self._pass(self._rng.uniform(0.002, 0.6))
        self._cable.pulled = False
        if told:
            for frame in self.module.bus_back(self._bus.now):
                self._bus.send(frame)

    def nmt_pause(self) -> None:
        """STOPPED or PRE-OPERATIONAL for a while."""
        self._before_a_pause()
        command = self._rng.choice((NmtCommand.STOP, NmtCommand.ENTER_PRE_OPERATIONAL))
        self._nmt(command)
        self._bus.run_until(self._bus.now + self._rng.uniform(0.002, 0.09))
        self._nmt(NmtCommand.START)

    def reset(self) -> None:
        """Node or communication, at standstill."""
        while not rests(self._bus.now, 0.5):
            self._pass(0.05)
        self._reset(self._rng.choice((NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION)))

    def _reset(self, command: NmtCommand) -> None:
        self._offset = None
        self._nmt(command)
        self._access.write(*HEARTBEATS, "I", OTHER << 16 | LOST_HEARTBEAT_MS)
        self._nmt(NmtCommand.START)

    def node_goes(self) -> None:
        """The node whose heartbeat is monitored is away for a while."""
        self._before_a_pause()
        self._other.is_there = False
        self._pass(self._rng.uniform(0.2, 0.8))
        self._other.is_there = True

    def eds_by_block(self) -> None:
        """A block upload of the EDS; one in three is given up on the way."""
        if self._rng.random() < 1.0 / 3.0:
            self._bus.send(Frame(0x600 + MODULE, struct.pack("<BHBBB2x", 0xA4, *EDS, 127, 0)))
            self._bus.send(Frame(0x600 + MODULE, b"\xa3".ljust(8, b"\0")))
            self._pass(0.01)
        else:
            self._access.upload_domain(*EDS)

    def table(self) -> None:
        """A table by block download, in force, or the identity again."""
        if self._rng.random() < 0.5:
            self._access.download_domain(*od.TABLE_STAGED, TABLE.to_bytes())
            self._access.write(*od.TABLE_ACTIVATE, "I", TABLE.crc32)
        else:
            self._access.write(*od.TABLE_ACTIVATE, "I", 0)

    def save(self) -> None:
        """1010h, now and then on a full disk."""
        self._access.write_bytes(0x1010, 1, b"save", 1.0)

    def reading(self) -> None:
        """What a monitor reads."""
        self._access.read_bytes(*NAME)
        for sub in range(1, 16):
            self._access.read_bytes(0x2012, sub)
        self._monitor.snapshot(self._bus.now)

    def flood(self) -> None:
        """A master gone mad: some hundred frames at one instant, of any content, and SDO reads."""
        for _ in range(self._rng.randint(50, 400)):
            if self._rng.random() < 0.3:
                place = self._rng.randrange(1 << 24)
                data = struct.pack("<BI3x", 0x40, place)
                self._bus.send(Frame(0x600 + MODULE, data))
            else:
                size = self._rng.randint(0, 8)
                remote = self._rng.random() < 0.05
                data = b"" if remote else self._rng.randbytes(size)
                self._bus.send(Frame(self._rng.choice(FLOOD), data, remote))

    def short_frames(self) -> None:
        """SYNC and samples of a wrong length."""
        self._bus.send(Frame(0x080, b"\1\2"))
        self._bus.send(Frame(0x180 + INTERFACE, b"\1"))
        self._bus.send(Frame(0x000, b"\1"))

    def clock_set(self) -> None:
        """The clock of the receive times is ahead for a while; one that is behind is for the runner."""
        if self._cable.stamp_s is not None:
            self._cable.stamp_s = self._rng.choice((0.0, 3600.0))


DISTURBANCES: dict[str, Callable[[World], None]] = {
    one.__name__: one
    for one in (
        World.samples_lost,
        World.bus_off,
        World.nmt_pause,
        World.reset,
        World.node_goes,
        World.eds_by_block,
        World.table,
        World.save,
        World.reading,
        World.flood,
        World.short_frames,
        World.clock_set,
    )
}
