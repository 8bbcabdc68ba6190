"""State of a feedback module from its PDOs, and meters of a bus. Times in seconds."""

from __future__ import annotations

import math
import operator
import statistics
from collections import deque
from collections.abc import Callable
from itertools import pairwise

from canfb import objects as od
from canfb.monitoring.layout import INPUTS, VALUES, NodeLayout, known_values
from canfb.monitoring.snapshot import LoadSnapshot, ModuleSnapshot, SyncSnapshot
from canfb.signal.residual_noise import REFERENCE_BLOCKS
from canfb.timing.syncs import Syncs
from canfb.view.module_view import LIMIT_UNITS, Number, Pdo

SYNCS = 512  # most SYNCs used for the rate
LEAST = 4  # SYNCs for a rate; positions for a velocity: three steps, of which both extremes are dropped
OLDEST_S = 2.0
MISSING_PERIODS = 8.0  # after this many periods without a SYNC, there is none
LEAST_SILENCE_S = 0.1
SLOT_S = 0.1
SLOTS = 10


class SyncMeter:
    """Rate and jitter from the straight line through the last good SYNCs."""

    def __init__(self) -> None:
        self._syncs = Syncs()
        self._places: deque[tuple[float, int]] = deque(maxlen=SYNCS)
        self._last_s: float | None = None
        self._count = 0

    def sync(self, time_s: float) -> None:
        places = self._places
        if self._last_s is not None and not 0.0 <= time_s - self._last_s <= self._longest_s:
            self._syncs.forget()
            places.clear()
        self._last_s = time_s
        self._count += 1
        verdict = self._syncs.sync(time_s, True, None)
        if verdict.doubt:  # rate or phase may have changed
            places.clear()
        if self._syncs.grid.period and not verdict.extra:
            places.append((time_s, places[-1][1] + 1 + verdict.lost if places else 0))

    @property
    def _longest_s(self) -> float:
        period_s = self._syncs.grid.period
        return max(LEAST_SILENCE_S, MISSING_PERIODS * period_s) if period_s else math.inf

    def snapshot(self, now: float) -> SyncSnapshot:
        if self._last_s is None:
            return SyncSnapshot()
        silent_s = max(0.0, now - self._last_s)
        recent = _recent([*self._places], now, OLDEST_S)
        if len(recent) < LEAST or silent_s > self._longest_s:
            return SyncSnapshot(silent_s=silent_s, count=self._count)
        times, places = zip(*recent, strict=True)
        line = statistics.linear_regression(places, times)
        errors = [time - line.intercept - place * line.slope for time, place in recent]
        rms_s = math.sqrt(sum(error * error for error in errors) / len(errors))
        return SyncSnapshot(1.0 / line.slope, rms_s, max(map(abs, errors)), silent_s, self._count)


def _recent(known: list[tuple[float, int]], now: float, most_s: float) -> list[tuple[float, int]]:
    # Not older than `most_s`, but at least the last LEAST ones.
    return [one for one in known[:-LEAST] if now - one[0] <= most_s] + known[-LEAST:]


class Bins:
    """One value for each of the last ``count`` intervals of ``width_s``."""

    def __init__(self, width_s: float, count: int, join: Callable[[float, float], float]) -> None:
        self.width_s, self._count, self._join = width_s, count, join
        self._bins: deque[tuple[int, float]] = deque(maxlen=count)

    def number(self, now: float) -> int:
        return math.floor(now / self.width_s)

    def add(self, value: float, now: float) -> None:
        number = self.number(now)
        if self._bins and self._bins[-1][0] >= number:
            last, before = self._bins[-1]
            self._bins[-1] = last, self._join(before, value)
        else:
            self._bins.append((number, value))

    def values(self, now: float) -> list[float | None]:
        if not self._bins:
            return []
        last, known = self.number(now), dict(self._bins)
        first = max(self._bins[0][0], last - self._count + 1)
        return [known.get(number) for number in range(first, last + 1)]


class LoadMeter:
    """Bits and frames of the last second."""

    def __init__(self, bit_rate: int | None = None) -> None:
        self.bit_rate = bit_rate
        self._bits, self._frames = (Bins(SLOT_S, SLOTS + 1, operator.add) for _ in range(2))

    def frame(self, bits: int, now: float) -> None:
        self._bits.add(bits, now)
        self._frames.add(1, now)

    def snapshot(self, now: float) -> LoadSnapshot:
        slots = [bins.values(now)[:-1] for bins in (self._bits, self._frames)]
        bits, frames = (sum(value or 0 for value in one) / (max(1, len(one)) * SLOT_S) for one in slots)
        return LoadSnapshot(frames, bits, self.bit_rate, bits / self.bit_rate if self.bit_rate else None)


HISTORY_BIN_S, HISTORY_BINS = 0.5, 120  # a minute in total
PEAK_BINS = 3  # bins of the last second: the open one and two before it
TRACKS = 400  # number of pairs of counts that are kept
SPEED_S = 0.25  # time over which the velocity is measured
STEP_S = 0.01  # shortest time between two positions kept for the velocity
FRESH_S = 2.0  # an older velocity is not shown
WORDS = 1 << 32
LOST = od.COUNTERS[od.COUNTER_LOST]


class ModuleModel:
    """Processes the PDOs of one module; memory is bounded."""

    def __init__(self, layout: NodeLayout) -> None:
        self.layout = layout
        self._values: dict[od.Multiplexer, Number] = {}
        self._times: dict[od.Multiplexer, float] = {}
        self._noises: list[Number] = []
        self._history = Bins(HISTORY_BIN_S, HISTORY_BINS, max)
        self._tracks: deque[tuple[int, int]] = deque(maxlen=TRACKS)
        self._tracks_received = 0
        self._positions: deque[tuple[float, int]] = deque(maxlen=round(SPEED_S / STEP_S) + 1)
        self._counted = dict.fromkeys((*(od.COUNTERS[place] for place in od.COUNTED), LOST), 0)
        self._state: od.PositionState | None = None
        self._came_s: float | None = None
        self._fault_s: float | None = None

    def sent(self, pdo: Pdo, data: bytes, now: float) -> bool:
        """Process a TPDO; False: too short."""
        values = known_values(pdo, data, VALUES)
        for place, value in values.items():
            self.put(place, value, now)
        if (status := values.get(od.FEEDBACK_STATUS)) is not None:
            self._count(int(status), now)
        if (residual := values.get(od.FEEDBACK_RESIDUAL)) is not None:
            self._history.add(residual / LIMIT_UNITS, now)
        if (position := values.get(od.POSITION_VALUE)) is not None:
            self._came_s = now
            self._follow(int(position), now)
        return bool(values)

    def sampled(self, pdo: Pdo, data: bytes, now: float) -> None:
        values = known_values(pdo, data, INPUTS)
        if od.SAMPLE_SINE in values and od.SAMPLE_COSINE in values:
            self._tracks.append((int(values[od.SAMPLE_SINE]), int(values[od.SAMPLE_COSINE])))
            self._tracks_received += 1

    def put(self, place: od.Multiplexer, value: Number, now: float) -> None:
        """Store a value of :data:`.VALUES`, from PDO or SDO."""
        if place == od.FEEDBACK_NOISE and value != self._values.get(place):
            self._noises = [*self._noises, value][-REFERENCE_BLOCKS:] if value else []
        self._values[place], self._times[place] = value, now

    def _count(self, status: int, now: float) -> None:
        self._came_s = now
        before, self._state = self._state, od.position_state(status)
        for place, bits in od.COUNTED.items():
            self._counted[od.COUNTERS[place]] += bool(status & bits)
        self._counted[LOST] += self._state is od.PositionState.LOST and before is not od.PositionState.LOST
        if self._state is not od.PositionState.VALID:
            self._fault_s = now
            self._positions.clear()

    def _follow(self, position: int, now: float) -> None:
        known = self._state in (None, od.PositionState.VALID)
        if known and (not self._positions or now - self._positions[-1][0] >= STEP_S):
            self._positions.append((now, position))

    def snapshot(self, now: float, sync_hz: float | None = None) -> ModuleSnapshot:
        layout, values = self.layout, self._values
        sample = layout.supervision.sample
        status = values.get(od.FEEDBACK_STATUS)
        state = None if status is None else od.position_state(int(status))
        units, residual = values.get(od.POSITION_VALUE), values.get(od.FEEDBACK_RESIDUAL)
        per_revolution = layout.units_per_revolution
        amplitude = values.get(od.FEEDBACK_AMPLITUDE)
        crc32 = values.get(od.TABLE_ACTIVE_CRC)
        velocity, assumed = self._measured_velocity(now), set(layout.assumed)
        if velocity is None:
            velocity = self._velocity_of_positions(now)
        else:
            assumed.discard("velocity_rad_s")
        if layout.supervision.noise_margin and od.FEEDBACK_NOISE not in values:
            assumed.add("residual_limit_cycles")
        noise = values.get(od.FEEDBACK_NOISE, 0) / LIMIT_UNITS or None
        raw = amplitude is None and bool(self._tracks)
        cause, history = od.loss_cause(values.get(od.COUNTER_LOSS_CAUSE)), self._history.values(now)
        return ModuleSnapshot(
            layout=str(layout.origin),
            age_s=_since(self._came_s, now),
            position_state=None if state is None else str(state),
            status=None if status is None else int(status),
            faults=[] if status is None else od.fault_words(int(status)),
            referenced=bool(int(status or 0) & od.StatusBit.REFERENCED),
            table_active=bool(int(status or 0) & od.StatusBit.TABLE_ACTIVE),
            table_crc32=None if crc32 is None else int(crc32),
            position_units=None if units is None else int(units),
            position_revolutions=units / per_revolution if units is not None and per_revolution else None,
            velocity_rad_s=velocity,
            residual_cycles=None if residual is None else residual / LIMIT_UNITS,
            # As in the module by the largest of so many blocks; 2011:0B is that of the last one.
            residual_limit_cycles=layout.supervision.limit_cycles(
                sync_hz, max(self._noises, default=0) / LIMIT_UNITS or None, velocity
            ),
            residual_noise_cycles=noise,
            residual_peak_cycles=max((one for one in history[-PEAK_BINS:] if one is not None), default=None),
            residual_history_cycles=history,
            history_bin_s=self._history.width_s,
            amplitude_counts=math.hypot(*self._tracks[-1]) if raw else amplitude,
            amplitude_is_raw=raw,
            amplitude_limits_counts=(int(sample.amplitude_low_counts), int(sample.amplitude_high_counts)),
            full_scale_counts=sample.full_scale_counts,
            tracks_counts=list(self._tracks),
            tracks_heard=self._tracks_received,
            seen=dict(self._counted),
            lost_by=cause.text if cause is not None and state is od.PositionState.LOST else None,
            since_fault_s=_since(self._fault_s, now),
            counters={name: int(values[place]) for place, name in od.COUNTERS.items() if place in values},
            assumed=sorted(assumed),
        )

    def _measured_velocity(self, now: float) -> float | None:
        measured = self._values.get(od.FEEDBACK_VELOCITY, math.nan)
        if not math.isfinite(measured) or now - self._times[od.FEEDBACK_VELOCITY] > FRESH_S:
            return None
        return -float(measured) if self.layout.reversed else float(measured)

    def _velocity_of_positions(self, now: float) -> float | None:
        positions, per_revolution = [*self._positions], self.layout.units_per_revolution
        if len(positions) < 2 or not per_revolution or now - positions[-1][0] > FRESH_S:
            return None
        total = self.layout.total_range or WORDS
        half, recent = total // 2, _recent(positions, positions[-1][0], SPEED_S)
        steps = sorted(
            (((after - before + half) % total - half) / (after_s - before_s), after_s - before_s)
            for (before_s, before), (after_s, after) in pairwise(recent)
        )
        # A preset looks like a very fast step: drop the extreme steps.
        speeds, times_s = zip(*(steps[1:-1] or steps), strict=True)
        return statistics.fmean(speeds, times_s) / per_revolution * 2.0 * math.pi


def _since(time_s: float | None, now: float) -> float | None:
    return None if time_s is None else max(0.0, now - time_s)
