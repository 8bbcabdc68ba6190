"""The network of the soak, and what must hold under all disturbances."""

from __future__ import annotations

import contextlib
import logging
import math
import random
from collections import Counter
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from typing import Any

from canfb import CanfbError, Feedback, FeedbackModule, Frame, ModuleConfig, Sample, StatusBit, objects as od
from canfb.cia301.codes import NmtCommand, NmtState
from canfb.device.core import NEVER
from canfb.device.node import Device, NodeDevice
from canfb.device.storage.storage import Changes, MemoryStore, Store
from canfb.hosting.event_log import EventLog
from canfb.interface.encoder_interface import EncoderInterface
from canfb.master.access import NodeAccess
from canfb.module.parameters import apply_defaults
from canfb.monitoring.bus_model import BusModel
from canfb.simulation.embedded_bus import REGULAR, EmbeddedBus, SyncProducer, SyncTiming
from canfb.sources.protocol import SourceError
from tools.soak.embedded_master import EmbeddedMaster
from tools.soak.hosted import Hosted

MODULE, INTERFACE, OTHER = 32, 16, 5
SYNC, SAMPLES = 0x080, 0x180 + INTERFACE
AMPLITUDE_COUNTS = 1500.0
MOVE_S, REST_S = 1.4, 2.0
TOP_CYCLES_S = 20_000.0
MAX_ACCELERATION_CYCLES_S2 = TOP_CYCLES_S * math.pi / MOVE_S
SAVE_POLLS, SAVES_UNTIL_FULL = 5, 9
INTERVAL_S = 1e-3
WRONG_CYCLES = 0.05
RECOVERY_S = 12.0
LOST_S = 1.0  # time after a loss until the master resets the module at standstill, like canfb node reset
PAUSE_S = 1.2  # longest time without SYNC or OPERATIONAL
MASTER_S, HEARTBEAT_S, LOST_HEARTBEAT_MS = 0.1, 0.1, 500
ANSWER_S = 0.2
HEARTBEATS, HEARTBEAT_TIME = (0x1016, 1), (0x1017, 0)
COUNTERS = range(1, 16)  # sub-indices of 2012h
CYCLES = 2500
RADIANS = 2.0 * math.pi / CYCLES
SPARE = 1.05  # declared acceleration / acceleration of the machine
ACCELERATION = {"max_acceleration_rad_s2": SPARE * MAX_ACCELERATION_CYCLES_S2 * RADIANS}
JITTER = SyncTiming(sync_jitter_us=20.0, sync_drift_ppm=-50.0)

logging.getLogger("canopen").setLevel(logging.CRITICAL)  # transfers are interrupted on purpose


def position_cycles(time_s: float) -> float:
    """Oscillation with a rest at both ends: v = top / 2 (1 - cos(2 pi t / MOVE_S))."""
    moves, within = divmod(time_s, MOVE_S + REST_S)
    t = min(within, MOVE_S)
    way = TOP_CYCLES_S / 2.0 * (t - MOVE_S / (2.0 * math.pi) * math.sin(2.0 * math.pi * t / MOVE_S))
    return 0.3 + (TOP_CYCLES_S / 2.0 * MOVE_S - way if moves % 2 else way)


def rests(time_s: float, spare_s: float = 0.0) -> bool:
    """Whether the machine stands still from ``time_s`` until ``spare_s`` later."""
    within = time_s % (MOVE_S + REST_S)
    return within >= MOVE_S and within + spare_s < MOVE_S + REST_S


def is_fast(time_s: float) -> bool:
    """Whether the machine moves fast, and will do so for some time."""
    return 0.3 <= time_s % (MOVE_S + REST_S) <= 0.4


class Machine:
    """A source of samples with a coarse track of one cycle per revolution.

    broken          the converter gives no samples
    sampled_cycles  position of the last sample
    """

    broken = False
    sampled_cycles = 0.0

    def sample_at(self, now: float) -> Sample:
        if self.broken:
            raise SourceError("the converter does not answer")
        self.sampled_cycles = position = position_cycles(now)
        coarse_sine, coarse_cosine = _tracks(position / CYCLES)
        return Sample(*_tracks(position), coarse_sine=coarse_sine, coarse_cosine=coarse_cosine)

    def next(self) -> Sample:
        """Not used: the interface calls `sample_at`."""
        raise NotImplementedError


def _tracks(position: float) -> tuple[int, int]:
    angle = 2.0 * math.pi * (position % 1.0)
    return round(AMPLITUDE_COUNTS * math.sin(angle)), round(AMPLITUDE_COUNTS * math.cos(angle))


class Cable:
    """A device whose cable can be unplugged, and can lose ADC PDOs.

    losing   number of ADC PDOs still to be lost
    stamp_s  offset of the clock of receive times; None: frames have none
    """

    def __init__(self, device: Device, stamp_s: float | None = None) -> None:
        self._device, self.stamp_s = device, stamp_s
        self.pulled = False
        self.losing = 0
        self.start, self.deadline = device.start, device.deadline

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        if self.pulled:
            return []
        if self.losing and frame.can_id == SAMPLES:
            self.losing -= 1
            return []
        if self.stamp_s is not None:
            frame = frame._replace(timestamp=now + self.stamp_s)
        return self._device.receive(frame, now)

    def tick(self, now: float, until: float = NEVER) -> list[Frame]:
        frames = self._device.tick(now, until)
        return [] if self.pulled else frames


class Sampled(bytes):
    """The data of an ADC PDO, with the true position."""

    position_cycles: float
    """Where the machine truly was."""


class SampledInterface(EncoderInterface):
    """The data of its ADC PDOs are :class:`Sampled`."""

    source: Machine

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        return [self._marked(one) if one.can_id == SAMPLES else one for one in super().receive(frame, now)]

    def _marked(self, frame: Frame) -> Frame:
        data = Sampled(frame.data)
        data.position_cycles = self.source.sampled_cycles
        return frame._replace(data=data)


class WatchedModule(FeedbackModule):
    """A module; ``truth_cycles``: true position of the last sample received."""

    def __init__(self, config: ModuleConfig, store: Store) -> None:
        self.truth_cycles = 0.0
        super().__init__(config, store)

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        if isinstance(frame.data, Sampled):
            self.truth_cycles = frame.data.position_cycles
        return super().receive(frame, now)


class SlowStore(MemoryStore):
    """A store that must be polled several times before a save is done; one in nine fails."""

    def __init__(self) -> None:
        super().__init__()
        self._begun: list[Changes] = []
        self._polls = self._saves = 0

    def begin(self, changes: Changes) -> None:
        self._begun.append(changes)
        self._polls = SAVE_POLLS

    def ended(self) -> Collection[OSError | None]:
        self._polls -= 1
        if self._polls > 0:
            return ()
        begun, self._begun = self._begun, []
        return [self._save(changes) for changes in begun]

    def _save(self, changes: Changes) -> OSError | None:
        self._saves += 1
        if self._saves % SAVES_UNTIL_FULL == 0:
            return OSError(28, "No space left on device")
        self.save(changes)
        return None


@dataclass(frozen=True)
class Setup:
    """A network.

    config    configuration of the module
    stamps    frames have receive times
    coarse    samples have a coarse track, in the same PDO
    hosted    the module is in the runner of `canfb run`
    bit_rate  bit/s: frames take time and wait for each other; None: they take no time
    timing    timing of SYNC
    """

    name: str
    config: dict[str, Any] = field(default_factory=dict)
    stamps: bool = False
    coarse: bool = False
    hosted: bool = False
    bit_rate: int | None = None
    timing: SyncTiming = REGULAR


SETUPS = (
    Setup("plain", ACCELERATION),
    Setup("times", ACCELERATION | {"times": True}),
    Setup("two samples", ACCELERATION | {"times": True, "samples_per_sync": 2}),
    Setup("coarse track", ACCELERATION, coarse=True),
    Setup("predicted", ACCELERATION | {"times": True, "predict": True}),
    Setup("receive times", ACCELERATION | {"times": True}, stamps=True),
    Setup("wire", ACCELERATION | {"times": True}, bit_rate=1_000_000, timing=JITTER),
    Setup("hosted", ACCELERATION, hosted=True),
    Setup("hosted, times", ACCELERATION | {"times": True}, hosted=True),
)


@dataclass
class Findings:
    """Results; `bad`, the number of violations, must stay 0."""

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
    first_uncounted: str = ""

    @property
    def bad(self) -> int:
        return self.wrong + self.uncounted + self.not_recovered


def _map_third_and_fourth(device: NodeDevice, mapping: int, *objects: od.Multiplexer) -> None:
    mapped = {(mapping, sub): one.mapped(16) for sub, one in enumerate(objects, 3)}
    apply_defaults(device.dictionary, mapped | {(mapping, 0): 4})


class World:
    """Module, encoder interface, SYNC, master, monitor, and a node that is unplugged at times."""

    def __init__(self, setup: Setup, seed: int) -> None:
        self.found = Findings()
        self.setup = setup
        self.rng = random.Random(f"{seed} {setup.name}")
        self.bus = bus = EmbeddedBus(setup.bit_rate)
        self.machine = Machine()
        config = ModuleConfig(
            node_id=MODULE, encoder_interface=INTERFACE, cycles_per_revolution=CYCLES, **setup.config
        )
        self.module = WatchedModule(config, SlowStore())
        self.interface = SampledInterface(
            INTERFACE,
            self.machine,
            times=config.times,
            samples_per_sync=config.samples_per_sync,
            autostart=True,
        )
        if setup.coarse:
            _map_third_and_fourth(self.module, 0x1600, od.SAMPLE_COARSE_SINE, od.SAMPLE_COARSE_COSINE)
            _map_third_and_fourth(
                self.interface, 0x1A00, od.INTERFACE_COARSE_SINE, od.INTERFACE_COARSE_COSINE
            )
        self._log = logging.getLogger("canfb.hosting.event_log")
        self._log.setLevel(logging.INFO)
        self._log.addFilter(self._counts)
        self.hosted = Hosted(self.module, self._log.info) if setup.hosted else None
        self.cable = Cable(self.hosted or self.module, 0.0 if setup.stamps else None)
        other = EncoderInterface(OTHER, Machine())
        apply_defaults(other.dictionary, {HEARTBEAT_TIME: round(1e3 * HEARTBEAT_S)})
        self.other = Cable(other)
        self.monitor = BusModel()
        self.syncs = self.feedbacks = 0
        self.interruptions = 0
        """Times at which cycles need not be counted: the position is lost, the module not OPERATIONAL."""
        self._was_valid = False  # whether a position was valid since the last start
        self._offset: int | None = None
        self._counted = 0
        self._next_s = self._synced_s = 0.0
        self._suffers = "the start"
        self._events = EventLog()
        self._events.watch(self.module, self.module.events)
        self._events.begin()
        self._counters = [self.module.dictionary.entry(0x2012, sub) for sub in COUNTERS]
        self.module.on_feedback = self._judge
        bus.observers.append(self._hear)
        self.producer = SyncProducer(INTERVAL_S, setup.timing, seed)
        participants: tuple[Device, ...] = (self.cable, self.interface, self.other, self.producer)
        for one in participants:
            bus.attach(one)
        self.master = EmbeddedMaster(bus, ANSWER_S)
        self.access = NodeAccess(self.master, MODULE, "module")
        self._configure()

    def close(self) -> None:
        self._log.removeFilter(self._counts)
        self._log.setLevel(logging.NOTSET)
        if self.hosted is not None:
            self.hosted.close()

    def _counts(self, record: logging.LogRecord) -> bool:
        """A log filter that counts the lines, and suppresses their output."""
        self.found.log_lines += 1
        return False

    def suffer(self, name: str, disturbance: Callable[[World], None]) -> None:
        """Apply a disturbance, wait until the position is valid again, check that all cycles are counted."""
        self._settle()
        self._suffers = name
        before = self.interruptions, self.syncs - self.feedbacks
        try:
            disturbance(self)
        except CanfbError:
            self.found.refused += 1
        self.found.done[name] += 1
        self.recover()
        self._settle()
        after = self.interruptions, self.syncs - self.feedbacks
        if before[0] == after[0] and before[1] != after[1]:
            self.miss_count(abs(after[1] - before[1]), f"{after[1] - before[1]} SYNCs without a feedback")

    def _settle(self) -> None:
        all_came_s = self._synced_s + 0.8 * INTERVAL_S
        self.bus.run_until(all_came_s if all_came_s >= self.bus.now else all_came_s + INTERVAL_S)

    def pass_(self, seconds: float) -> None:
        """Wait; in this time the master starts a module that is PRE-OPERATIONAL."""
        end = self.bus.now + seconds
        while self.bus.now < end:
            self.bus.run_until(min(end, self.bus.now + HEARTBEAT_S / 2.0))
            if self.bus.now >= self._next_s:
                self._next_s = self.bus.now + MASTER_S
                self._events.tick(self.bus.now)
                if self.module.state is NmtState.PRE_OPERATIONAL:
                    self.nmt(NmtCommand.START)

    def recover(self) -> None:
        """Wait until the position is valid; after LOST_S reset the module at standstill."""
        began = reset_s = self.bus.now
        while not self.valid():
            if self.bus.now - began > RECOVERY_S:
                self.found.not_recovered += 1
                return
            if self.bus.now - reset_s > LOST_S and rests(self.bus.now, 0.5):
                reset_s = self.bus.now
                self.found.lost += 1
                self.reset(NmtCommand.RESET_NODE)
            self.pass_(0.02)
        self.found.longest_recovery_s = max(self.found.longest_recovery_s, self.bus.now - began)

    def nmt(self, command: NmtCommand) -> None:
        self.interruptions += 1
        self._was_valid = False
        self.bus.send(Frame(0x000, bytes((command, MODULE))))

    def reset(self, command: NmtCommand) -> None:
        """Reset the module, and start it again, also if SDO gets no answer."""
        self.nmt(command)  # with a bit rate, a last position may be published before the reset arrives
        self._offset, self._counted = None, -1  # position and counters restart at 0
        self._configure()

    def pause_begins(self) -> None:
        """Wait for a rest as long as a pause, or for fast motion: no motion may start in a pause."""
        rest = self.rng.random() < 0.5
        while not (rests(self.bus.now, PAUSE_S) if rest else is_fast(self.bus.now)):
            self.pass_(0.02)

    def interrupt(self) -> None:
        """Begin a pause in which cycles need not be counted."""
        self.pause_begins()
        self.interruptions += 1

    def missed(self) -> int:
        """Missed samples, 2012:01."""
        return int(self.module.dictionary.entry(*od.COUNTER_MISSED).value)

    def miss_count(self, cycles: int, what: str) -> None:
        self.found.uncounted += cycles
        what = f"{self.bus.now:.3f} s, {self._suffers}: {what}"
        self.found.first_uncounted = self.found.first_uncounted or what

    def _configure(self) -> None:
        with contextlib.suppress(CanfbError):
            self.access.write(*HEARTBEATS, "I", OTHER << 16 | LOST_HEARTBEAT_MS)
        self.nmt(NmtCommand.START)

    def bus_event(self, event: Callable[[float], list[Frame]]) -> None:
        """Notify the device of an event of its bus; send its frames."""
        for frame in event(self.bus.now):
            self.bus.send(frame)

    def valid(self) -> bool:
        return bool(self.module.dictionary.entry(*od.FEEDBACK_STATUS).current() & StatusBit.VALID)

    def _hear(self, frame: Frame, now: float) -> None:
        if frame.can_id == SYNC and not frame.data:
            self.syncs += 1
            self._synced_s = now
            self.found.cycles += 1
        self.monitor.receive(frame, now)

    def _judge(self, feedback: Feedback, now: float) -> None:
        status = feedback.status
        self.feedbacks += 1
        if status & StatusBit.LOST:
            self._offset = None
            self.interruptions += 1
        if not status & StatusBit.VALID:
            self._judge_count(status)
            return
        self.found.valid += 1
        self._was_valid = True
        error = feedback.cycles + feedback.phase - self.module.truth_cycles
        if self._offset is None:
            self._offset = round(error)
        if abs(error - self._offset) > WRONG_CYCLES:
            what = f"{now:.3f} s, {self._suffers}: off by {error - self._offset:.3f} cycle"
            self.found.wrong += 1
            self.found.first_wrong = self.found.first_wrong or what

    def _judge_count(self, status: int) -> None:
        """Check a cycle without a valid position: it is counted, or the position is lost or not yet valid."""
        counted = sum(int(one.value) for one in self._counters)
        if counted == self._counted and not status & StatusBit.LOST and self._was_valid:
            self.miss_count(1, f"status {status:04X}h and no counter")
        self._counted = counted
