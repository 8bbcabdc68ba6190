"""The drive feedback module: a CANopen device, sans-I/O."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from math import inf

from canfb import objects as od
from canfb.cia301.codes import NmtState
from canfb.cia301.frame import Frame
from canfb.device.node import NodeDevice
from canfb.device.od.dictionary import Entry
from canfb.device.storage.kept import ParameterGroup
from canfb.device.storage.storage import Store
from canfb.module.cia406.alarms import REGISTER
from canfb.module.cia406.profile import ALARM_PARAMETERS, ALARM_POSITION, OperatingTime, make_cyclic_timer
from canfb.module.events import EventWatch
from canfb.module.interval import InterfaceGrid, SamplingInterval
from canfb.module.jitter_watch import JitterWatch
from canfb.module.module_config import ModuleConfig
from canfb.module.objects.calibrating import Calibrating, CalibrationJob, Outcome
from canfb.module.objects.recorder import Recorder, SampleObservers
from canfb.module.objects.sample_input import NO_RPDO, LocalSource, SampleInput, SecondInput
from canfb.module.objects.table_store import Adapting, TableStore
from canfb.module.objects.write_lock import WriteLock
from canfb.module.pairing import Pairing
from canfb.module.parameters import Limits, factory_dictionary
from canfb.module.publishing import Publishing
from canfb.module.sampling import Sampling
from canfb.signal.chain import SignalChain
from canfb.signal.chain_config import ChainConfig, ChainLimits
from canfb.signal.correction import Correction
from canfb.signal.sample import TICK_S, Feedback
from canfb.sources.protocol import Source
from canfb.timing.answers import Answers
from canfb.timing.syncs import Syncs


class FeedbackModule(NodeDevice):
    """ADC sine/cosine PDOs, or the samples of a ``source``, in; a supervised position PDO out.

    Time goes in as ``now`` (seconds, monotonic), frames come out; see
    :class:`canfb.device.node.Node` for start, receive, tick and deadline. A frame never
    raises, for any content.

    ``store`` holds what 1010h and LSS save; without one nothing is saved. ``bit_rates_kbit_s`` are
    those that LSS may choose; see ``on_bit_rate``.

    A ``source`` provides the sample of each SYNC in OPERATIONAL at that SYNC; RPDO1 is then off.
    ``on_source`` is called with one line when it fails, works again or has ended; ``on_warning``
    when the speed approaches the limit set by the SYNC jitter; ``events`` reports each :class:`.Event`.
    ValueError if ``config.source`` names a source and none is given; TypeError for a
    ``config`` that is not a :class:`canfb.ModuleConfig`.
    """

    register_bits = REGISTER

    def __init__(
        self,
        config: ModuleConfig,
        store: Store | None = None,
        *,
        source: Source | None = None,
        bit_rates_kbit_s: Collection[int] = (),
    ) -> None:
        _check(config, source)
        self._syncs = Syncs()
        super().__init__(
            factory_dictionary(config, samples_itself=source is not None),
            config.node_id,
            autostart=config.autostart,
            store=store,
            bit_rates_kbit_s=bit_rates_kbit_s,
            expiry=self._syncs,
        )
        self.config = config
        self.chain = SignalChain(ChainConfig())  # limits and correction are those of the dictionary
        self.on_source: Callable[[str], None] = lambda text: None
        self.on_warning: Callable[[str], None] = lambda text: None
        self._make_chain_around(source)
        self._make_commands()
        self._resets = (  # in this order
            self.chain.reset,
            self._publishing.reset,
            self._limits.reset,
            self._second.apply,
            self._tables.reset,
            self._adapting.reset,
            self._recorder.reset,
            self._calibrating.reset,
        )
        self._lock = WriteLock(self)
        self._limits.reset()  # alarms and restored values need them before the first start

    @property
    def events(self) -> EventWatch:
        """Set its ``on_event``, and ``detailed`` for single faults."""
        return self._publishing.events

    def _make_chain_around(self, source: Source | None) -> None:
        dictionary, chain, syncs = self.dictionary, self.chain, self._syncs
        self._interval = interval = SamplingInterval(dictionary.entry(*od.CYCLE_PERIOD), syncs)
        self._limits = Limits(dictionary, chain, interval)
        self._input = SampleInput(dictionary, self)
        self._second = SecondInput(dictionary, self, chain)
        self._source = (
            None if source is None else LocalSource(source, self._input, lambda text: self.on_source(text))
        )
        self._observers = SampleObservers()
        self._publishing = Publishing(dictionary, self, interval, self._limits, chain, self._input)
        self.observer = self.events
        grid = InterfaceGrid(chain, interval)
        self._core.process = self._pairing = Pairing(
            dictionary,
            self,
            syncs,
            Answers(),
            interval,
            grid,
            self._limits,
            chain,
            self._input,
            self._source,
            self._second,
            self._observers,
            self._publishing,
        )
        self._sampling = Sampling(syncs, interval, grid, self._limits, chain, self._pairing, self._publishing)
        cycles_per_revolution = dictionary.entry(*od.ENCODER_CYCLES_PER_REVOLUTION)
        cycles_per_revolution.on_written = self._encoder_changed
        self._jitter = JitterWatch(
            syncs, interval, self._limits, cycles_per_revolution, lambda text: self.on_warning(text)
        )
        syncs.on_followed = self._on_followed
        self._sync_jitter = dictionary.entry(*od.SUPERVISION_SYNC_JITTER)
        self._periods = dictionary.entry(*od.SUPERVISION_PERIODS)
        self._sync_jitter.on_written = self._periods.on_written = self._declare_jitter
        self._recorder = Recorder(dictionary, interval, self._observers)

    def _make_commands(self) -> None:
        dictionary, storage = self.dictionary, self.storage
        self._tables = TableStore(dictionary, self.chain, storage, self._on_correction)
        self._adapting = Adapting(dictionary, self.chain, self._limits, storage)
        self._operating_time = OperatingTime(dictionary, storage, lambda: self.now)
        make_cyclic_timer(dictionary, storage)
        self._calibrating = Calibrating(
            dictionary, self.chain, self._tables, self._observers, self._publishing.objects.calibrating
        )
        for kept in (od.PRESET_VALUE, od.HIGH_PRECISION_PRESET, od.OFFSET_VALUE):
            storage.entries.keep(*kept)  # without the write hook of a preset: 6509h is its result
        storage.entries.save_as(  # below the lowest, as after a new full scale, a start would refuse it
            *od.ENCODER_HIGHEST_AMPLITUDE,
            lambda: max(
                dictionary.entry(*od.ENCODER_HIGHEST_AMPLITUDE).value,
                dictionary.entry(*od.ENCODER_LOWEST_AMPLITUDE).value + 1,
            ),
        )
        for command in (od.MEASUREMENT_COMMAND, od.MEASUREMENT_SAMPLES, od.RECORDING_COMMAND):
            storage.entries.leave_out(*command)

    @property
    def feedback(self) -> Feedback | None:
        """Every stage of the last sample; None before the first."""
        return self._publishing.last

    @property
    def on_feedback(self) -> Callable[[Feedback, float], None] | None:
        """Called as (feedback, now) with each feedback, also for missed samples, before its PDOs are sent."""
        return self._publishing.on_feedback

    @on_feedback.setter
    def on_feedback(self, listener: Callable[[Feedback, float], None] | None) -> None:
        self._publishing.on_feedback = listener

    @property
    def limits(self) -> ChainLimits:
        """The limits in force; the same object until a limit changes."""
        return self._limits.in_force

    @property
    def interval_s(self) -> float:
        """The sampling interval: measured, before that 1006h; 0.0: not known."""
        return self._interval.sample_s

    @property
    def max_speed_rad_s(self) -> float:
        """The largest speed for the measured SYNC jitter, rad/s; inf with sample times and if not known."""
        return inf if self._pairing.timed else self._jitter.max_speed_rad_s

    def use_correction(self, correction: Correction) -> None:
        """Put ``correction`` in force between two samples, until a reset."""
        self._tables.take_over(correction)

    def speed_limit(self) -> str:
        """One line: the largest speed for a given jitter of SYNC, by 4 v jitter < residual limit.

        Empty with sample times, several samples for each SYNC, or a source.
        """
        config = self.config
        return "" if config.times or config.source or config.samples_per_sync > 1 else self._jitter.in_words()

    def end(self, now: float) -> None:
        """Store the operating time: the program ends."""
        self._operating_time.keep(now)

    def bus_off(self, now: float) -> list[Frame]:
        """The reaction of 1029h; the frames to send, if any.

        A module that stays in OPERATIONAL has lost its position.
        """
        frames = super().bus_off(now)
        if self.state is NmtState.OPERATIONAL:
            self.expired(now)
            self._sampling.uncounted(now)
        return frames

    def pending_job(self) -> CalibrationJob | None:
        """A pending computation of several seconds, or None; to be polled: a new job makes the last obsolete.

        Call the job, in another process if frames must not wait, and pass its result, or the Exception that
        it raised, to :meth:`finish_job`.
        """
        return self._calibrating.job

    def finish_job(self, job: CalibrationJob, result: Outcome | Exception, now: float) -> list[Frame]:
        """Take the ``result`` of a ``job``; returns the frames to send.

        No effect if the job is obsolete. An Exception refuses the measurement.
        """
        self._calibrating.finish(job, result)
        return []

    def job_progress(self, job: CalibrationJob, part: float) -> None:
        """Set the fraction ``part``, 0..1, of the ``job`` that is done, for 2030:03."""
        self._calibrating.computed(job, part)

    def _on_followed(self, received_s: float, stamped: bool) -> None:
        """Report SYNC found; check the speed against its jitter with receive times but no sample times."""
        self._limits.follow()
        self.events.synced(self._syncs.grid.period, received_s)
        last = self._publishing.last
        if stamped and last is not None and not self._pairing.timed:
            self._jitter.look(last, received_s)

    def _on_correction(self, correction: Correction) -> None:
        self.events.table(correction, self.call.now)
        self._limits.noise_changes()

    def _declare_jitter(self) -> None:
        self._syncs.declare(self._sync_jitter.value, self._periods.value)
        self.chain.sample_grid.declare(self._sync_jitter.value / TICK_S)

    def _encoder_changed(self) -> None:
        self._publishing.profile.rescale()
        self._limits.apply()

    # Application: called by the node.

    def expired(self, now: float) -> None:
        """No SYNC for 2010:06 periods: the position in objects and in PDOs on request is not valid."""
        self._publishing.withhold()
        self._life.services.pdos.forget_sampled()

    def overdue(self, now: float) -> None:
        """No SYNC and no sample for 2010:06 periods."""
        self.events.sync_lost(self._syncs.synced_s, now)
        self._life.services.pdos.forget_sampled()
        self._sampling.overdue(now)

    def check_write(self, entry: Entry | None) -> None:
        """The write lock (2040h); ``entry`` None: for LSS."""
        self._lock.check_write(entry)

    def state_changed(self, old: NmtState, new: NmtState, now: float, why: str) -> None:
        """The state changed from ``old`` to ``new``, and ``why``: sampling needs OPERATIONAL."""
        super().state_changed(old, new, now, why)
        if new is NmtState.OPERATIONAL:
            self._sampling.resume(now)
        elif old is NmtState.OPERATIONAL:
            self._pause(now)
            self._operating_time.keep(now)

    def _pause(self, now: float) -> None:
        self.expired(now)
        self._sampling.pause(now)
        self._recorder.stop()
        self._calibrating.interrupted()

    def reset_done(self, communication_only: bool, now: float) -> None:
        """The position is forgotten unless ``communication_only``."""
        self._operating_time.begin(now)
        self._lock.reset()
        self._publishing.alarm.reset()
        self._publishing.warnings.reset()
        self._sampling.forget_interval()
        self._declare_jitter()
        if not communication_only:
            for reset in self._resets:
                reset()
        elif self._publishing.profile.alarms.value & ALARM_POSITION:
            self._publishing.outdated(now)  # an error that persists is reported again

    def parameters_refused(self, faults: Mapping[ParameterGroup, str], now: float) -> None:
        """Bit 12 of 6503h while there are ``faults``, and EMCY 6310h."""
        self._publishing.profile.alarm(ALARM_PARAMETERS, bool(faults))
        super().parameters_refused(faults, now)

    def configuration_changed(self) -> None:
        """PDO parameters or the NMT state have changed."""
        other_input = self._input.configure()
        self._pairing.usual = NO_RPDO
        source, timed = self._source, self._pairing.timed
        per_sync = self._input.samples_per_sync if source is None else source.samples_per_sync
        self._sampling.configured(per_sync, timed or (source is not None and per_sync > 1))
        self._second.configure()
        self._publishing.configured()
        if other_input and self._pairing.sampled and self.state is NmtState.OPERATIONAL:
            self._pause(self.now)
            self._sampling.resume(self.now)


def _check(config: ModuleConfig, source: Source | None) -> None:
    if not isinstance(config, ModuleConfig):
        raise TypeError(
            f"config must be a ModuleConfig, not {type(config).__name__}: "
            "take one of load_config(path).modules, or canfb.ModuleConfig(node_id=32)"
        )
    if config.source is not None and source is None:
        raise ValueError(f"config.source is {config.source.kind!r}: open it, and pass it as source=")
