"""Objects 2000:0E and 2014h: the position of another sensor, paired with the samples by SYNC."""

from __future__ import annotations

import math

from canfb import objects as od
from canfb.device.node import Node
from canfb.device.od.dictionary import Dictionary, refuse_if
from canfb.module.parameters import SECOND_SENSOR
from canfb.signal.chain import SignalChain
from canfb.signal.second_position import MOST_TOLERANCE_REVOLUTIONS, SecondSensor

UNCERTAIN = -1


class SecondInput:
    """Counts the values of 2000:0E between two SYNCs: with just one it belongs to the sample of the first.

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
        self._values = 0  # since the last SYNC

    @property
    def sensor(self) -> SecondSensor | None:
        values = {name: entry.value for name, entry in self._parameters.items()}
        if self.number is None or values["tolerance_revolutions"] == 0.0:
            return None
        flags = {name: bool(values[name]) for name in ("reversed", "invalidates")}
        return SecondSensor(**values | flags)

    def apply(self) -> None:
        """2014h was written: what it said is forgotten."""
        self._values = 0
        self._chain.use_second(self.sensor)

    def configure(self) -> None:
        self.number = self._node.rpdo_with(od.SAMPLE_SECOND_POSITION)
        second = self._chain.second
        if self.sensor != (None if second is None else second.sensor):
            self.apply()

    def value_received(self) -> None:
        self._values += 1

    def interval_over(self, certain: bool) -> None:
        """At a SYNC, before its sample; ``certain``: the one before it was received as well."""
        values, self._values = self._values, 0
        self._chain.hear_second(values if certain else UNCERTAIN, self._value.value)

    def difference_revolutions(self) -> float:
        """Sensor minus position; NaN: not known."""
        second = self._chain.second
        if second is None or second.difference_cycles is None:
            return math.nan
        return second.difference_cycles / float(self._cycles_per_revolution.value)
