"""The drive feedback module: a CANopen device, sans-I/O."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from math import inf

from canfb import objects as od
from canfb.cia301.codes import EmergencyCode
from canfb.cia301.frame import Frame
from canfb.cia301.nmt import NmtState
from canfb.device.moment import NEVER
from canfb.device.node import Node
from canfb.device.routing import CanIds
from canfb.device.storage.image import ParameterGroup
from canfb.device.storage.writing import Store
from canfb.module.calibration_job import CalibrationJob, Outcome
from canfb.module.cia406.cyclic_timer import CyclicTimer
from canfb.module.cia406.operating_time import OperatingTime
from canfb.module.cia406.position_alarm import REGISTER
from canfb.module.delivered import delivered_dictionary
from canfb.module.event_watch import EventWatch
from canfb.module.interval import SamplingInterval
from canfb.module.jitter_watch import JitterWatch
from canfb.module.local_source import LocalSource
from canfb.module.module_config import ModuleConfig
from canfb.module.objects.adapting import Adapting
from canfb.module.objects.calibrating import Calibrating
from canfb.module.objects.recorder import Recorder
from canfb.module.objects.sample_input import SampleInput
from canfb.module.objects.second_input import SecondInput
from canfb.module.objects.table_store import TableStore
from canfb.module.objects.write_lock import WriteLock
from canfb.module.parameters import Limits
from canfb.module.publishing import Publishing
from canfb.module.sampling import Sampling
from canfb.module.tap import Taps
from canfb.signal.chain import SignalChain
from canfb.signal.chain_config import ChainConfig, ChainLimits
from canfb.signal.correction import Correction
from canfb.signal.feedback import Feedback
from canfb.sources.protocol import Source
from canfb.timing.judge import Judge

COMMANDS = (od.MEASUREMENT_COMMAND.object_index, od.RECORDING_COMMAND.object_index)


class FeedbackModule:
    """ADC sine/cosine PDOs, or the samples of a ``source``, in; a supervised position PDO out.

    Time goes in as ``now`` (seconds, monotonic), frames come out; see
    :class:`canfb.device.node.Node` for start, receive, tick and deadline. A frame never
    raises, whatever its content.

    ``store`` holds what 1010h and LSS save; without one nothing is saved. ``on_parameter_faults``
    is called with the groups of stored parameters that were refused, and the reasons.
    ``bit_rates_kbit_s`` are those that LSS may choose; see ``on_bit_rate`` of the node.

    A ``source`` provides the sample of each SYNC in OPERATIONAL at that SYNC; RPDO1 is then off.
    ``on_source`` is called with one line when it fails, works again or has ended; ``on_warning``
    when the speed approaches the limit set by the SYNC jitter; ``events`` has what happens as
    :class:`.Event`. ValueError if ``config.source``
    names a source and none is given; TypeError for a ``config`` that is not a
    :class:`canfb.ModuleConfig`.
    """

    def __init__(
        self,
        config: ModuleConfig,
        store: Store | None = None,
        *,
        source: Source | None = None,
        bit_rates_kbit_s: Collection[int] = (),
    ) -> None:
        _check(config, source)
        self.config = config
        self.dictionary = delivered_dictionary(config, samples_itself=source is not None)
        self.chain = SignalChain(ChainConfig())  # limits and correction are those of the dictionary
        self.node = Node(
            self.dictionary,
            config.node_id,
            autostart=config.autostart,
            store=store,
            bit_rates_kbit_s=bit_rates_kbit_s,
        )
        self.on_parameter_faults: Callable[[Mapping[ParameterGroup, str]], None] | None = None
        self.on_source: Callable[[str], None] | None = None
        self.on_warning: Callable[[str], None] | None = None
        self.inhibited = self.node.inhibited
        """By CAN-ID: frames of which the node wants to know when they have left; see :meth:`sent`."""
        self._make_chain_around(source)
        self._make_commands()
        self._listen_to_node()
        self._choose_parameters()
        self._lock = WriteLock(self.node)
        self._limits.apply()
        self._tables.reset()
        self._adapting.reset()

    @property
    def events(self) -> EventWatch:
        """What happens in the module: set ``on_event`` of it, and ``detailed`` for single faults."""
        return self._publishing.events

    def _make_chain_around(self, source: Source | None) -> None:
        """What feeds the chain, and what its feedback becomes."""
        dictionary, node, chain = self.dictionary, self.node, self.chain
        self._judge = judge = Judge()
        self._interval = interval = SamplingInterval(dictionary.entry(*od.CYCLE_PERIOD), judge.clock)
        self._limits = Limits(dictionary, chain, interval)
        self._input = SampleInput(dictionary, node)
        self._second = SecondInput(dictionary, node, chain)
        self._source = None
        if source is not None:
            self._source = LocalSource(source, dictionary, self._input, self._tell_of_source)
        self._taps = Taps()
        self._publishing = Publishing(
            dictionary, node, interval, self._limits, chain, self._input, self._choose_sync_hooks
        )
        self._sampling = Sampling(
            dictionary,
            node,
            judge,
            interval,
            self._limits,
            chain,
            self._input,
            self._source,
            self._taps,
            self._publishing,
        )
        cycles_per_revolution = dictionary.entry(*od.ENCODER_CYCLES_PER_REVOLUTION)
        cycles_per_revolution.on_written = self._encoder_changed
        self._jitter = JitterWatch(judge.clock, interval, self._limits, cycles_per_revolution, self._warn)
        judge.on_followed = self._on_followed
        self._recorder = Recorder(dictionary, interval, self._taps)

    def _make_commands(self) -> None:
        """What SDO starts or reads, beside the feedback: tables, calibration, timers."""
        dictionary, storage = self.dictionary, self.node.storage
        self._tables = TableStore(dictionary, self.chain, storage)
        self._tables.on_in_force = self._on_correction
        self._adapting = Adapting(dictionary, self.chain, self._limits, storage)
        self._operating_time = OperatingTime(dictionary, storage, lambda: self.node.now)
        CyclicTimer(dictionary, storage)
        self._calibrating = Calibrating(
            dictionary, self.chain, self._tables, self._taps, self._publishing.objects.calibrating
        )

    def _listen_to_node(self) -> None:
        node, pairing = self.node, self._sampling.pairing
        self._choose_rpdo_hook()
        node.accepts_sync, node.on_idle_sync = pairing.accepts_sync, pairing.on_idle_sync
        self._choose_sync_hooks()
        node.on_state = self._on_state
        node.on_reset = self._on_reset
        node.on_bad_rpdo = self._on_bad_rpdo
        node.on_configured = self._on_configured
        node.on_parameter_faults = self._on_parameter_faults
        node.on_emergency = self.events.emergency
        node.on_saved, node.on_save_failed = self.events.saved, self.events.save_failed

    @property
    def feedback(self) -> Feedback | None:
        """Every stage of the last sample, None before the first one."""
        return self._publishing.last

    @property
    def on_feedback(self) -> Callable[[Feedback, float], None] | None:
        """Called as (feedback, now) with each feedback, once its PDOs are out; also for missed samples."""
        return self._publishing.on_feedback

    @on_feedback.setter
    def on_feedback(self, listener: Callable[[Feedback, float], None] | None) -> None:
        self._publishing.on_feedback = listener

    @property
    def limits(self) -> ChainLimits:
        """What samples are held against; the same object until a limit changes."""
        return self._limits.in_force

    @property
    def interval_s(self) -> float:
        """The sampling interval, seconds: 1006h, else the estimate, by the samples in it; 0.0: not known."""
        return self._interval.sample_s

    @property
    def max_speed_rad_s(self) -> float:
        """What the SYNC jitter measured so far allows, rad/s; inf with sample times and if not known."""
        return inf if self._sampling.pairing.timed else self._jitter.max_speed_rad_s

    def use_correction(self, correction: Correction) -> None:
        """Put the table and conditioning of ``correction`` in force between two samples, until a reset."""
        self._tables.take_over(correction)

    @property
    def state(self) -> NmtState:
        """The NMT state."""
        return self.node.state

    def speed_limit(self) -> str:
        """One line: how fast the machine may turn for a jitter of SYNC; empty with sample times or a source.

        By the parameters as they stand; 4 v jitter < residual limit (docs/time.md).
        """
        config = self.config
        return "" if config.times or config.source is not None else self._jitter.in_words()

    def start(self, now: float) -> list[Frame]:
        """Power-on at ``now``: the boot-up frame."""
        return self.node.start(now)

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        """Take a frame from the bus; the frames to send.

        ``frame.timestamp`` is when it was received, if the bus says it, and ``now`` is no earlier. A
        late caller first gives all the frames that wait, in their order, and then calls :meth:`tick`.
        """
        until = self._judge.until
        if now > until and (frame.timestamp is None or frame.timestamp > until):
            self._publishing.withhold()
        return self.node.receive(frame, now)

    def tick(self, now: float) -> list[Frame]:
        """Do what is due at ``now``; the frames to send."""
        if now >= self._judge.until:
            self.events.overdue(self._judge.synced_s, now)
            self._sampling.overdue(now)
        return self.node.tick(now)

    def deadline(self) -> float | None:
        """When :meth:`tick` is to be called next, None for not at all."""
        due, until = self.node.deadline(), self._judge.until
        if until == NEVER:
            return due
        return until if due is None or until < due else due

    def can_ids(self) -> CanIds:
        """The CAN-IDs that it listens to: a host need not give it other frames."""
        return self.node.can_ids()

    def follow_can_ids(self, moved: Callable[[], None]) -> None:
        """Have ``moved`` called in each call after which :meth:`can_ids` may give others."""
        self.node.follow_can_ids(moved)

    def sent(self, can_id: int, now: float) -> None:
        """A frame with this CAN-ID has left at ``now``: inhibit times count from there."""
        self.node.sent(can_id, now)

    def end(self, now: float) -> None:
        """The program ends at ``now``: the operating time is stored."""
        self._operating_time.keep(now)

    def bus_off(self, now: float) -> list[Frame]:
        """The bus is lost at ``now``: the reaction of 1029h; the frames to send, if any.

        A module that stays in OPERATIONAL has lost its position: no SYNCs are counted meanwhile.
        """
        frames = self.node.bus_off(now)
        if self.state is NmtState.OPERATIONAL:
            self._sampling.uncounted(now)
        return frames

    def bus_back(self, now: float) -> list[Frame]:
        """The bus is back at ``now``: EMCY 8140h."""
        return self.node.bus_back(now)

    def pending_job(self) -> CalibrationJob | None:
        """A pending computation of several seconds, or None.

        The module continues meanwhile. Poll this: another job, or None, means that the previous one
        is obsolete. Call the job, in another process if frames must not wait, and pass its result,
        or the Exception that it raised, to :meth:`finish_job`.
        """
        return self._calibrating.pending_job

    def finish_job(self, job: CalibrationJob, result: Outcome | Exception, now: float) -> list[Frame]:
        """Take the ``result`` of a ``job`` at ``now``; the frames to send.

        Nothing happens if the job is obsolete. An Exception refuses the measurement.
        """
        self._calibrating.finish(job, result)
        return []

    def job_progress(self, job: CalibrationJob, part: float) -> None:
        """The fraction ``part``, 0..1, of the ``job`` is done: for 2030:03."""
        self._calibrating.computed(job, part)

    def _choose_parameters(self) -> None:
        """What `save` keeps beside the entries that it keeps anyway, and what is not a parameter."""
        entries = self.node.storage.entries
        for preset in (od.PRESET_VALUE, od.HIGH_PRECISION_PRESET):
            entries.keep(*preset)  # its value alone: 6509h is what it led to
        entries.keep(*od.OFFSET_VALUE)
        for entry in self.dictionary:
            if entry.index in COMMANDS and entry.access == "rw":
                entries.leave_out(entry.index, entry.subindex)

    def _on_sync_predicting(self, counter: int | None, now: float) -> None:
        pairing = self._sampling.pairing
        extra = pairing.extra
        pairing.on_sync(counter, now)
        if extra:  # no sample belongs to it, and so none is extrapolated to it
            self._publishing.withhold()
        else:
            self._publishing.extrapolate()

    def _choose_sync_hooks(self) -> None:
        """With or without prediction (2013h). The sample of a source belongs to this very SYNC."""
        prediction = self._publishing.prediction
        wanted = prediction.wanted and self._source is None
        prediction.forget()
        self.node.on_sync = self._on_sync_predicting if wanted else self._sampling.pairing.on_sync
        self.node.on_synchronised = prediction.withdraw if wanted else None

    def _choose_rpdo_hook(self) -> None:
        """With or without a second position. Samples of a source come by no RPDO."""
        pairing, second = self._sampling.pairing, self._second
        usual = pairing.on_rpdo if self._source is None else None
        wanted = self._on_rpdo_with_second if second.mapped else usual
        if self.node.on_rpdo != wanted:
            self.node.on_rpdo = wanted
        pairing.on_interval = second.interval_over if second.mapped else None

    def _on_rpdo_with_second(self, number: int, now: float) -> None:
        self._second.on_rpdo(number)
        if self._source is None:
            self._sampling.pairing.on_rpdo(number, now)

    def _on_followed(self, now: float, proved: bool) -> None:
        """SYNCs come as expected, which is an event after a pause, and measures their jitter.

        Sample times know each interval; a time of the call is not that of the SYNC.
        """
        self.events.synced(self._judge.clock.period_s, now)
        last = self._publishing.last
        if proved and last is not None and not self._sampling.pairing.timed:
            self._jitter.look(last, now)

    def _warn(self, text: str) -> None:
        if self.on_warning is not None:
            self.on_warning(text)

    def _tell_of_source(self, text: str) -> None:
        if self.on_source is not None:
            self.on_source(text)

    def _on_state(self, old: NmtState, new: NmtState, now: float) -> None:
        self.events.nmt(old, new, now, self.node.state_reason)
        if new is NmtState.OPERATIONAL:
            self._sampling.resume(now)
        elif old is NmtState.OPERATIONAL:
            self._sampling.pause(now)
            self._recorder.stop()
            self._calibrating.interrupted()
            self._operating_time.keep(now)

    def _on_correction(self, correction: Correction) -> None:
        """Another table and conditioning are in force."""
        self.events.table(correction, self.node.moment.now)
        self._limits.noise_changes()

    def _encoder_changed(self) -> None:
        """2001:01 was written: every cycle is another part of a revolution."""
        self._publishing.profile.rescale()
        self._limits.apply()

    def _on_reset(self, communication_only: bool, now: float) -> None:
        self._operating_time.begin(now)
        self._lock.reset()
        self._publishing.reset_alarms()
        self._sampling.forget_interval()
        if communication_only:
            return
        self.chain.reset()
        self._publishing.reset()
        self._choose_sync_hooks()
        self._limits.reset()
        self._second.apply()
        self._tables.reset()
        self._adapting.reset()
        self._recorder.reset()
        self._calibrating.reset()

    def _on_parameter_faults(self, faults: Mapping[ParameterGroup, str], now: float) -> None:
        self._publishing.profile.alarm_parameters(bool(faults))
        if faults:
            self.node.emergency(EmergencyCode.DATA_SET, REGISTER, bytes(sorted(faults))[:5], now)
        else:
            self.node.clear_emergency(EmergencyCode.DATA_SET, now)
        if self.on_parameter_faults is not None:
            self.on_parameter_faults(faults)

    def _on_configured(self) -> None:
        """A sample comes in whichever RPDOs carry its parts; some TPDOs go out with it."""
        self._input.configure()
        source, timed = self._source, self._sampling.pairing.timed
        per_sync = self._input.samples_per_sync if source is None else source.samples_per_sync
        self._sampling.configured(per_sync, timed or (source is not None and per_sync > 1))
        self._second.configure()
        self._choose_rpdo_hook()
        self._publishing.configured()

    def _on_bad_rpdo(self, number: int, received: int, mapped: int, now: float) -> None:
        self._sampling.pairing.count_bad_frame()


def _check(config: ModuleConfig, source: Source | None) -> None:
    if not isinstance(config, ModuleConfig):
        raise TypeError(
            f"config must be a ModuleConfig, not {type(config).__name__}: "
            "take one of load_config(path).modules, or canfb.ModuleConfig(node_id=32)"
        )
    if config.source is not None and source is None:
        raise ValueError(f"config.source is {config.source.kind!r}: open it, and pass it as source=")
