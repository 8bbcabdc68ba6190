"""The PDOs of a node (CiA 301, 7.5.2.36 to 7.5.2.40), the layout of a sample in them, and the limits of
the motion in force, from 2010h and the SYNC rate."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from canfb import objects as od
from canfb.cia301 import cob
from canfb.signal.chain_config import ChainLimits
from canfb.signal.front_end import Corners
from canfb.signal.limits import (
    COAST_SAMPLES,
    DOUBT_ACCELERATION,
    PHASE_ERROR_CYCLES,
    Declared,
    cycles_per_interval_squared,
    narrowed_residual_limit,
)
from canfb.signal.residual_noise import RESIDUAL_WEIGHTS
from canfb.signal.sample import TICK_S
from canfb.signal.supervision import SampleLimits

Number = int | float
Read = Callable[[od.Multiplexer], Number | None]  # Returns the value of an object, None: not known.


def values_of(find: Callable[[int, int], Any]) -> Read:
    """A `Read` of the entries of a dictionary."""

    def read(place: od.Multiplexer) -> Number | None:
        entry = find(*place)
        return None if entry is None else entry.value

    return read


MOST_ENTRIES = 64  # larger values in sub-index 0 of a mapping mean a multiplexed PDO


def place_of(entry: int) -> od.Multiplexer:
    return od.Multiplexer(entry >> 16, entry >> 8 & 0xFF)


class Pdo(NamedTuple):
    """A valid PDO; ``number`` from 1, ``entries`` as in 1600h."""

    number: int
    can_id: int
    entries: tuple[int, ...]

    @property
    def length_bytes(self) -> int:
        return (sum(entry & 0xFF for entry in self.entries) + 7) // 8

    def values(self, data: bytes) -> dict[od.Multiplexer, bytes]:
        """The bytes of each object in a frame; none if it is too short."""
        if len(data) < self.length_bytes:
            return {}
        whole = int.from_bytes(data, "little")
        widths = [(entry, whole >> bit, entry & 0xFF) for entry, bit in self.bits_of()]
        return {
            place_of(entry): (value & (1 << bits) - 1).to_bytes((bits + 7) // 8, "little")
            for entry, value, bits in widths
        }

    def bits_of(self) -> Iterator[tuple[int, int]]:
        begins = itertools.accumulate((entry & 0xFF for entry in self.entries), initial=0)
        return zip(self.entries, begins, strict=False)

    def carries(self, index: int) -> bool:
        return any(entry >> 16 == index for entry in self.entries)


def valid_pdos(read: Read, parameters: int, mapping: int) -> Iterator[Pdo]:
    """The valid PDOs with 11-bit identifiers; ``parameters``, ``mapping``: indices of the first."""
    for number in range(len(cob.TPDOS)):
        cob_id = read(od.Multiplexer(parameters + number, 1))
        count = read(od.Multiplexer(mapping + number))
        if cob_id is None or count is None or int(cob_id) & (cob.NOT_VALID | cob.EXTENDED):
            continue
        if count <= MOST_ENTRIES:
            places = (od.Multiplexer(mapping + number, sub + 1) for sub in range(int(count)))
            entries = tuple(int(read(place) or 0) for place in places)
            yield Pdo(number + 1, int(cob_id) & cob.CAN_ID, entries)


Pair = tuple[int, int]  # mapping entries of a sine and its cosine
# The pairs of the newest sample and of the earlier ones in an interval, newest first.
INTERFACE_PAIRS = tuple(
    (sine.mapped(16), cosine.mapped(16))
    for sine, cosine in ((od.INTERFACE_SINE, od.INTERFACE_COSINE), *od.INTERFACE_EARLIER)
)
MODULE_PAIRS = tuple(
    (sine.mapped(16), cosine.mapped(16))
    for sine, cosine in ((od.SAMPLE_SINE, od.SAMPLE_COSINE), *od.SAMPLE_EARLIER)
)
SAMPLE_TIMES = (od.INTERFACE_SAMPLE_TIME.mapped(32), od.SAMPLE_TIME.mapped(32))


@dataclass(frozen=True)
class PdoLayout:
    """Location of both tracks, ``coarse``, ``earlier`` pairs (newest first) and sample time in PDOs.

    ``time_byte`` None: the time is in another PDO (``timed_by``) or missing.
    """

    can_id: int
    sine_byte: int = 0
    cosine_byte: int = 2
    sync_id: int = cob.SYNC
    time_byte: int | None = None
    coarse: PdoLayout | None = None
    earlier: tuple[PdoLayout, ...] = ()
    timed_by: PdoLayout | None = None

    @property
    def sender(self) -> int | None:
        """Node-ID by the predefined connection set, or None."""
        return (self.can_id & 0x7F or None) if self.can_id & 0x780 in cob.TPDOS else None

    def unpack(self, data: bytes) -> tuple[int, int] | None:
        """Sine and cosine, counts; None: too short."""
        if len(data) < max(self.sine_byte, self.cosine_byte) + 2:
            return None
        return (
            int.from_bytes(data[self.sine_byte : self.sine_byte + 2], "little", signed=True),
            int.from_bytes(data[self.cosine_byte : self.cosine_byte + 2], "little", signed=True),
        )

    def sample_time(self, data: bytes) -> int | None:
        """Sample time, 100 ns, modulo 2^32, or None."""
        begin = self.time_byte
        if begin is None or len(data) < begin + 4:
            return None
        return int.from_bytes(data[begin : begin + 4], "little")


def module_layout(read: Read) -> PdoLayout | None:
    """Layout of the samples that a module receives, or None."""
    return _layout(read, od.RPDO, od.RPDO_MAPPING, MODULE_PAIRS)


def coarse_layout(read: Read) -> PdoLayout | None:
    return _layout(
        read,
        od.RPDO,
        od.RPDO_MAPPING,
        [(od.SAMPLE_COARSE_SINE.mapped(16), od.SAMPLE_COARSE_COSINE.mapped(16))],
    )


def interface_layout(read: Read) -> PdoLayout | None:
    """Layout of the samples that an encoder interface sends, or None."""
    return _layout(read, od.TPDO, od.TPDO_MAPPING, INTERFACE_PAIRS)


def mapped_objects(read: Read) -> set[int]:
    return {entry for pdo in valid_pdos(read, od.RPDO, od.RPDO_MAPPING) for entry in pdo.entries}


def _layout(read: Read, parameters: int, mapping: int, pairs: Sequence[Pair]) -> PdoLayout | None:
    pdos = [
        (pdo.can_id, {entry: bit // 8 for entry, bit in reversed([*pdo.bits_of()]) if bit % 8 == 0})
        for pdo in valid_pdos(read, parameters, mapping)
    ]

    def carrier(pair: Pair) -> PdoLayout | None:
        both = ((can_id, at) for can_id, at in pdos if at.keys() >= set(pair))
        return next((PdoLayout(can_id, at[pair[0]], at[pair[1]]) for can_id, at in both), None)

    found, earlier = carrier(pairs[0]), pairs[1:]
    if found is None:
        return None
    times = {can_id: at[one] for can_id, at in reversed(pdos) for one in SAMPLE_TIMES if one in at}
    time_byte, timed_by = times.get(found.can_id), None
    if earlier and time_byte is None and times:
        can_id = next(can_id for can_id, _ in pdos if can_id in times)
        timed_by = PdoLayout(can_id, time_byte=times[can_id])
    others = itertools.takewhile(lambda one: one is not None, map(carrier, earlier))
    sync = read(od.SYNC_COB_ID)
    return replace(
        found,
        sync_id=cob.SYNC if sync is None else int(sync) & cob.CAN_ID,
        time_byte=time_byte,
        earlier=tuple(one for one in others if one is not None),
        timed_by=timed_by,
    )


LIMIT_UNITS = 65536  # 2010:01 and 2011:02 count in 1/65536 cycle


@dataclass(frozen=True)
class LimitSettings:
    """Settings that determine the limits; 0: not set, or not known.

    widest_cycles      2010:01
    doubt_acceleration 2010:0B, cycles per interval^2
    sync_jitter_s      2010:0D
    cycle_period_s     1006h
    timed              RPDOs carry the sample time
    """

    cycles_per_revolution: int
    sample: SampleLimits
    widest_cycles: float
    acceleration_rad_s2: float
    coast_samples: int
    frozen_samples: int
    coarse_limit_revolutions: float
    noise_margin: int
    bad_samples: int
    doubt_acceleration: float
    phase_error_cycles: float
    sync_jitter_s: float
    cycle_period_s: float
    samples_per_sync: int
    timed: bool
    corners: Corners

    def limit_cycles(
        self,
        sync_hz: float | None,
        noise_cycles: float | None = None,
        velocity_rad_s: float | None = None,
    ) -> float:
        """The residual limit in force; 2010:01 if nothing narrows it or the interval is unknown.

        ``sync_hz`` None: use 1006h. ``noise_cycles`` is 2011:0B, None: not read.
        """
        sync_s = 1.0 / sync_hz if sync_hz else self.cycle_period_s
        interval_s = sync_s / self.samples_per_sync
        limit = self.bounds(interval_s, noise_cycles).residual_limit
        if self.timed and velocity_rad_s:
            cycles_per_s = abs(velocity_rad_s) * self.cycles_per_revolution / (2.0 * math.pi)
            limit += 4.0 * cycles_per_s * (TICK_S / 2.0)  # all sample times wrong by half a tick
        return min(limit, self.widest_cycles)

    def needed_cycles(self, sync_hz: float) -> float:
        """The least 2010:01 that good samples meet, with 2010:02 (not at 0 Hz) and 2010:0C."""
        interval_s = 1.0 / (sync_hz * self.samples_per_sync) if sync_hz else 0.0
        expected = cycles_per_interval_squared(
            self.acceleration_rad_s2, self.cycles_per_revolution, interval_s
        )
        return expected + 4.0 * self.phase_error_cycles

    def bounds(self, interval_s: float, noise_cycles: float | None = None) -> Declared:
        """Declared limits at this sampling interval; 0.0: not known."""
        n, widest = self.cycles_per_revolution, self.widest_cycles
        largest = self.acceleration_rad_s2 if interval_s else 0.0
        margin = (
            math.inf if noise_cycles is None or not self.noise_margin else self.noise_margin * noise_cycles
        )
        return Declared(
            residual_limit=narrowed_residual_limit(
                widest, largest, n, interval_s, margin, self.phase_error_cycles
            ),
            widest_limit=widest,
            acceleration=cycles_per_interval_squared(largest, n, interval_s) or None,
            acceleration_waits=not interval_s and self.acceleration_rad_s2 > 0.0,
            phase_error=min(self.phase_error_cycles, margin / math.sqrt(RESIDUAL_WEIGHTS)),
            instant_error=TICK_S / 2.0 / interval_s if self.timed and interval_s else 0.0,
            bad=self.bad_samples,
            doubt_acceleration=self.doubt_acceleration,
            coast_samples=self.coast_samples,
            samples_per_sync=self.samples_per_sync,
        )

    def chain_limits(self, interval_s: float, noise_cycles: float | None = None) -> ChainLimits:
        """The limits of :meth:`bounds`, and the limits of single samples."""
        return ChainLimits(
            **vars(self.bounds(interval_s, noise_cycles)),  # only fields: no cached property is computed yet
            sample=self.sample,
            cycles_per_revolution=self.cycles_per_revolution,
            frozen_samples=self.frozen_samples,
            coarse_limit_revolutions=self.coarse_limit_revolutions,
            corners=self.corners,
        )


def samples_per_sync(mapped: Sequence[Collection[int]]) -> int:
    """Pairs of sine and cosine for each SYNC, 1..8, from the mapping of each RPDO.

    As in the module, the count ends at the first pair that no RPDO contains.
    """
    found = itertools.takewhile(lambda pair: any(set(pair).issubset(one) for one in mapped), MODULE_PAIRS[1:])
    return 1 + sum(1 for _ in found)


def limit_settings(read: Read) -> LimitSettings:
    mapped = [pdo.entries for pdo in valid_pdos(read, od.RPDO, od.RPDO_MAPPING)]
    coast = read(od.SUPERVISION_COAST)
    return LimitSettings(
        cycles_per_revolution=int(read(od.ENCODER_CYCLES_PER_REVOLUTION) or 2500),
        sample=SampleLimits(
            int(read(od.ENCODER_FULL_SCALE) or 2048),
            int(read(od.ENCODER_LOWEST_AMPLITUDE) or 0),
            int(read(od.ENCODER_HIGHEST_AMPLITUDE) or 0),
        ),
        widest_cycles=_in_units(read(od.SUPERVISION_RESIDUAL_LIMIT), 0.5),
        acceleration_rad_s2=float(read(od.SUPERVISION_ACCELERATION) or 0.0),
        coast_samples=COAST_SAMPLES if coast is None else int(coast),
        frozen_samples=int(read(od.SUPERVISION_FROZEN) or 0),
        coarse_limit_revolutions=_in_units(read(od.SUPERVISION_COARSE_LIMIT), 1.0 / 32.0),
        noise_margin=int(read(od.SUPERVISION_NOISE_MARGIN) or 0),
        bad_samples=int(read(od.SUPERVISION_BAD_SAMPLES) or 0),
        doubt_acceleration=_in_units(read(od.SUPERVISION_DOUBT_ACCELERATION), DOUBT_ACCELERATION),
        phase_error_cycles=_in_units(read(od.SUPERVISION_PHASE_ERROR), PHASE_ERROR_CYCLES),
        sync_jitter_s=float(read(od.SUPERVISION_SYNC_JITTER) or 0.0),
        cycle_period_s=int(read(od.CYCLE_PERIOD) or 0) * 1e-6,
        samples_per_sync=samples_per_sync(mapped),
        timed=any(od.SAMPLE_TIME.mapped(32) in one for one in mapped),
        corners=Corners(
            float(read(od.ENCODER_CORNER_FREQUENCY) or 0.0),
            float(read(od.ENCODER_COSINE_CORNER_FREQUENCY) or 0.0),
        ),
    )


def _in_units(value: float | None, default: float) -> float:
    return default if value is None else value / LIMIT_UNITS
