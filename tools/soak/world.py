"""The network of the soak, and what must hold whatever happens to it."""

from __future__ import annotations

import contextlib
import logging
import math
import random
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from canfb import objects as od
from canfb.cia301.codes import NmtCommand, NmtState
from canfb.cia301.frame import Frame
from canfb.errors import CanfbError
from canfb.hosting.event_log import EventLog
from canfb.master.access import NodeAccess
from canfb.module.module_config import ModuleConfig
from canfb.module.parameters import apply_defaults
from canfb.monitoring.bus_model import BusModel
from canfb.objects import StatusBit
from canfb.signal.sample import Feedback
from canfb.simulation.embedded_bus import REGULAR, EmbeddedBus, SyncProducer, SyncTiming
from tools.soak.embedded_master import EmbeddedMaster
from tools.soak.hosted import Hosted
from tools.soak.parts import (
    MAX_ACCELERATION_CYCLES_S2,
    Cable,
    Machine,
    OtherNode,
    SampledInterface,
    SlowStore,
    WatchedModule,
    is_fast,
    rests,
)

MODULE, INTERFACE, OTHER = 32, 16, 5
SYNC, SAMPLES = 0x080, 0x180 + INTERFACE
INTERVAL_S = 1e-3
WRONG_CYCLES = 0.05
RECOVERY_S = 12.0
LOST_S = 1.0  # then the master resets the module at the next rest, as canfb node reset does
PAUSE_S = 1.2  # longest time without SYNC or OPERATIONAL
MASTER_S, HEARTBEAT_S, LOST_HEARTBEAT_MS = 0.1, 0.1, 500
ANSWER_S = 0.2
HEARTBEATS = (0x1016, 1)
COUNTERS = range(1, 16)  # of 2012h
COARSE = {
    (0x1600, 0): 4,
    (0x1600, 3): od.SAMPLE_COARSE_SINE.mapped(16),
    (0x1600, 4): od.SAMPLE_COARSE_COSINE.mapped(16),
}
COARSE_SENT = {
    (0x1A00, 0): 4,
    (0x1A00, 3): od.INTERFACE_COARSE_SINE.mapped(16),
    (0x1A00, 4): od.INTERFACE_COARSE_COSINE.mapped(16),
}
CYCLES = 2500
RADIANS = 2.0 * math.pi / CYCLES
SPARE = 1.05  # declared beyond what the machine does
ACCELERATION = {"max_acceleration_rad_s2": SPARE * MAX_ACCELERATION_CYCLES_S2 * RADIANS}
JITTER = SyncTiming(sync_jitter_us=20.0, sync_drift_ppm=-50.0)
MOST_ON_THE_WAY = 4096  # samples


@dataclass(frozen=True)
class Setup:
    """A network.

    config    of the module
    stamps    frames have receive times
    coarse    samples have a coarse track, in the same PDO
    hosted    the module is in the runner of `canfb run`
    bit_rate  of the bus, bit/s: frames take time and wait for each other; None: they do not
    timing    of the SYNC
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
    first_uncounted: str = ""

    @property
    def bad(self) -> int:
        return self.wrong + self.uncounted + self.not_recovered


class World:
    """Module, encoder interface, SYNC, master, monitor, and a node that comes and goes."""

    def __init__(self, setup: Setup, seed: int) -> None:
        self.found = Findings()
        self.setup = setup
        self.rng = random.Random(f"{seed} {setup.name}")
        self.bus = bus = EmbeddedBus(setup.bit_rate)
        self.machine = Machine(CYCLES, coarse=setup.coarse)
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
            apply_defaults(self.module.dictionary, COARSE)
            apply_defaults(self.interface.dictionary, COARSE_SENT)
        self.hosted = Hosted(self.module, self._say) if setup.hosted else None
        self.cable = Cable(self.hosted or self.module, 0.0 if setup.stamps else None)
        self.other = OtherNode(OTHER, HEARTBEAT_S)
        self.monitor = BusModel()
        self.syncs = self.feedbacks = 0
        self.interruptions = 0
        """Times at which cycles need not be counted: the position is lost, the module not OPERATIONAL."""
        self._was_valid = False  # since the last start
        self._truths: dict[int, tuple[bytes, float]] = {}  # by the identity of the bytes of its PDO
        self._truth = 0.0
        self._offset: int | None = None
        self._counted = 0
        self._next_s = self._synced_s = 0.0
        self._suffers = "the start"
        self._events = EventLog()
        self._log = logging.getLogger("canfb.hosting.event_log")
        self._log.setLevel(logging.INFO)
        handler = logging.Handler()
        handler.emit = lambda record: self._say("")  # type: ignore[method-assign]
        self._log.handlers, self._log.propagate = [handler], False
        self._events.watch(self.module, self.module.events)
        self._events.begin()
        self._counters = [self.module.dictionary.entry(0x2012, sub) for sub in COUNTERS]
        self.module.on_feedback = self._judge
        self.module.on_frame = self._arrives
        self.interface.on_sample = self._leaves
        bus.observers.append(self._hear)
        self.producer = SyncProducer(INTERVAL_S, setup.timing, seed)
        for device in (self.cable, self.interface, self.other, self.producer):
            bus.attach(device)
        self.master = EmbeddedMaster(bus, ANSWER_S)
        self.access = NodeAccess(self.master, MODULE, "module")
        self._configure()

    def close(self) -> None:
        self._log.handlers, self._log.propagate = [], True
        self._log.setLevel(logging.NOTSET)
        if self.hosted is not None:
            self.hosted.close()

    def run(
        self,
        cycles: int,
        disturbances: Mapping[str, Callable[[World], None]],
        look: Callable[[], None] = lambda: None,
    ) -> Findings:
        """So many cycles of SYNC, with one of the disturbances after the other."""
        while self.found.cycles < cycles:
            self.pass_(self.rng.uniform(0.05, 0.5))
            name = self.rng.choice(sorted(disturbances))
            self.suffer(name, disturbances[name])
            look()
        return self.found

    def suffer(self, name: str, disturbance: Callable[[World], None]) -> None:
        """One disturbance, until the position is right again and each cycle since is accounted for."""
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
        end = self.bus.now + seconds
        while self.bus.now < end:
            self.bus.run_until(min(end, self.bus.now + HEARTBEAT_S / 2.0))
            if self.bus.now >= self._next_s:
                self._next_s = self.bus.now + MASTER_S
                self.care()

    def care(self) -> None:
        """What the master does now and then: it starts a module that has stopped."""
        self._events.tick(self.bus.now)
        if self.module.state is NmtState.PRE_OPERATIONAL:
            self.nmt(NmtCommand.START)

    def recover(self) -> None:
        """The position is valid again: by itself or, if it is lost, by a reset at a rest."""
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
        """Reset the module, and start it again. A master that gets no answer gives up."""
        self.nmt(command)  # on a wire, a last position may be published before it arrives
        self._offset, self._counted = None, -1  # position and counters begin at 0
        self._configure()

    def pause_begins(self) -> None:
        """What stands when a pause begins must not move in it: docs/supervision.md, Start of the module."""
        rest = self.rng.random() < 0.5
        while not (rests(self.bus.now, PAUSE_S) if rest else is_fast(self.bus.now)):
            self.pass_(0.02)

    def missed(self) -> int:
        """2012:01."""
        return int(self.module.dictionary.entry(*od.COUNTER_MISSED).value)

    def miss_count(self, cycles: int, what: str) -> None:
        self.found.uncounted += cycles
        what = f"{self.bus.now:.3f} s, {self._suffers}: {what}"
        self.found.first_uncounted = self.found.first_uncounted or what

    def _configure(self) -> None:
        with contextlib.suppress(CanfbError):
            self.access.write(*HEARTBEATS, "I", OTHER << 16 | LOST_HEARTBEAT_MS)
        self.nmt(NmtCommand.START)

    def _say(self, line: str) -> None:
        self.found.log_lines += 1

    def happens(self, event: str) -> None:
        """An event of the bus, by its name in :class:`tools.soak.hosted.Socket`."""
        if self.hosted is not None:
            frames = self.hosted.happen(getattr(self.hosted.bus, event), self.bus.now)
        elif event == "bus_off":
            self.module.bus_off(self.bus.now)
            frames = []
        else:
            frames = self.module.bus_back(self.bus.now)
        for frame in frames:
            self.bus.send(frame)

    def valid(self) -> bool:
        return bool(self.module.dictionary.entry(*od.FEEDBACK_STATUS).current() & StatusBit.VALID)

    def _hear(self, frame: Frame, now: float) -> None:
        if frame.can_id == SYNC and not frame.data:
            self.syncs += 1
            self._synced_s = now
            self.found.cycles += 1
        self.monitor.receive(frame, now)

    def _leaves(self, frame: Frame) -> None:
        if frame.can_id == SAMPLES:
            self._truths.pop(id(frame.data), None)
            self._truths[id(frame.data)] = frame.data, self.machine.sampled_cycles
            if len(self._truths) > MOST_ON_THE_WAY:
                del self._truths[next(iter(self._truths))]

    def _arrives(self, frame: Frame) -> None:
        if frame.can_id == SAMPLES:
            _, self._truth = self._truths.get(id(frame.data), (b"", self._truth))

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
        error = feedback.cycles + feedback.phase - self._truth
        if self._offset is None:
            self._offset = round(error)
        if abs(error - self._offset) > WRONG_CYCLES:
            what = f"{now:.3f} s, {self._suffers}: off by {error - self._offset:.3f} cycle"
            self.found.wrong += 1
            self.found.first_wrong = self.found.first_wrong or what

    def _judge_count(self, status: int) -> None:
        """A cycle without a valid position is in a counter, or the position is lost, or was not valid yet."""
        counted = sum(int(one.value) for one in self._counters)
        if counted == self._counted and not status & StatusBit.LOST and self._was_valid:
            self.miss_count(1, f"status {status:04X}h and no counter")
        self._counted = counted
