"""What a signal chain has to do with another sensor of the machine: one call where it matters."""

from __future__ import annotations

from canfb.signal.recovery.reference import Reference
from canfb.signal.recovery.second_opinion import SecondOpinion
from canfb.signal.second_position import SecondSensor


class SecondListener:
    """A chain with a ``_reference`` that may hear another sensor; without one nothing happens here."""

    _reference: Reference
    _second: SecondOpinion | None = None
    _nothing_in_doubt = False  # the next sample may be a usual one

    @property
    def begun(self) -> bool:
        """There was a sample since the start."""
        raise NotImplementedError

    @property
    def second(self) -> SecondOpinion | None:
        """Comparison with another sensor, None without one."""
        return self._second

    def use_second(self, sensor: SecondSensor | None) -> None:
        """Take another sensor from now on, or none; nothing is known of it. TypeError if it is not one."""
        if sensor is not None and not isinstance(sensor, SecondSensor):
            raise TypeError(f"sensor must be a SecondSensor or None, not {type(sensor).__name__}")
        self._nothing_in_doubt = False
        self._second = None if sensor is None else SecondOpinion(sensor, self._reference, self.begun)

    def hear_second(self, values: int, increments: int) -> None:
        """An interval of SYNC is over in which so many ``values`` of the other sensor came.

        With just one, its ``increments`` (INTEGER32) are those at the sample before this call. -1: it is not
        certain which ones came.
        """
        if self._second is not None:
            self._second.hear(values, increments)

    def _renew_second(self) -> None:
        """The reference is another one: nothing is known of the sensor any more."""
        if self._second is not None:
            self.use_second(self._second.sensor)

    def _restart_second(self, keep: bool = False, known: bool = False) -> None:
        """As :meth:`SecondOpinion.restart`."""
        if self._second is not None:
            self._second.restart(keep, known)

    def _miss_second(self, bits: int) -> int:
        """Status bits of an interval without a sample."""
        return bits if self._second is None else self._second.missed(bits)
