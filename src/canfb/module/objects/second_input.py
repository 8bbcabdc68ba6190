"""Objects 2000:0E and 2014h: the position of another sensor, paired with the samples by SYNC."""

from __future__ import annotations

import math
from typing import Any

from canfb import objects as od
from canfb.cia301.codes import AbortCode, SdoAbort
from canfb.device.node import Node
from canfb.device.od.dictionary import Dictionary
from canfb.signal.chain import SignalChain
from canfb.signal.second_position import MOST_TOLERANCE_REVOLUTIONS, SecondSensor

UNCERTAIN = -1


class SecondInput:
    """Counts the values of 2000:0E between two SYNCs: with just one it belongs to the sample of the first.

    In use while an RPDO brings 2000:0E and the tolerance 2014:04 is above 0. What it says of the position is
    then forgotten with each write to 2014h.
    """

    def __init__(self, dictionary: Dictionary, node: Node, chain: SignalChain) -> None:
        entry = dictionary.entry
        self._node, self._chain = node, chain
        self._value = entry(*od.SAMPLE_SECOND_POSITION)
        self._increments, self._revolutions = entry(*od.SECOND_INCREMENTS), entry(*od.SECOND_REVOLUTIONS)
        self._reversed, self._tolerance = entry(*od.SECOND_REVERSED), entry(*od.SECOND_TOLERANCE)
        self._invalidates = entry(*od.SECOND_INVALIDATES)
        self._tolerance.on_check = _check_tolerance
        for written in (
            self._increments,
            self._revolutions,
            self._reversed,
            self._tolerance,
            self._invalidates,
        ):
            written.on_written = self.apply
        self._cycles_per_revolution = entry(*od.ENCODER_CYCLES_PER_REVOLUTION)
        entry(*od.SECOND_DIFFERENCE).on_read = self.difference_revolutions
        self.number: int | None = None
        """The RPDO that brings 2000:0E; None: none does."""
        self._values = 0  # since the last SYNC

    @property
    def sensor(self) -> SecondSensor | None:
        """The sensor of 2014h, None while it is not in use."""
        if self.number is None or self._tolerance.value == 0.0:
            return None
        return SecondSensor(
            increments=self._increments.value,
            revolutions=self._revolutions.value,
            reversed=bool(self._reversed.value),
            tolerance_revolutions=self._tolerance.value,
            invalidates=bool(self._invalidates.value),
        )

    def apply(self) -> None:
        """Take over 2014h; nothing is known of the sensor then."""
        self._values = 0
        self._chain.use_second(self.sensor)

    def configure(self) -> None:
        """PDO parameters or the NMT state have changed: which RPDO brings the value."""
        self.number = self._node.rpdo_with(od.SAMPLE_SECOND_POSITION)
        second = self._chain.second
        if self.sensor != (None if second is None else second.sensor):
            self.apply()

    def value_received(self) -> None:
        """RPDO :attr:`number` has come, or is taken over at a SYNC."""
        self._values += 1

    def interval_over(self, certain: bool) -> None:
        """At a SYNC, before its sample. ``certain``: the one before it was received as well."""
        values, self._values = self._values, 0
        self._chain.hear_second(values if certain else UNCERTAIN, self._value.value)

    def difference_revolutions(self) -> float:
        """How much further the sensor stands than the position, revolutions; NaN while that is not known."""
        second = self._chain.second
        if second is None or second.difference_cycles is None:
            return math.nan
        return second.difference_cycles / float(self._cycles_per_revolution.value)


def _check_tolerance(value: Any) -> None:
    if not 0.0 <= value <= MOST_TOLERANCE_REVOLUTIONS:
        raise SdoAbort(AbortCode.INVALID_VALUE)
