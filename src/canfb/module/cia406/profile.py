"""The encoder profile CiA 406 of one channel (docs/encoder-profile.md)."""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import partial

from canfb import objects as od
from canfb.cia301.codes import AbortCode, SdoAbort
from canfb.device.od.dictionary import Dictionary, Entry, refuse_if
from canfb.device.storage.kept import ParameterGroup, Record
from canfb.device.storage.storage import Storage
from canfb.module.cia406.cams import Cams, show_work_area
from canfb.module.cia406.position import (
    PositionScale,
    distinguishable_revolutions,
    show_motion,
    single_turn_resolution,
)
from canfb.module.interval import SamplingInterval
from canfb.module.objects.publication import Latest

CYCLIC_TIMER = 0x6200
EVENT_TIMER = (0x1800, 5)


def make_cyclic_timer(dictionary: Dictionary, storage: Storage) -> None:
    """Make 6200h an alias of 1800:05, ms (0: off), with which it is saved."""
    timer, alias = dictionary.entry(*EVENT_TIMER), dictionary.entry(CYCLIC_TIMER)
    alias.on_read = timer.current
    alias.on_check = timer.check
    alias.on_written = lambda: timer.store(alias.value)
    alias.on_download = storage.configuration_changed
    storage.entries.leave_out(CYCLIC_TIMER)  # saved as 1800:05 already


OPERATING_TIME = 0x6508
NOT_COUNTED = 0xFFFFFFFF
UNIT_S = 360  # 0.1 h
LEAST_S = 60  # difference of times that is worth writing
_SECONDS = struct.Struct("<Q")


class OperatingTime:
    """Object 6508h: the stored time plus that since the first :meth:`begin`.

    Writing takes milliseconds: call :meth:`keep` when no SYNC is due. Without a store, 6508h reads FFFFFFFFh.
    ``now()`` is the time of the running call.
    """

    def __init__(self, dictionary: Dictionary, storage: Storage, now: Callable[[], float]) -> None:
        self._storage, self._now = storage, now
        self._since_s: float | None = None  # power-on
        self._before_s = self._kept_s = 0
        dictionary.entry(OPERATING_TIME).on_read = self._tenths

    def begin(self, now: float) -> None:
        """Begin at power-on, ``now`` (seconds); a later call, at a reset, has no effect."""
        if self._since_s is not None or not self._storage.is_there:
            return
        self._since_s = now
        records = self._storage.records(ParameterGroup.OPERATING_TIME)
        if records is None:
            return
        data = {(record.index, record.subindex): record.data for record in records}.get((OPERATING_TIME, 0))
        if data is not None and len(data) == _SECONDS.size:
            self._before_s = self._kept_s = _SECONDS.unpack(data)[0]
        else:
            self._storage.refuse(ParameterGroup.OPERATING_TIME, "it contains no time")

    def keep(self, now: float) -> None:
        """Store the time if a minute has passed; after an error of the disk, the next call tries again."""
        seconds = self._seconds(now)
        if seconds - self._kept_s < LEAST_S:
            return
        record = Record(OPERATING_TIME, 0, False, _SECONDS.pack(seconds))

        def done(error: OSError | None) -> None:
            if error is None:
                self._kept_s = seconds

        self._storage.save_records(ParameterGroup.OPERATING_TIME, [record], done)

    def _seconds(self, now: float) -> int:
        since = now if self._since_s is None else self._since_s
        return self._before_s + max(0, int(now - since))

    def _tenths(self) -> int:
        if self._since_s is None:
            return NOT_COUNTED
        return min(self._seconds(self._now()) // UNIT_S, NOT_COUNTED - 1)


ALARM_POSITION, ALARM_PARAMETERS = 1 << 0, 1 << 12  # 6503h
STANDSTILL_CYCLES = 0.05  # largest speed at a preset, cycles per sample


class EncoderProfile:
    """Objects 6000h to 650Bh from the feedback of a signal chain, computed when they are read.

    Cams, work area, speed and acceleration are those of the last valid position.
    """

    def __init__(
        self,
        dictionary: Dictionary,
        interval: SamplingInterval,
        latest: Latest,
        withheld: Callable[[], bool],
    ) -> None:
        entry = dictionary.entry
        self._operating = entry(*od.OPERATING_PARAMETERS)
        self._units_per_rev, self._range = entry(*od.UNITS_PER_REVOLUTION), entry(*od.TOTAL_RANGE)
        self._position, self._fine = entry(*od.POSITION_VALUE), entry(*od.HIGH_PRECISION_POSITION)
        self._status, self.alarms = entry(0x6500), entry(0x6503)
        self._resolution = entry(*od.SINGLE_TURN_RESOLUTION)
        self._revolutions = entry(*od.DISTINGUISHABLE_REVOLUTIONS)
        self._offset = entry(*od.OFFSET_VALUE)
        self._cycles_per_revolution = entry(*od.ENCODER_CYCLES_PER_REVOLUTION)
        self._latest, self._withheld = latest, withheld
        self._presets = entry(*od.PRESET_VALUE), entry(*od.HIGH_PRECISION_PRESET)
        for preset in self._presets:
            preset.on_written = partial(self._preset, preset)
        entry(0x600C).on_read = self._raw_position
        self._operating.on_check = refuse_if(
            lambda value: value & ~int(od.OperatingParameter.CODE_SEQUENCE | od.OperatingParameter.SCALING)
        )
        for changed in (self._operating, self._units_per_rev, self._range):
            changed.on_written = self.rescale
        self._module_range = entry(0x650A, 2), entry(0x650A, 3)
        self.cams = Cams(dictionary, self._valid_position)
        show_work_area(dictionary, self._valid_position, lambda: self.scale.total_range)
        show_motion(dictionary, interval, lambda: latest.valid, lambda: self.scale)
        self.reset()

    def reset(self) -> None:
        self.alarms.value = 0
        self.rescale()

    def rescale(self) -> None:
        cycles = self._cycles_per_revolution.value
        self._resolution.value = resolution = single_turn_resolution(cycles)
        self._revolutions.value = revolutions = distinguishable_revolutions(resolution)
        scaling = self._operating.value & od.OperatingParameter.SCALING
        self.scale = PositionScale(
            cycles,
            self._units_per_rev.value if scaling else resolution,
            self._range.value if scaling else resolution * revolutions,
            bool(self._operating.value & od.OperatingParameter.CODE_SEQUENCE),
            self._offset.value,
        )
        self._raw_scale = PositionScale(cycles, resolution, resolution * revolutions, False, 0)
        self._status.value = self._operating.value
        # INTEGER32 objects for an UNSIGNED32 range: saturated, not wrapped.
        self._module_range[0].value = 0
        self._module_range[1].value = min(self.scale.total_range - 1, 0x7FFFFFFF)
        self._moved()

    def _moved(self) -> None:
        self.cams.configure(self.scale.total_range)
        last = self._latest.feedback
        if last is not None:
            self._position.value = self._fine.value = self.scale.position(*self._latest.place(last))

    def alarm(self, bit: int, active: bool) -> None:
        self.alarms.value = self.alarms.value & ~bit | (bit if active else 0)

    def _valid_position(self) -> int | None:
        last = self._latest.valid
        return None if last is None else self.scale.position(*self._latest.place(last))

    def _raw_position(self) -> int:
        last, scale = self._latest.feedback, self._raw_scale
        return 0 if last is None else scale.units(*self._latest.place(last)) % scale.total_range

    def _preset(self, written: Entry) -> None:
        value = written.value
        if value >= self.scale.total_range:
            raise SdoAbort(AbortCode.INVALID_VALUE)
        last = self._latest.feedback
        # Without SYNC, or with a sample that was not used, the machine may have moved.
        outdated = self.alarms.value & ALARM_POSITION or self._withheld()
        if last is None or not last.valid or outdated or abs(last.speed_cycles) > STANDSTILL_CYCLES:
            raise SdoAbort(AbortCode.DEVICE_STATE)
        self._offset.value = self.scale.offset = self.scale.offset_for(*self._latest.place(last), value)
        for preset in self._presets:  # the same value as UNSIGNED32 and UNSIGNED64
            preset.value = value
        self._moved()
