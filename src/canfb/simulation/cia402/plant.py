"""The plant of the simulated drive: a motor that turns in true time, and the encoder on its shaft."""

from __future__ import annotations

from canfb.cia301 import cob
from canfb.cia301.frame import Frame
from canfb.interface.sample_instants import TRUE_TIME, TimeBase
from canfb.signal.sample import Sample
from canfb.simulation.cia402.coupling import Coupling
from canfb.simulation.cia402.motor import Motor
from canfb.simulation.encoder import Encoder
from canfb.simulation.shaft_encoder import ShaftEncoder


class Plant:
    """A motor that turns in true time, from the first SYNC on, also while no SYNC comes.

    ``time_base`` (a :class:`canfb.interface.sample_instants.TimeBase`) need not be true time: all times
    of the plant are of that.

    It sends nothing, but must hear the SYNC before those who sample or drive it: attach it first.
    ``syncs`` counts them.
    """

    def __init__(self, motor: Motor) -> None:
        self.motor = motor
        self.syncs = 0
        self.time_base: TimeBase = TRUE_TIME
        self._now_s: float | None = None  # time up to which the motor has turned

    def start(self, now: float) -> list[Frame]:
        """Power-on at ``now``: there is nothing to send."""
        return []

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        """Go on to the time at which a SYNC was heard; with the first one the machine begins."""
        if frame.can_id == cob.SYNC and not frame.rtr:
            received_s = self.time_base.received_at(frame, now)
            if self._now_s is None:
                self._now_s = received_s
            self.go_on_to(received_s)
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
        self.go_on_to(now)
        self.motor.command_nm = torque_nm if powered else 0.0
        if not powered:
            self.motor.torque_nm = 0.0  # the power stage is off: no current flows
        self.motor.braked = not powered

    def go_on_to(self, now: float) -> None:
        """Turn until ``now``; a time that is over changes nothing, nor does one before the first SYNC."""
        if self._now_s is not None and now > self._now_s:
            self.motor.run(now - self._now_s)
            self._now_s = now

    def ahead_s(self, now: float) -> float:
        """How far the motor has turned beyond ``now``, seconds: a SYNC may be handled after a torque."""
        return 0.0 if self._now_s is None else max(0.0, self._now_s - now)


class PlantSource:
    """The encoder on the shaft of a plant; ``position_cycles`` is the true position of the last sample.

    ``coupling`` is between the motor and the encoder.
    """

    def __init__(
        self,
        encoder: Encoder,
        plant: Plant,
        cycles_per_revolution: int,
        seed: int = 1,
        aperture_jitter_s: float = 0.0,
        coupling: Coupling | None = None,
    ) -> None:
        self._shaft = ShaftEncoder(encoder, cycles_per_revolution, seed, aperture_jitter_s)
        self._plant, self._coupling = plant, coupling or Coupling()
        self._last_s = 0.0
        self._last_revolutions = plant.motor.revolutions - self._coupling.slipped(0.0)

    @property
    def position_cycles(self) -> float:
        """True position of the last sample, cycles."""
        return self._shaft.position_cycles

    def sample_at(self, now: float) -> Sample:
        """The sample at the true time ``now``, seconds."""
        self._plant.go_on_to(now)
        return self._sample(self._plant.ahead_s(now))

    def next(self) -> Sample:
        """The sample at the time of the plant."""
        return self._sample(0.0)

    def _sample(self, ahead_s: float) -> Sample:
        """A sample this many seconds before the time of the plant."""
        motor = self._plant.motor
        time_s = motor.time_s - ahead_s
        from_s, start = self._last_s, self._last_revolutions
        end = motor.revolutions_before(ahead_s) - self._coupling.slipped(time_s)

        def between(at_s: float) -> float:
            """Straight from sample to sample; about the sample itself with the speed of the motor."""
            if not from_s < at_s < time_s:
                return motor.revolutions_before(motor.time_s - at_s) - self._coupling.slipped(at_s)
            return start + (end - start) * (at_s - from_s) / (time_s - from_s)

        self._last_s, self._last_revolutions = time_s, end
        return self._shaft.sample(time_s, between)
