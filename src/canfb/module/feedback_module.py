"""The drive feedback module: a CANopen device, sans-I/O."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping

from canfb import objects as od
from canfb.cia301.cob import is_valid
from canfb.cia301.codes import EmergencyCode
from canfb.cia301.frame import Frame
from canfb.cia301.nmt import NmtState
from canfb.device.dictionary import Dictionary
from canfb.device.image import ParameterGroup
from canfb.device.moment import NEVER
from canfb.device.node import Node
from canfb.device.pdo import EVENT_DRIVEN
from canfb.device.storage import Store
from canfb.eds_files import eds_path
from canfb.module.calibrating import Calibrating
from canfb.module.calibration_job import CalibrationJob, Outcome
from canfb.module.config import ModuleConfig
from canfb.module.cyclic_timer import CyclicTimer
from canfb.module.interval import IntervalEstimate
from canfb.module.jitter_watch import JitterWatch
from canfb.module.local_source import LocalSource
from canfb.module.operating_time import OperatingTime
from canfb.module.pairing import Findings, Pairing
from canfb.module.parameters import Limits, apply_defaults, configured_defaults, without_adc_pdo
from canfb.module.position_alarm import REGISTER, PositionAlarm
from canfb.module.prediction import Prediction
from canfb.module.profile import EncoderProfile
from canfb.module.profile_warnings import Warnings
from canfb.module.publication import Publication
from canfb.module.recorder import Recorder
from canfb.module.sample_input import SampleInput
from canfb.module.table_store import TableStore
from canfb.module.tap import Taps
from canfb.signal.chain import SignalChain
from canfb.signal.feedback import Feedback
from canfb.signal.sample import Sample
from canfb.signal.supervision import COASTING, VALID
from canfb.sources.protocol import Source

EDS = "canfb-module"
MOST_MISSED = 256  # in a row, one by one: more than 2010:03 can bridge
SAME_INTERVAL = 0.02
CONFIRMING_SAMPLES = 4  # after a pause in which the machine may have begun to move
COMMANDS = (od.MEASUREMENT_COMMAND.object_index, od.RECORDING_COMMAND.object_index)
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
    then. ``on_source`` is called with one line when it fails, works again or has ended; ``on_warning``
    when the speed comes near what the jitter of SYNC allows. ValueError
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
        self.on_warning: Callable[[str], None] | None = None
        self._interval = IntervalEstimate(self.dictionary.entry(*od.CYCLE_PERIOD))
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
        self._prediction = Prediction(
            self.dictionary, self._profile, self._choose_prediction, lambda: self.chain.unit_s
        )
        self._publication = Publication(self.dictionary, self._interval, self.chain, self._input)
        self._taps = Taps()
        self._recorder = Recorder(self.dictionary, self._interval, self._taps)
        self._calibrating = Calibrating(
            self.dictionary, self.chain, self._tables, self._taps, self._publication.calibrating
        )
        self._feedback: Feedback | None = None
        self._pairing = Pairing(
            self.dictionary,
            self.node,
            self._interval,
            self._input,
            self._source,
            Findings(
                self._take, self._miss, self._lose_count, self._publication.withhold, self.chain.repeats
            ),
        )
        self._timeline = self._pairing.timeline
        self._jitter = JitterWatch(
            self._timeline,
            self._interval,
            self._limits,
            self.dictionary.entry(*od.ENCODER_CYCLES_PER_REVOLUTION),
            self._warn,
        )
        self._timeline.on_followed = self._watch_jitter
        self._event_tpdos: list[Callable[[float], None]] = []
        self._alarm = PositionAlarm(self.node)
        self._paused_s = 0.0
        self._unconfirmed = 0  # samples after a pause that are not called valid yet
        self.node.on_rpdo = self._pairing.on_rpdo if self._source is None else None
        self._choose_prediction()
        self.node.accepts_sync = self._pairing.accepts_sync
        self.node.on_state = self._on_state
        self.node.on_reset = self._on_reset
        self.node.on_bad_rpdo = self._on_bad_rpdo
        self.node.on_configured = self._on_configured
        self.node.on_parameter_faults = self._on_parameter_faults
        self._choose_parameters()
        self.dictionary.entry(*od.ENCODER_CYCLES_PER_REVOLUTION).on_written = self._encoder_changed
        self._limits.apply()

    @property
    def feedback(self) -> Feedback | None:
        """Every stage of the last sample, None before the first one."""
        return self._feedback

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
        until = self._timeline.until
        if now > until and (frame.timestamp is None or frame.timestamp > until):
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
        if self.state is NmtState.OPERATIONAL and self._pairing.sampled:
            self._publish(self.chain.lose(), now, send=False)
            self._pairing.begin()
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
        for preset in (od.PRESET_VALUE, od.HIGH_PRECISION_PRESET):
            entries.keep(*preset)  # without the preset that a write of it would set
        entries.keep(*od.OFFSET_VALUE)
        for entry in self.dictionary:
            if entry.index in COMMANDS and entry.access == "rw":
                entries.leave_out(entry.index, entry.subindex)

    def _lose_count(self, intervals: float, now: float) -> None:
        """So many intervals may or may not have passed: the position is lost if the machine moves."""
        feedback = self.chain.uncertain(intervals)
        if feedback is not None:
            self._publish(feedback, now)

    def _take(self, sample: Sample, received_s: float | None, now: float) -> bool:
        """A sample through the chain, and out; False if it is an earlier one, and nothing happened."""
        if self._limits.narrowed:
            self._limits.follow()
        timed = sample.time_100ns is not None
        if timed:
            self._follow_interval()
        feedback = self.chain.step(sample, received_s)
        if timed and self._feedback is not None and feedback.samples == self._feedback.samples:
            return False
        if feedback.status & VALID:
            if timed:
                self._pairing.valid(sample)
                if self._prediction.follows and sample.time_100ns is not None:
                    self._prediction.sampled(sample.time_100ns)
            if self._unconfirmed or (self._timeline.withheld and not timed):
                feedback = self._withheld(feedback)
        self._publish(feedback, now)
        if self._taps.open:
            self._taps.take(sample, feedback)
        return True

    def _miss(self, samples: int, now: float) -> None:
        """So many samples that did not come, reported once."""
        known_as_lost = self.chain.lost
        # Of a position that is lost it makes no difference how long it has been.
        for left in range(min(samples, MOST_MISSED) - 1, -1, -1):
            self._publish(self.chain.miss(), now, send=not left and not known_as_lost)
            self._taps.miss()

    def _overdue(self, now: float) -> None:
        """No SYNC and no sample for 2010:06 periods: what stands there is not the position any more."""
        if not self._pairing.overdue(now):
            self._publication.withhold()
            if self._feedback is not None and not self._alarm.active:
                self._alarm.report(False, self._feedback.status & ~VALID, now)
        if self.chain.lost:
            self._timeline.until = NEVER

    def _withheld(self, feedback: Feedback) -> Feedback:
        """What may be right, but is not confirmed."""
        if self._unconfirmed:
            self._unconfirmed -= 1
        return feedback._replace(status=feedback.status & ~VALID | COASTING)

    def _follow_interval(self) -> None:
        """Take the nominal interval along, by which sample times are judged."""
        seconds = self._interval.seconds
        if seconds and abs(seconds - self.chain.interval_s) > SAME_INTERVAL * seconds:
            self.chain.interval_s = seconds

    def _on_sync_predicting(self, counter: int | None, now: float) -> None:
        self._pairing.on_sync(counter, now)
        if self._feedback is not None:
            self._prediction.extrapolate(self._feedback)

    def _choose_prediction(self) -> None:
        """With or without it (2013h). The sample of a source belongs to this very SYNC."""
        wanted = self._prediction.wanted and self._source is None
        self._prediction.forget()
        self.node.on_sync = self._on_sync_predicting if wanted else self._pairing.on_sync
        self.node.on_synchronised = self._prediction.withdraw if wanted else None

    def _watch_jitter(self, now: float, proved: bool) -> None:
        """Sample times know each interval; a time of the call is not that of the SYNC."""
        if proved and self._feedback is not None and not self._pairing.timed:
            self._jitter.look(self._feedback, now)

    def _warn(self, text: str) -> None:
        if self.on_warning is not None:
            self.on_warning(text)

    def _tell_of_source(self, text: str) -> None:
        if self.on_source is not None:
            self.on_source(text)

    def _publish(self, feedback: Feedback, now: float, send: bool = True) -> None:
        """Into the dictionary, and out if there is something new to say."""
        self._feedback = feedback
        self._publication.publish(feedback)
        self._profile.publish(feedback)
        if self._prediction.follows:
            self._prediction.shift(feedback)
        status, warnings = feedback.status, self._warnings
        if self._alarm.active or not status & VALID:
            self._alarm.report(bool(status & VALID), status, now)
        if send:
            for trigger in self._event_tpdos:
                trigger(now)
        if (
            status != warnings.status
            or feedback.residual > warnings.near_cycles
            or feedback.amplitude < warnings.reserve_counts
        ):
            warnings.follow(feedback, now)

    def _on_state(self, old: NmtState, new: NmtState, now: float) -> None:
        if new is NmtState.OPERATIONAL:
            self._pairing.begin()
            self._resume(now)
        elif old is NmtState.OPERATIONAL:
            timeline = self._timeline
            self._paused_s = timeline.synced_s if timeline.begun else now
            timeline.pause()
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
        self._alarm.reset()
        self._warnings.reset()
        self._interval.reset()
        self.chain.interval_s = 0.0  # another master may send SYNC at another rate
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
            self.node.emergency(EmergencyCode.DATA_SET, REGISTER, bytes(sorted(faults))[:5], now)
        else:
            self.node.clear_emergency(EmergencyCode.DATA_SET, now)
        if self.on_parameter_faults is not None:
            self.on_parameter_faults(faults)

    def _on_configured(self) -> None:
        """A sample comes in whichever RPDOs carry its parts; some TPDOs go out with it."""
        self._input.configure()
        self._warnings.look_again()
        self._event_tpdos = [
            self.node.tpdo_trigger(number) for number in TPDOS if self._is_event_tpdo(number)
        ]

    def _is_event_tpdo(self, number: int) -> bool:
        cob_id, kind = (self.dictionary.entry(od.TPDO + number - 1, subindex).value for subindex in (1, 2))
        return is_valid(cob_id) and kind in ON_EVENT

    def _on_bad_rpdo(self, number: int, received: int, mapped: int, now: float) -> None:
        self._pairing.count_bad_frame()
