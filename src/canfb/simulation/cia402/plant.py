"""The plant of the simulated drive: a motor that moves with the SYNC, and the encoder on its shaft."""

from __future__ import annotations

import numpy as np

from canfb.device.frame import Frame
from canfb.signal.sample import Sample
from canfb.simulation.cia402.interval import SyncInterval
from canfb.simulation.cia402.motor import Motor
from canfb.simulation.encoder import Encoder
from canfb.simulation.sync_producer import SYNC_COB_ID


class Plant:
    """A motor whose time goes on with the SYNC: one interval passes from each to the next.

    It sends nothing, but must hear the SYNC before those who sample or drive it: attach it first.
    ``interval_s`` is that of the SYNC in seconds; None measures it. A program hears a SYNC late now and
    then, and a real one is far more regular than that; so the machine goes by the number of SYNCs. It
    stands still while there are none.
    """

    def __init__(self, motor: Motor, interval_s: float | None = None) -> None:
        if interval_s is not None and not 0.0 < interval_s < 1e6:
            raise ValueError(f"interval_s must be a time in seconds, more than 0, not {interval_s!r}")
        self.motor = motor
        self.syncs = 0
        self._fixed_s = interval_s
        self._measured = SyncInterval()
        self._passed_s = 0.0  # since the last SYNC

    @property
    def interval_s(self) -> float:
        """The time between two SYNCs, seconds; 0.0 while it is not known."""
        return self._measured.seconds if self._fixed_s is None else self._fixed_s

    def start(self, now: float) -> list[Frame]:
        """Power-on at ``now``: there is nothing to send."""
        return []

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        """Go on to the next sampling instant with each SYNC."""
        if frame.can_id == SYNC_COB_ID and not frame.rtr:
            heard_before = self._measured.last_s is not None
            self._measured.event(now)
            if heard_before:
                self._go_on_to(self.interval_s)
            self._passed_s = 0.0
            self.syncs += 1
        return []

    def tick(self, now: float) -> list[Frame]:
        """Nothing is ever due."""
        return []

    def deadline(self) -> float | None:
        """No time is waited for."""
        return None

    def drive(self, torque_nm: float, powered: bool, now: float) -> None:
        """From ``now`` on the motor is driven with this torque; without power the brake is closed."""
        last = self._measured.last_s
        if last is not None:
            self._go_on_to(min(max(0.0, now - last), self.interval_s))
        self.motor.command_nm = torque_nm if powered else 0.0
        if not powered:
            self.motor.torque_nm = 0.0  # the power stage is off: no current flows
        self.motor.braked = not powered

    def _go_on_to(self, since_sync_s: float) -> None:
        if since_sync_s > self._passed_s:
            self.motor.run(since_sync_s - self._passed_s)
            self._passed_s = since_sync_s


class PlantSource:
    """The encoder on the shaft of a plant, sampled at each SYNC; ``position_cycles`` is the true position."""

    def __init__(self, encoder: Encoder, plant: Plant, cycles_per_revolution: int, seed: int = 1) -> None:
        self._encoder = encoder
        self._motor = plant.motor
        self._cycles_per_revolution = cycles_per_revolution
        self._rng = np.random.default_rng(seed)
        self.position_cycles = 0.0

    def next(self) -> Sample:
        """The sample at the time of the plant."""
        self.position_cycles = self._motor.revolutions * self._cycles_per_revolution
        sine, cosine = self._encoder.sample(self.position_cycles, self._rng)
        return Sample(int(sine), int(cosine))
