"""The remote encoder interface: a CiA 401 analog input node that samples any source at every SYNC and records
both tracks faster than SYNC (2050h); its sampling instants; its configuration."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from canfb import objects as od
from canfb.checks import integer_in, number_in, within
from canfb.cia301.codes import AbortCode, EmergencyCode, ErrorRegister, SdoAbort
from canfb.device.core import FOLLOWED, IGNORED, HeldRpdo
from canfb.device.lss import UNCONFIGURED
from canfb.device.node import NodeDevice
from canfb.device.od.dictionary import Dictionary, refuse_if
from canfb.device.pdo.mapping import COMMUNICATION, Direction, numbers
from canfb.device.storage.storage import Store
from canfb.eds_files import eds_path
from canfb.signal.sample import MOST_PER_SYNC, TICKS, Sample
from canfb.sources.protocol import Grouped, Machine, Source, SourceConfig, SourceWatch
from canfb.timing.grid import TOGETHER, Grid


class TimeBase:
    """The time of the machine as seen by a node: the true time; a simulated machine may have its own."""

    def at(self, now: float) -> float:
        """The time of the machine, seconds, at ``now``."""
        return now


TICKS_PER_S = 10_000_000  # units of 100 ns
LARGEST_DRIFT_PPM = 10_000.0


class SampleClock:
    """Counts units of 100 ns as U32, which wraps every 429.5 s; it is never set or stopped.

    drift_ppm     rate relative to true time, -10000..10000 ppm; a crystal has up to ±100
    start_100ns   its value at the time 0 of the node, any integer

    ValueError for anything else.
    """

    def __init__(self, drift_ppm: float = 0.0, start_100ns: int = 0) -> None:
        number_in("drift_ppm", drift_ppm, -LARGEST_DRIFT_PPM, LARGEST_DRIFT_PPM)
        self._start = start_100ns
        self._rate = TICKS_PER_S * (1.0 + drift_ppm * 1e-6)

    def ticks(self, now: float) -> int:
        return (self._start + math.floor(now * self._rate)) % TICKS


LOCK_SYNCS = 4096  # SYNCs from which the grid of the samples is estimated
EARLIER_PART = 1.0 / 16.0  # lead of the newest sample on the nominal SYNC, part of the interval


class SyncSampler:
    """Gives ``per_sync`` samples, 1..8, of a machine or a recording for each SYNC, as one `Sample`.

    A single sample is taken at the SYNC. Several samples of a machine lie on a grid that is locked to SYNC:
    the newest shortly before it, or at the SYNC if that is early. The first SYNC gets no sample, because no
    interval is known.
    """

    def __init__(self, source: Source, per_sync: int) -> None:
        self._source = source
        self._machine = source if isinstance(source, Machine) else None
        self._per_sync = per_sync
        self._grid = Grid(LOCK_SYNCS)
        self._last_s: float | None = None
        self._taken_s: float | None = None
        self.newest_s = 0.0  # Instant of the newest sample, time of the machine, seconds.

    def at_sync(self, received_s: float) -> Sample | None:
        """The samples for the SYNC received then; None if one is missing. Raises errors of ``source``."""
        self.newest_s = received_s
        if self._per_sync == 1:
            return self._source.next() if self._machine is None else self._machine.sample_at(received_s)
        if self._machine is None:
            return _together([self._source.next() for _ in range(self._per_sync)], None)
        last, self._last_s, rough_s = self._last_s, received_s, self._grid.rough
        self._grid.take(received_s)
        if last is None or not received_s > last:
            return None
        period_s, lead_s = rough_s or received_s - last, 0.0  # rough_s does not count a pause as an interval
        if self._grid.locked:
            period_s, lead_s = self._grid.period, self._grid.lead
        newest_s = min(received_s + lead_s - EARLIER_PART * period_s, received_s)
        before, self._taken_s, self.newest_s = self._taken_s, newest_s, newest_s
        passed_s = period_s if before is None else newest_s - before
        if passed_s <= TOGETHER * period_s:  # SYNCs too close for the grid
            return None
        is_early = passed_s <= period_s - period_s / self._per_sync  # possible until the grid is locked
        apart_s = (passed_s if is_early else period_s) / self._per_sync
        instants = [newest_s - earlier * apart_s for earlier in range(self._per_sync - 1, -1, -1)]
        return _together(
            [self._machine.sample_at(instant) for instant in instants],
            None if before is None else [one - before for one in instants],
        )


def _together(samples: list[Sample | None], passed_s: list[float] | None) -> Sample | None:
    """All in one `Sample`; ``passed_s``: their times since the last sample of the previous SYNC."""
    there = [one for one in samples if one is not None]
    if len(there) < len(samples):
        return None
    *earlier, newest = there
    pulse = newest.zero_pulse
    if passed_s is not None:
        begins = [0.0, *passed_s[:-1]]
        places = [
            (begin + one.zero_pulse * (end - begin)) / passed_s[-1]
            for one, begin, end in zip(there, begins, passed_s, strict=True)
            if one.zero_pulse is not None
        ]
        pulse = places[-1] if places else None
    pairs = tuple((one.sine, one.cosine) for one in reversed(earlier))
    return newest._replace(zero_pulse=pulse, earlier=pairs)


class MachineNode(NodeDevice):
    """A node on a machine, whose time ``time_base`` gives."""

    time_base = TimeBase()

    def machine_now(self) -> float:
        return self.time_base.at(self.now)

    @property
    def received_s(self) -> float:
        """Receive time of the present frame, time of the machine."""
        return self.time_base.at(self.call.received)


BLOCK_SAMPLES = 1 << 16

Block = npt.NDArray[np.int16]  # Sine and cosine in ADC counts, shape (n, 2).


@runtime_checkable
class Continuous(Protocol):
    """A source that can be sampled at any time."""

    def machine_time(self, now: float) -> float:
        """The time of the machine, seconds, at the time ``now`` of the node."""

    def fast_samples(self, times_s: npt.NDArray[np.float64], seed: tuple[int, int]) -> Block:
        """Both tracks at these times of the machine; ``seed`` determines the noise."""


class FastRecorder:
    """Samples the encoder from start (2050:01 = 1) to stop (2), or until the memory is full (2050:05).

    The samples, at the rate of 2050:04, are a function of time, computed when 2050:03 is read. A reset of the
    node deletes them. Without a :class:`Continuous` source, start is refused (08000022h).
    """

    def __init__(self, dictionary: Dictionary, source: object, now: Callable[[], float]) -> None:
        self._source = source if isinstance(source, Continuous) else None
        self._now = now
        self._command = command = dictionary.entry(*od.RECORDING_COMMAND)
        command.on_check = refuse_if(lambda value: value not in [*od.RecordingCommand])
        command.on_written = self._obey
        dictionary.read_live(
            {
                od.RECORDING_COMMAND: lambda: int(self.is_recording),
                od.RECORDING_RECORDED: lambda: self.count,
                od.RECORDING_SAMPLES: self.to_bytes,
            }
        )
        self._rate, self._capacity = (
            dictionary.entry(*place) for place in (od.RECORDING_RATE, od.RECORDING_CAPACITY)
        )
        self._rate.on_check = refuse_if(lambda value: self.is_recording, AbortCode.DEVICE_STATE)
        self._number = 0
        self.reset()

    def reset(self) -> None:
        self._began_s: float | None = None  # start of the recording, time of the node; None: not recording
        self._kept = 0  # number of samples after the stop

    @property
    def is_recording(self) -> bool:
        return self._began_s is not None and self.count < self._capacity.value

    @property
    def count(self) -> int:
        if self._began_s is None:
            return self._kept
        passed = max(0.0, self._now() - self._began_s)
        # The first sample is taken at the start; 1e-6: a whole number may be missed by rounding.
        return min(int(passed * self._rate_hz + 1e-6) + 1, int(self._capacity.value))

    def to_bytes(self) -> bytes:
        """The recording, computed in whole blocks: so the noise does not depend on the time of reading."""
        count = self.count
        return b"".join(map(self._block, range(-(-count // BLOCK_SAMPLES))))[: 4 * count]

    def _block(self, number: int) -> bytes:
        assert self._source is not None  # without one, start is refused
        places = np.arange(number * BLOCK_SAMPLES, (number + 1) * BLOCK_SAMPLES)
        block = self._source.fast_samples(self._first_s + places / self._rate_hz, (self._number, number))
        return block.astype("<i2").tobytes()

    def _obey(self) -> None:
        if self._command.value != od.RecordingCommand.START:
            self._kept, self._began_s = self.count, None
            return
        if self._source is None:
            raise SdoAbort(AbortCode.DEVICE_STATE)
        self._number += 1
        self._rate_hz = float(self._rate.value)
        self._began_s = self._now()
        self._first_s = self._source.machine_time(self._began_s)  # instant of the first sample


EDS = "encoder-interface"
PLACES = 65536  # 2000:03 counts the sample interval in 1/65536
SAMPLE_OBJECTS = (
    od.INTERFACE_SINE,
    od.INTERFACE_COSINE,
    od.INTERFACE_COARSE_SINE,
    od.INTERFACE_COARSE_COSINE,
    od.INTERFACE_SAMPLE_TIME,
    od.INTERFACE_FLAGS,
    od.INTERFACE_ZERO_PULSE_PLACE,
    *(channel for pair in od.INTERFACE_EARLIER for channel in pair),
)


class EncoderInterface(MachineNode):
    """A CANopen node, sans-I/O, with the ADC channels in 6401h and TPDO1 at each SYNC.

    A :class:`Machine` is sampled at the receive time of the SYNC (``time_base``); any other source gives one
    sample for each SYNC. Without a sample no TPDO is sent. A source that fails is read again at the next
    SYNC; ``on_source`` gets one line, and EMCY 5000h is active. 2000:01 is the time of the sample, from the
    source or from ``clock``; with ``times`` TPDO1 carries it. ``samples_per_sync`` is 1..8;
    ``store`` keeps what 1010h and LSS save; LSS may select one of ``bit_rates_kbit_s``.
    """

    def __init__(
        self,
        node_id: int,
        source: Source,
        *,
        autostart: bool = False,
        store: Store | None = None,
        serial_number: int = 0,
        times: bool = False,
        samples_per_sync: int = 1,
        clock: SampleClock | None = None,
        bit_rates_kbit_s: Collection[int] = (),
    ) -> None:
        dictionary = Dictionary.load(eds_path(EDS), node_id)
        pairs = [(od.INTERFACE_SINE, od.INTERFACE_COSINE), *od.INTERFACE_EARLIER][:samples_per_sync]
        time = [od.INTERFACE_SAMPLE_TIME] if times else []
        own = od.sample_pdos(od.TPDO, od.TPDO_MAPPING, pairs, time, node_id)
        del own[od.TPDO, 1]  # the EDS defines its COB-ID
        own[od.IDENTITY_SERIAL_NUMBER] = serial_number
        for place, value in own.items():
            parameter = dictionary.entry(*place)
            parameter.default = parameter.value = value
        super().__init__(
            dictionary, node_id, autostart=autostart, store=store, bit_rates_kbit_s=bit_rates_kbit_s
        )
        self.on_source: Callable[[str], None] = lambda text: None
        for place in (od.RECORDING_COMMAND, od.RECORDING_RATE, od.INTERFACE_MACHINE):  # no parameters
            self.storage.entries.leave_out(*place)
        self._clock = SampleClock() if clock is None else clock
        self.recorder = FastRecorder(self.dictionary, source, self.machine_now)
        self.source = source
        self.dictionary.entry(*od.INTERFACE_MACHINE).on_check = refuse_if(
            lambda value: True, AbortCode.DEVICE_STATE
        )
        grouped = isinstance(source, Grouped) and source.samples_per_sync == samples_per_sync
        self._sampler = SyncSampler(source, 1 if grouped else samples_per_sync)
        self._watch = SourceWatch(
            lambda: self._sampler.at_sync(self.received_s), lambda text: self.on_source(text)
        )
        self.samples = 0  # Samples sent.
        self.missed = 0  # SYNCs in OPERATIONAL without a sample, before the end of the source.
        entry, parameters = self.dictionary.entry, COMMUNICATION[Direction.TRANSMIT] - 1
        self._entries = {place: entry(*place) for place in SAMPLE_OBJECTS}
        self._types = {
            number: entry(parameters + number, 2) for number in numbers(self.dictionary, Direction.TRANSMIT)
        }

    @property
    def ended(self) -> bool:
        return self._watch.ended

    def synchronise(self, counter: int | None, now: float, waiting: Sequence[HeldRpdo]) -> int:
        sample = self._watch.sample(now)
        if self._watch.failed_s is not None:
            self.emergency(EmergencyCode.HARDWARE, ErrorRegister.GENERIC, b"", now)
        else:
            self.clear_emergency(EmergencyCode.HARDWARE, now)
        if sample is None:
            self.missed += not self.ended
            return IGNORED
        self.samples += 1
        self._keep(sample)
        for number, kind in self._types.items():
            if kind.value == 0:  # FEh and FFh use their event timer: every sample would be too frequent
                self.trigger_tpdo(number, now)
        return FOLLOWED

    def _keep(self, sample: Sample) -> None:
        sine, cosine, _, invalid, coarse_sine, coarse_cosine, pulse, time_100ns, pairs = sample
        has_pulse = od.SampleFlag.ZERO_PULSE if pulse is not None else 0
        values = {
            od.INTERFACE_SINE: sine,
            od.INTERFACE_COSINE: cosine,
            od.INTERFACE_COARSE_SINE: coarse_sine,
            od.INTERFACE_COARSE_COSINE: coarse_cosine,
            od.INTERFACE_SAMPLE_TIME: self._clock.ticks(self._sampler.newest_s)
            if time_100ns is None
            else time_100ns,
            od.INTERFACE_FLAGS: has_pulse | (od.SampleFlag.INVALID if invalid else 0),
            od.INTERFACE_ZERO_PULSE_PLACE: None if pulse is None else min(int(pulse * PLACES), PLACES - 1),
        }
        for places, pair in zip(od.INTERFACE_EARLIER, pairs, strict=False):
            values |= zip(places, pair, strict=True)
        for place, value in values.items():
            if value is not None:  # None: keep the previous value
                self._entries[place].value = value

    def reset_done(self, communication_only: bool, now: float) -> None:
        if not communication_only:
            self.recorder.reset()


@dataclass(frozen=True, kw_only=True)
class InterfaceConfig:
    """One encoder interface: a node that sends the samples of its source, one PDO for each SYNC.

    node_id                  of the interface, 1..127, required; 255: assigned by an LSS master. A node-ID
                             stored by LSS in state_dir takes precedence
    source                   of its samples, required: a converter (``kind: iio``), a recording, or the
                             simulated machine
    serial_number            0..4294967295 (1018:04): distinguishes equal devices for an LSS master
    times                    True: the ADC PDO carries the sample time after sine and cosine; as ``times`` of
                             the module
    samples_per_sync         1..8 pairs of sine and cosine for each SYNC, with ``times`` at most 7; as
                             ``samples_per_sync`` of the module
    adc_bits                 of the simulated converter, 4..16; a value that differs from that of a real
                             converter is refused
    cycles_per_revolution    of the simulated encoder, 1..1048576
    state_dir                folder for the data of `save` (1010h) and LSS, created if missing; None: nothing
                             is saved
    autostart                True: OPERATIONAL without a master
    """

    node_id: int
    source: SourceConfig
    serial_number: int = 0
    times: bool = False
    samples_per_sync: int = 1
    adc_bits: int = 12
    cycles_per_revolution: int = 2500
    state_dir: str | None = None
    autostart: bool = False

    def __post_init__(self) -> None:
        if self.node_id != UNCONFIGURED or not isinstance(self.node_id, int):
            integer_in("node_id", self.node_id, 1, 127)
        if not isinstance(self.source, SourceConfig):
            raise ValueError(f"source must be a configuration of a source, not {self.source!r}")
        within(
            self,
            serial_number=(0, 0xFFFFFFFF),
            samples_per_sync=(1, MOST_PER_SYNC - bool(self.times)),
            adc_bits=(4, 16),
            cycles_per_revolution=(1, 1048576),
            state_dir=str,
            times=bool,
            autostart=bool,
        )
