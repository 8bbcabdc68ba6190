"""Object 2000h: a sample, assembled from the RPDOs that carry its parts, or given by a source.

The parts may come in several PDOs, in any order that the interface keeps. If one is lost or doubled, parts of
two samples are not combined.

2000:0E and 2014h, the position of another sensor, are paired with the samples by SYNC.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

from canfb import objects as od
from canfb.device.node import Node
from canfb.device.od.dictionary import Dictionary, refuse_if
from canfb.device.pdo.rpdo import Rpdo
from canfb.module.parameters import SECOND_SENSOR
from canfb.signal.chain import SignalChain
from canfb.signal.sample import TICK_S, TICKS, Sample
from canfb.signal.second_position import MOST_TOLERANCE_REVOLUTIONS, SecondSensor
from canfb.sources.protocol import Grouped, Source, SourceWatch

# Plain integers for the hot path.
ZERO_PULSE, SAMPLE_INVALID = int(od.SampleFlag.ZERO_PULSE), int(od.SampleFlag.INVALID)
NEW_ORDER = 3  # intervals in a row that show another order of the PDOs
NO_RPDO = -1
PLACES = 65536.0  # 2000:07 counts the interval of SYNC in 1/65536


class SampleInput:
    """Waits for all RPDOs with a part of 2000h, then gives the sample.

    Both tracks of a pair must come in one RPDO. Earlier pairs are used up to the first that no RPDO brings.

    ``sine`` ... ``place``  the entries of 2000:01..07
    ``arrived``             RPDOs of this sample that have come, bit n: RPDO n
    ``alone``               the RPDO that brings the whole sample, None: several do
    ``usual``               the RPDO that brings two counts, perhaps their time, and no more; else NO_RPDO
    ``timed``               each sample brings its time
    ``judged``              the RPDO with the tracks, if only its arrival shows which SYNC it answers
    ``is_synchronous``      the tracks take effect at the SYNC after they came
    ``is_mixed``            parts may be of two samples: none is given for half a period
    ``on_mixed``            called for a part that is not used
    ``pulses``              number of zero pulses
    """

    def __init__(self, dictionary: Dictionary, node: Node) -> None:
        self._node, entry = node, dictionary.entry
        self.sine, self.cosine = entry(*od.SAMPLE_SINE), entry(*od.SAMPLE_COSINE)
        self.coarse_sine, self.coarse_cosine = entry(*od.SAMPLE_COARSE_SINE), entry(*od.SAMPLE_COARSE_COSINE)
        self.time, self.flags = entry(*od.SAMPLE_TIME), entry(*od.SAMPLE_FLAGS)
        self.place = entry(*od.SAMPLE_ZERO_PULSE_PLACE)
        self.all_earlier = [(entry(*sine), entry(*cosine)) for sine, cosine in od.SAMPLE_EARLIER]
        self.on_mixed: Callable[[], None] = lambda: None
        self.pulses = 0
        self._origin: object = None  # where samples come from, to detect a change
        self._required = -1  # bit n: RPDO n brings a part of a sample
        self.configure()

    def configure(self) -> bool:
        """Read the mapping; True if it changes how samples are paired."""
        with_ = self._node.rpdo_with
        tracks = with_(od.SAMPLE_SINE, od.SAMPLE_COSINE)
        coarse = with_(od.SAMPLE_COARSE_SINE, od.SAMPLE_COARSE_COSINE)
        time, flags = with_(od.SAMPLE_TIME), with_(od.SAMPLE_FLAGS)
        place, second = with_(od.SAMPLE_ZERO_PULSE_PLACE), with_(od.SAMPLE_SECOND_POSITION)
        pairs = (with_(*pair) for pair in od.SAMPLE_EARLIER)
        earlier = list(itertools.takewhile(lambda number: number is not None, pairs))
        self._earlier = self.all_earlier[: len(earlier)]
        parts = {tracks, coarse, time, flags, place, *earlier} - {None}
        required = 0 if tracks is None else sum(1 << number for number in parts if number is not None)
        self.alone = tracks if len(parts) == 1 else None
        self._with_coarse, self.timed = coarse is not None, time is not None
        self.expects_pulse, self._with_place = flags is not None, place is not None
        self._waiting: Rpdo | None = None if tracks is None else self._node.synchronous_rpdo(tracks)
        self.is_synchronous = self._waiting is not None
        self.judged = None if self.timed or self.is_synchronous else tracks
        # Not with a second position, which is compared with each sample.
        at_once = self.alone is not None and coarse is flags is second is None and not earlier
        self.usual = tracks if tracks is not None and at_once and not self.is_synchronous else NO_RPDO
        if required != self._required:  # if not, a sample that has come in part is kept
            self._required = required
            self.begin()
        before, self._origin = self._origin, (tracks, self.is_synchronous, self.timed, len(earlier))
        return before != self._origin

    def begin(self) -> None:
        self.arrived = 0
        self._first: int | None = None  # the RPDO that begins a sample
        self._early = self._earliest = 0  # bit n: RPDO n came before `_first`; the first of those RPDOs
        self._others_first = 0  # intervals in a row in which the missing parts came before `_first`
        self.is_mixed = False

    @property
    def samples_per_sync(self) -> int:
        return 1 + len(self._earlier)

    def take(self, number: int) -> bool:
        """Note RPDO ``number``; True if the sample is complete with it.

        If a part comes twice before the others, it is open which of them belong together (``is_mixed``). A
        part before the usual first one is a late one of the last sample, or doubled.
        """
        part = 1 << number
        if not self._required & part:
            return False
        if not self.arrived and self._first not in (None, number):
            self._earliest = self._earliest if self._early else number
            self._early |= part
            self.on_mixed()
            return False
        if not self.arrived:
            self._first = number
        self.is_mixed |= self.arrived & part != 0
        self.arrived |= part
        if self.arrived != self._required:
            return False
        self.arrived = self._early = self._others_first = 0
        if self.is_mixed:
            self.on_mixed()
        return not self.is_mixed

    def give_up(self) -> bool:
        """End the interval; True if parts of a sample came, but not all.

        If the missing ones came before the others NEW_ORDER times in a row, that is the order from now on.
        """
        parts, self.arrived = self.arrived, 0
        early, self._early = self._early, 0
        if parts and early == self._required & ~parts:
            self._others_first += 1
            if self._others_first >= NEW_ORDER:
                self._first, self._others_first = self._earliest, 0
        return parts != 0

    @property
    def is_ambiguous(self) -> bool:
        return self._waiting is not None and self._waiting.waiting > 1

    def sample(self) -> Sample:
        flags = self.flags.value
        invalid = flags & SAMPLE_INVALID != 0
        pulse = None
        if self.expects_pulse and flags & ZERO_PULSE:
            self.pulses += 1
            pulse = self.place.value / PLACES if self._with_place else 1.0
        earlier = self._earlier
        return tuple.__new__(  # without its slow constructor
            Sample,
            (
                self.sine.value,
                self.cosine.value,
                1.0,
                invalid,
                self.coarse_sine.value if self._with_coarse else None,
                self.coarse_cosine.value if self._with_coarse else None,
                pulse,
                self.time.value if self.timed else None,
                tuple([(sine.value, cosine.value) for sine, cosine in earlier]) if earlier else (),
            ),
        )


class LocalSource:
    """Reads a :class:`canfb.sources.protocol.Source` at each SYNC; its errors do not raise.

    ``report`` gets one line when it fails, works again, or has ended. ``samples_per_sync`` pairs are in a
    sample. ``source_time_s``: time of the last sample since the first one, s; None without time stamps.
    """

    def __init__(self, source: Source, parts: SampleInput, report: Callable[[str], None]) -> None:
        self._watch, self._parts = SourceWatch(source.next, report), parts
        self.samples_per_sync = source.samples_per_sync if isinstance(source, Grouped) else 1
        self.source_time_s: float | None = None

    def next(self, now: float) -> Sample | None:
        """The sample of the SYNC at ``now``, None: missed; its counts go into 2000h."""
        sample, parts = self._watch.sample(now), self._parts
        if sample is None:
            return None
        parts.sine.value, parts.cosine.value = sample.sine, sample.cosine
        flags = SAMPLE_INVALID if sample.invalid else 0
        if sample.zero_pulse is not None:
            parts.pulses += 1
            flags |= ZERO_PULSE
            parts.place.value = min(int(sample.zero_pulse * PLACES), 0xFFFF)
        parts.flags.value = flags
        if sample.time_100ns is not None:
            ticks = (sample.time_100ns - parts.time.value) % TICKS
            self.source_time_s = 0.0 if self.source_time_s is None else self.source_time_s + ticks * TICK_S
            parts.time.value = sample.time_100ns
        for (first, second), (sine, cosine) in zip(parts.all_earlier, sample.earlier, strict=False):
            first.value, second.value = sine, cosine
        if sample.coarse_sine is not None:
            parts.coarse_sine.value, parts.coarse_cosine.value = sample.coarse_sine, sample.coarse_cosine
        return sample


UNCERTAIN = -1


class SecondInput:
    """Counts the values of 2000:0E between two SYNCs; a single one belongs to the sample of the first SYNC.

    In use while RPDO ``number`` brings 2000:0E and 2014:04 is above 0.
    """

    def __init__(self, dictionary: Dictionary, node: Node, chain: SignalChain) -> None:
        self._node, self._chain = node, chain
        self._value = dictionary.entry(*od.SAMPLE_SECOND_POSITION)
        self._parameters = {name: dictionary.entry(*place) for name, place in SECOND_SENSOR.items()}
        self._parameters["tolerance_revolutions"].on_check = refuse_if(
            lambda value: not 0.0 <= value <= MOST_TOLERANCE_REVOLUTIONS
        )
        for parameter in self._parameters.values():
            parameter.on_written = self.apply
        self._cycles_per_revolution = dictionary.entry(*od.ENCODER_CYCLES_PER_REVOLUTION)
        dictionary.entry(*od.SECOND_DIFFERENCE).on_read = self.difference_revolutions
        self.number: int | None = None
        self.values = 0  # since the last SYNC

    @property
    def sensor(self) -> SecondSensor | None:
        values = {name: entry.value for name, entry in self._parameters.items()}
        if self.number is None or values["tolerance_revolutions"] == 0.0:
            return None
        flags = {name: bool(values[name]) for name in ("reversed", "invalidates")}
        return SecondSensor(**values | flags)

    def apply(self) -> None:
        """Apply 2014h; forget the values so far."""
        self.values = 0
        self._chain.use_second(self.sensor)

    def configure(self) -> None:
        self.number = self._node.rpdo_with(od.SAMPLE_SECOND_POSITION)
        second = self._chain.second
        if self.sensor != (None if second is None else second.sensor):
            self.apply()

    def interval_over(self, certain: bool) -> None:
        """At a SYNC, before its sample; ``certain``: the SYNC before was received, too."""
        values, self.values = self.values, 0
        self._chain.hear_second(values if certain else UNCERTAIN, self._value.value)

    def difference_revolutions(self) -> float:
        """2014:06, sensor minus position; NaN: not known."""
        second = self._chain.second
        if second is None or second.difference_cycles is None:
            return math.nan
        return second.difference_cycles / float(self._cycles_per_revolution.value)
