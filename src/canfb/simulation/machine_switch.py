"""Stopping and starting the simulated machine while its encoder interface stays on the bus.

A position that was lost comes back after a restart at standstill, so there must be a way to have standstill
without a restart of the simulation. It is an object of the interface, 2060h: it works over the bus, with the
tools and masters of others as well. A signal or a line on stdin would work only beside the process.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from canfb.cia301.codes import AbortCode, SdoAbort
from canfb.interface.encoder_interface import EncoderInterface
from canfb.objects import INTERFACE_MACHINE, MachineCommand
from canfb.signal.phase import FloatArray
from canfb.sources.motion_source import MotionSource, ShaftMotion


class _Change(NamedTuple):
    """From ``time_s`` on the rate goes to ``end_rate``; the motion was at its own time ``reached_s`` then."""

    time_s: float
    reached_s: float
    rate: float
    end_rate: float


class StoppableMotion:
    """A motion whose own time can be brought to a halt, and on again, within ``ramp_s`` seconds each.

    So it stops with the acceleration of a ramp of that length from its speed, and goes on where it was.
    Times before keep their positions.
    """

    def __init__(self, motion: ShaftMotion, ramp_s: float) -> None:
        self._motion, self._ramp_s = motion, ramp_s
        self._changes: list[_Change] = []

    @property
    def running(self) -> bool:
        """It runs, or is to run."""
        return not self._changes or self._changes[-1].end_rate > 0.0

    def run(self, running: bool, time_s: float) -> None:
        """Begin to run, or to stop, at ``time_s`` of the machine."""
        if running == self.running:
            return
        if self._changes:
            time_s = max(time_s, self._changes[-1].time_s)
        reached_s, rate = self._state(time_s)
        self._changes.append(_Change(time_s, reached_s, rate, float(running)))

    def revolutions(self, time_s: float) -> float:
        """Position at ``time_s`` of the machine, revolutions."""
        return self._motion.revolutions(self._state(time_s)[0] if self._changes else time_s)

    def revolutions_at(self, times_s: FloatArray) -> FloatArray:
        """:meth:`revolutions` for an array of times."""
        if self._changes:
            times_s = np.array([self._state(float(time_s))[0] for time_s in times_s])
        return self._motion.revolutions_at(times_s)

    def _state(self, time_s: float) -> tuple[float, float]:
        """The own time of the motion at ``time_s``, seconds, and its rate, 0..1."""
        change = next((one for one in reversed(self._changes) if one.time_s <= time_s), None)
        if change is None:
            return time_s, 1.0
        passed = time_s - change.time_s
        step = change.end_rate - change.rate
        ramp_s = self._ramp_s * abs(step)
        if passed >= ramp_s:
            after_s = (passed - ramp_s) * change.end_rate
            return change.reached_s + ramp_s * (change.rate + step / 2.0) + after_s, change.end_rate
        rate = change.rate + step * passed / ramp_s
        return change.reached_s + passed * (change.rate + rate) / 2.0, rate


class MachineSwitch:
    """Object 2060h of the interface: 1 lets its machine run, 0 stops it. It reads as what was written.

    A source whose machine cannot be stopped here (a recording, a drive) refuses it: 08000022h.
    """

    def __init__(self, interface: EncoderInterface) -> None:
        entry, source = interface.dictionary.entry(*INTERFACE_MACHINE), interface.source
        self._source = source if isinstance(source, MotionSource) else None
        motion = None if self._source is None else self._source.motion
        self._motion = motion if isinstance(motion, StoppableMotion) else None
        self._entry, self._now = entry, interface.machine_now
        entry.on_check = self._check
        entry.on_written = self._obey
        entry.on_read = lambda: int(self._motion is None or self._motion.running)

    def _check(self, value: int) -> None:
        if self._motion is None:
            raise SdoAbort(AbortCode.DEVICE_STATE)

    def _obey(self) -> None:
        if self._motion is not None and self._source is not None:
            running = self._entry.value == MachineCommand.START
            self._motion.run(running, self._source.machine_time(self._now()))
