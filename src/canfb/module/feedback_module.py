"""The drive feedback module: a CANopen device, sans-I/O."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping

from canfb.device.cob import is_valid
from canfb.device.codes import EmergencyCode, ErrorRegister
from canfb.device.dictionary import Dictionary, Entry
from canfb.device.frame import NEVER, Frame
from canfb.device.image import ParameterGroup
from canfb.device.nmt import NmtState
from canfb.device.node import Node
from canfb.device.pdo import EVENT_DRIVEN
from canfb.device.storage import Store
from canfb.eds_files import eds_path
from canfb.module.calibrating import Calibrating
from canfb.module.calibration_job import CalibrationJob, Outcome
from canfb.module.config import ModuleConfig
from canfb.module.cyclic_timer import CyclicTimer
from canfb.module.interval import IntervalEstimate
from canfb.module.local_source import LocalSource
from canfb.module.operating_time import OperatingTime
from canfb.module.parameters import Limits, apply_defaults, configured_defaults, without_adc_pdo
from canfb.module.prediction import Prediction
from canfb.module.profile import EncoderProfile
from canfb.module.profile_warnings import Warnings
from canfb.module.publication import Publication
from canfb.module.recorder import Recorder
from canfb.module.sample_input import SampleInput
from canfb.module.table_store import TableStore
from canfb.module.tap import Taps
from canfb.module.timeline import ON_TIME, Timeline, Verdict
from canfb.signal.chain import Feedback, SignalChain
from canfb.signal.sample import Sample
from canfb.signal.sample_times import TICK_S, TICKS
from canfb.signal.source import Source
from canfb.signal.supervision import COASTING, VALID

EDS = "canfb-module"
POSITION_REGISTER = ErrorRegister.GENERIC | ErrorRegister.DEVICE_PROFILE
BAD_FRAMES, DUPLICATE_SYNCS, UNHEARD_SYNCS = 8, 13, 14  # 2012h
MOST_MISSED = 256  # in a row, one by one: more than 2010:03 can bridge
SAME_INTERVAL = 0.02
CONFIRMING_SAMPLES = 4  # after a pause in which the machine may have begun to move
SHORTEST_ALARMS_S = 0.1  # from one end of EMCY 7300h to the next: ten pairs a second at most
COMMANDS = (0x2030, 0x2050)  # calibration and recording
TPDOS = (1, 2, 3, 4)
ON_EVENT = EVENT_DRIVEN | {0}  # transmission types; 0 goes out at the SYNC after the event


class FeedbackModule:
    """ADC sine/cosine PDOs, or the samples of a ``source``, in; a supervised position PDO out.

    Time goes in as ``now`` (seconds, monotonic), frames come out; see
    :class:`canfb.device.node.Node` for start, receive, tick and deadline. A frame never
    raises, whatever it holds.

    ``store`` keeps what 1010h and LSS save; without one nothing is saved. ``on_parameter_faults``
    is called with the groups of stored parameters that were refused, and why. ``bit_rates_kbit_s``
    are those that LSS may choose; see ``on_bit_rate`` of the node.

    A ``source`` is asked at each SYNC in OPERATIONAL for the sample of that very SYNC; RPDO1 is off
    then. ``on_source`` is called with one line when it fails, works again or has ended. ValueError
    where ``config.source`` speaks of a source and none is given; TypeError for a ``config`` that is
    no :class:`canfb.ModuleConfig`.
    """

    def __init__(
        self,
        config: ModuleConfig,
        store: Store | None = None,
        *,
        source: Source | None = None,
        bit_rates_kbit_s: Collection[int] = (),
    ) -> None:
        if not isinstance(config, ModuleConfig):
            raise TypeError(
                f"config must be a ModuleConfig, not {type(config).__name__}: "
                "take one of load_config(path).modules, or canfb.ModuleConfig(node_id=32)"
            )
        if config.source is not None and source is None:
            raise ValueError(f"config.source is {config.source.kind!r}: open it, and give it as source=")
        self.config = config
        self.dictionary = Dictionary.load(eds_path(EDS), config.node_id)
        apply_defaults(self.dictionary, configured_defaults(config))
        if source is not None:
            apply_defaults(self.dictionary, without_adc_pdo(config))
        self.chain = SignalChain(config)
        self.node = Node(
            self.dictionary,
            config.node_id,
            autostart=config.autostart,
            store=store,
            bit_rates_kbit_s=bit_rates_kbit_s,
        )
        self.on_parameter_faults: Callable[[Mapping[ParameterGroup, str]], None] | None = None
        self.on_source: Callable[[str], None] | None = None
        self._interval = IntervalEstimate(self.dictionary.entry(0x1006))
        self._limits = Limits(self.dictionary, self.chain, self._interval)
        self._tables = TableStore(self.dictionary, self.chain, self.node.storage)
        self._input = SampleInput(self.dictionary, self.node)
        self._operating_time = OperatingTime(self.dictionary, self.node.storage, lambda: self.node.now)
        self._source: LocalSource | None = None
        if source is not None:
            self._source = LocalSource(source, self.dictionary, self._input, self._tell_of_source)
        self._profile = EncoderProfile(self.dictionary, self._interval)
        self._warnings = Warnings(
            self.dictionary,
            self.node,
            lambda: self._feedback,
            lambda: self._input.expects_pulse,
            lambda: self._limits.residual_limit_cycles,
        )
        self._limits.on_applied = self._warnings.limits_changed
        CyclicTimer(self.dictionary, self.node.storage)
        self._prediction = Prediction(self.dictionary, self._profile, self._choose_prediction)
        self._publication = Publication(self.dictionary, self._interval, self.chain, self._input)
        self._taps = Taps()
        self._recorder = Recorder(self.dictionary, self._interval, self._taps)
        self._calibrating = Calibrating(
            self.dictionary, self.chain, self._tables, self._taps, self._publication.calibrating
        )
        self._bad_frames = self.dictionary.entry(0x2012, BAD_FRAMES)
        self._feedback: Feedback | None = None
        self._timeline = Timeline(self.dictionary, self._interval)
        self._duplicate_syncs = self.dictionary.entry(0x2012, DUPLICATE_SYNCS)
        self._unheard_syncs = self.dictionary.entry(0x2012, UNHEARD_SYNCS)
        self._event_tpdos: list[int] = []
        self._alarmed = False
        self._cleared_s = -NEVER
        self._paused_s = 0.0
        self._unconfirmed = 0  # samples after a pause that are not called valid yet
        self._listen()
        self.node.on_rpdo = self._on_rpdo if self._source is None else None
        self._choose_prediction()
        self.node.accepts_sync = self._accepts_sync
        self.node.on_state = self._on_state
        self.node.on_reset = self._on_reset
        self.node.on_bad_rpdo = self._on_bad_rpdo
        self.node.on_configured = self._on_configured
        self.node.on_parameter_faults = self._on_parameter_faults
        self._choose_parameters()
        self.dictionary.entry(0x2001, 1).on_written = self._encoder_changed
        self._limits.apply()

    @property
    def feedback(self) -> Feedback | None:
        """Every stage of the last sample, None before the first one."""
        return self._feedback

    @property
    def state(self) -> NmtState:
        """The NMT state."""
        return self.node.state

    def start(self, now: float) -> list[Frame]:
        """Power-on at ``now``: the boot-up frame."""
        return self.node.start(now)

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        """Take a frame from the bus; the frames to send.

        ``frame.timestamp`` is when it was received, if the bus says it, and ``now`` is no earlier. A
        late caller first gives all the frames that wait, in their order, and then calls :meth:`tick`.
        """
        if now > self._timeline.until and (frame.timestamp is None or frame.timestamp > self._timeline.until):
            self._publication.withhold()
        return self.node.receive(frame, now)

    def tick(self, now: float) -> list[Frame]:
        """Do what is due at ``now``; the frames to send."""
        if now >= self._timeline.until:
            self._overdue(now)
        return self.node.tick(now)

    def deadline(self) -> float | None:
        """When :meth:`tick` is to be called next, None for not at all."""
        due, until = self.node.deadline(), self._timeline.until
        if until == NEVER:
            return due
        return until if due is None or until < due else due

    def sent(self, can_id: int, now: float) -> None:
        """A frame with this CAN-ID has left at ``now``: inhibit times count from there."""
        self.node.sent(can_id, now)

    def end(self, now: float) -> None:
        """The program ends at ``now``: the operating time is kept."""
        self._operating_time.keep(now)

    def bus_off(self, now: float) -> list[Frame]:
        """The bus is gone at ``now``, as 1029h has it; the frames to send, if any.

        A module that stays in OPERATIONAL has lost its position: nobody counts the SYNCs meanwhile.
        """
        frames = self.node.bus_off(now)
        if self.state is NmtState.OPERATIONAL and self._sampled:
            self._publish(self.chain.lose(), now, send=False)
            self._listen()
        return frames

    def bus_back(self, now: float) -> list[Frame]:
        """The bus is back at ``now``: EMCY 8140h."""
        return self.node.bus_back(now)

    def pending_job(self) -> CalibrationJob | None:
        """What takes seconds to compute and waits to be done, None for nothing.

        The module goes on meanwhile. Ask again and again: another job, or None, says that the one
        before is not wanted any more. Call the job, in another process where frames must not wait,
        and give what it returns, or the Exception that it raised, to :meth:`finish_job`.
        """
        return self._calibrating.pending_job

    def finish_job(self, job: CalibrationJob, result: Outcome | Exception, now: float) -> list[Frame]:
        """Take the ``result`` of a ``job`` at ``now``; the frames to send.

        Nothing happens if the job is not wanted any more. An Exception refuses the measurement.
        """
        self._calibrating.finish(job, result)
        return []

    def job_progress(self, job: CalibrationJob, part: float) -> None:
        """So much of the ``job``, ``part`` 0..1, is done: for 2030:03."""
        self._calibrating.computed(job, part)

    def _choose_parameters(self) -> None:
        """What `save` keeps beside the entries that it keeps anyway, and what is no parameter."""
        entries = self.node.storage.entries
        for preset in (0x6003, 0x6009):
            entries.keep(preset)  # without the preset that a write of it would set
        entries.keep(0x6509)
        for entry in self.dictionary:
            if entry.index in COMMANDS and entry.access == "rw":
                entries.leave_out(entry.index, entry.subindex)

    def _listen(self) -> None:
        """Wait for the first sample, and for the first SYNC."""
        self._sample_came = False  # since the last SYNC
        self._tracks_came = False  # since the last SYNC, with the rest of the sample or without
        self._synced = False  # a SYNC came since OPERATIONAL
        self._sampled = False  # a sample came since OPERATIONAL
        self._extra_syncs = False  # a duplicate came since the last SYNC: the interface may answer it
        self._stale = False  # what synchronous RPDOs hold is of an interval that nobody knows
        self._unheard = 0  # SYNCs before this one
        self._last_time: int | None = None  # of the last valid sample, 2000:05
        self._timeline.pause()

    def _on_rpdo(self, number: int, now: float) -> None:
        source = self._input
        if self._stale or (number == source.judged and not self._belongs_here(now)):
            return
        if source.take(number):
            self._sampled = True
            if self._process(source.sample(), now):
                self._sample_came = True

    def _belongs_here(self, now: float) -> bool:
        """One pair of tracks for each SYNC: does this one answer the last SYNC, or one not heard?"""
        moment, timeline = self.node.moment, self._timeline
        came = self._tracks_came
        if not self._synced:
            self._interval.event(moment.received)
            verdict = timeline.free_running(moment.received, moment.proved)
        elif came:
            verdict = timeline.another_sample(moment.received, moment.proved)
        else:
            verdict = timeline.first_sample(moment.received, moment.proved)
        self._tracks_came = True
        return verdict is ON_TIME or self._take_verdict(verdict, came, now)

    def _take_verdict(self, verdict: Verdict, came: bool, now: float) -> bool:
        """For tracks that are not on time. False: they are not to be used."""
        if verdict.unheard:
            if self._input.give_up():
                self._count(self._bad_frames)
            self._count(self._unheard_syncs, verdict.unheard)
            # SYNCs without a sample: these, but for the last, and the one before if it had none.
            open_intervals = 0 if self._sample_came or not self._synced else 1
            self._miss(verdict.unheard - 1 + open_intervals if self._synced else verdict.unheard, now)
            self._sample_came = False
            return True
        if not came:
            if verdict.duplicate:  # of an earlier SYNC: the answer to this one may still come
                self._count(self._bad_frames)
                self._tracks_came = False
            return not verdict.duplicate
        self._count(self._bad_frames)
        explained = self._extra_syncs or (verdict.duplicate and self._input.repeats(self.chain))
        if not explained:
            self._lose_count(1.0, now)
        return False

    def _lose_count(self, intervals: float, now: float) -> None:
        """So many intervals may or may not have passed: the position is lost if the machine moves."""
        feedback = self.chain.uncertain(intervals)
        if feedback is not None:
            self._publish(feedback, now)

    def _process(self, sample: Sample, now: float) -> bool:
        """A sample through the chain, and out; False if it is an earlier one, and nothing happened."""
        if self._limits.narrowed:
            self._limits.follow()
        timed = sample.time_100ns is not None
        if timed:
            self._follow_interval()
        feedback = self.chain.step(sample)
        if timed and self._feedback is not None and feedback.samples == self._feedback.samples:
            self._count(self._bad_frames)
            return False
        if feedback.status & VALID:
            if timed:
                self._clock_interval(sample)
            if self._unconfirmed or (self._timeline.withheld and not timed):
                feedback = self._withheld(feedback)
        self._publish(feedback, now)
        if self._taps.open:
            self._taps.take(sample, feedback)
        return True

    def _withheld(self, feedback: Feedback) -> Feedback:
        """What may be right, but is not confirmed."""
        if self._unconfirmed:
            self._unconfirmed -= 1
        return feedback._replace(status=feedback.status & ~VALID | COASTING)

    def _follow_interval(self) -> None:
        """Take the nominal interval along, by which sample times are judged."""
        seconds = self._interval.seconds
        if abs(seconds - self.chain.interval_s) > SAME_INTERVAL * seconds:
            self.chain.interval_s = seconds

    def _clock_interval(self, sample: Sample) -> None:
        """The clock of the interface is far more regular than the times at which SYNCs are heard."""
        last, self._last_time = self._last_time, sample.time_100ns
        if last is not None and self._last_time is not None and self._source is None:
            ticks = (self._last_time - last) % TICKS
            if ticks:
                self._interval.measured(ticks * TICK_S)

    def _accepts_sync(self, counter: int | None, now: float) -> bool:
        """Before anything is done with a SYNC: is it one, and were there others that nobody heard?"""
        moment = self.node.moment
        verdict = self._timeline.sync(moment.received, moment.proved, counter)
        if verdict.duplicate:
            self._count(self._duplicate_syncs)
            self._extra_syncs = True
            return False
        if self._input.is_ambiguous and not self._input.timed:
            self._count(self._bad_frames)
            self._stale = True
        if verdict is ON_TIME:
            return True
        self._unheard = verdict.unheard
        self._publication.withhold()
        self._stale |= self._input.is_synchronous
        if verdict.doubt:
            if self._input.timed:
                self._unheard = 0  # sample times know how long it was
            else:
                self._lose_count(max(1.0, verdict.unheard), now)
        return True

    def _on_sync(self, counter: int | None, now: float) -> None:
        if self._source is not None:
            self._sample_source(self._source, counter, now)
        else:
            if not self._input.timed:
                self._interval.event(self.node.moment.received)
            if self._input.give_up():
                self._count(self._bad_frames)
        if self._synced and self._sampled and not self._sample_came:
            self._miss(1, now)
        if self._unheard:
            self._miss_unheard(counter, self._input.timed, now)
        self._sample_came = self._tracks_came = self._extra_syncs = self._stale = False
        self._synced = True

    def _miss_unheard(self, counter: int | None, timed: bool, now: float) -> None:
        """SYNCs that were not heard. Sample times know better than receive times how long it was."""
        unheard, self._unheard = self._unheard, 0
        if self._sampled:
            self._count(self._unheard_syncs, unheard)
        if counter is not None or not timed:
            self._miss(unheard, now)

    def _miss(self, samples: int, now: float) -> None:
        """So many samples that did not come, reported once. Before the first one there is nothing to miss."""
        if not self._sampled:
            return
        self._timeline.after_gap = True
        known_as_lost = self.chain.lost
        # Of a position that is lost it makes no difference how long it has been.
        samples = min(samples, MOST_MISSED)
        for left in range(samples - 1, -1, -1):
            self._publish(self.chain.miss(), now, send=not left and not known_as_lost)
            self._taps.miss()

    def _overdue(self, now: float) -> None:
        """No SYNC and no sample for 2010:06 periods: what stands there is not the position any more."""
        passed = self._timeline.overdue(now)
        if not self._sampled or self.chain.lost:
            self._timeline.until = NEVER
        if not passed or not self._sampled:
            self._publication.withhold()
            if self._feedback is not None and not self._alarmed:
                self._report_alarm(True, self._feedback.status & ~VALID, now)
            return
        came = self._sample_came or self._source is not None
        self._miss(passed + (0 if came else 1), now)
        self._sample_came = True
        self._stale = self._input.is_synchronous
        if self.chain.lost:
            self._timeline.until = NEVER

    def _on_sync_predicting(self, counter: int | None, now: float) -> None:
        self._on_sync(counter, now)
        if self._feedback is not None:
            self._prediction.extrapolate(self._feedback)

    def _choose_prediction(self) -> None:
        """With or without it (2013h). The sample of a source belongs to this very SYNC."""
        wanted = self._prediction.wanted and self._source is None
        self._prediction.forget()
        self.node.on_sync = self._on_sync_predicting if wanted else self._on_sync
        self.node.on_synchronised = self._prediction.withdraw if wanted else None

    def _sample_source(self, source: LocalSource, counter: int | None, now: float) -> None:
        """The sample of this very SYNC; without one it is missed, from the first SYNC on."""
        if self._unheard:
            self._miss_unheard(counter, source.timed_s is not None, now)
        self._sampled = self._synced = True
        sample = source.next(now)
        if source.timed_s is None:
            self._interval.event(self.node.moment.received)
        if sample is not None:
            self._sample_came = True
            if source.timed_s is not None:  # far more regular than the time at which a SYNC is heard
                self._interval.event(source.timed_s)
            self._process(sample, now)

    def _tell_of_source(self, text: str) -> None:
        if self.on_source is not None:
            self.on_source(text)

    def _publish(self, feedback: Feedback, now: float, send: bool = True) -> None:
        """Into the dictionary, and out if there is something new to say."""
        self._feedback = feedback
        self._publication.publish(feedback)
        self._profile.publish(feedback)
        status, warnings = feedback.status, self._warnings
        if self._alarmed or not status & VALID:
            self._report_alarm(not status & VALID, status, now)
        if send:
            for number in self._event_tpdos:
                self.node.trigger_tpdo(number, now)
        if (
            status != warnings.status
            or feedback.residual > warnings.near_cycles
            or feedback.amplitude < warnings.reserve_counts
        ):
            warnings.follow(feedback, now)

    def _report_alarm(self, alarm: bool, status: int, now: float) -> None:
        """EMCY 7300h, and 0000h when the position is valid again, unless the last one was just before."""
        if alarm:
            self._alarmed = True
            detail = status.to_bytes(2, "little")
            self.node.emergency(EmergencyCode.SENSOR, POSITION_REGISTER, detail, now)
        elif now - self._cleared_s >= SHORTEST_ALARMS_S:
            self._alarmed = False
            self._cleared_s = now
            self.node.clear_emergency(EmergencyCode.SENSOR, now)

    def _on_state(self, old: NmtState, new: NmtState, now: float) -> None:
        if new is NmtState.OPERATIONAL:
            self._listen()
            self._resume(now)
        elif old is NmtState.OPERATIONAL:
            self._paused_s = self._timeline.synced_s if self._timeline.begun else now
            self._timeline.pause()
            self._recorder.stop()
            self._calibrating.interrupted()
            self._operating_time.keep(now)

    def _resume(self, now: float) -> None:
        """OPERATIONAL, for the first time or again: nobody has counted meanwhile."""
        interval_s = self._interval.settled_s or self._interval.seconds
        self._unconfirmed = CONFIRMING_SAMPLES if self.chain.begun and not self.chain.lost else 0
        self.chain.resume((now - self._paused_s) / interval_s if interval_s else NEVER)
        self._interval.pause()
        self._prediction.pause(self._feedback)
        self._publication.withhold()

    def _encoder_changed(self) -> None:
        """2001:01 was written: every cycle is another part of a revolution."""
        self._profile.rescale()
        self._limits.apply()

    def _on_reset(self, communication_only: bool, now: float) -> None:
        self._operating_time.begin(now)
        self._alarmed = False
        self._cleared_s = -NEVER
        self._warnings.reset()
        self._interval.reset()
        if communication_only:
            return
        self.chain.restart()
        self._feedback = None
        self._choose_prediction()
        self._limits.reset()
        self._tables.reset()
        self._profile.reset()
        self._publication.reset()
        self._recorder.reset()
        self._calibrating.reset()

    def _on_parameter_faults(self, faults: Mapping[ParameterGroup, str], now: float) -> None:
        self._profile.alarm_parameters(bool(faults))
        if faults:
            self.node.emergency(EmergencyCode.DATA_SET, POSITION_REGISTER, bytes(sorted(faults))[:5], now)
        else:
            self.node.clear_emergency(EmergencyCode.DATA_SET, now)
        if self.on_parameter_faults is not None:
            self.on_parameter_faults(faults)

    def _on_configured(self) -> None:
        """A sample comes in whichever RPDOs carry its parts; some TPDOs go out with it."""
        self._input.configure()
        self._warnings.look_again()
        self._event_tpdos = [number for number in TPDOS if self._is_event_tpdo(number)]

    def _is_event_tpdo(self, number: int) -> bool:
        cob_id, kind = (self.dictionary.entry(0x1800 + number - 1, subindex).value for subindex in (1, 2))
        return is_valid(cob_id) and kind in ON_EVENT

    def _on_bad_rpdo(self, number: int, received: int, mapped: int, now: float) -> None:
        self._count(self._bad_frames)

    @staticmethod
    def _count(counter: Entry, events: int = 1) -> None:
        counter.value = (counter.value + events) & 0xFFFFFFFF
