"""The input of a plan: a bus, its SYNC, its modules, and the motion of their encoders."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

from canfb.planning.bus_load import BusLoad, in_order
from canfb.planning.planned_module import PlannedModule
from canfb.planning.traffic import (
    HEARTBEAT,
    Message,
    Values,
    adc_messages,
    heartbeat_message,
    node_messages,
    sync_message,
)

ROUNDED_AMPLITUDE = 0.75  # of full scale, as the simulated encoder has it


@dataclass(frozen=True, kw_only=True)
class StatedMotion:
    """Motion that the encoders have to follow; None: not given.

    speed_rad_s            largest speed
    acceleration_rad_s2    largest acceleration
    jerk_rad_s3            largest jerk; None: the acceleration steps from 0 to its largest value
    is_final               no module has to follow more, whatever its 2010:02 says
    where                  who says so, for people
    """

    speed_rad_s: float | None = None
    acceleration_rad_s2: float | None = None
    jerk_rad_s3: float | None = None
    is_final: bool = False
    where: str = ""

    def acceleration_of(self, module: PlannedModule) -> float | None:
        """What this module has to follow: the largest acceleration of its machine counts, too."""
        known = module.known_acceleration_rad_s2
        if self.is_final or not known:
            return self.acceleration_rad_s2
        return max(known, self.acceleration_rad_s2 or 0.0)

    def jerk_of(self, module: PlannedModule) -> float | None:
        """The largest jerk of the machine of this module; None: neither stated nor in 2010:08."""
        return self.jerk_rad_s3 if self.jerk_rad_s3 is not None else module.known_jerk_rad_s3 or None


@dataclass(frozen=True, kw_only=True)
class EncoderErrors:
    """What makes residuals without any motion.

    noise_counts     rms noise of a track before the ADC, counts
    amplitude        of the tracks, relative to full scale
    phase_cycles     largest error of a phase that enters eq. 9; None: that of the module with its table,
                     or without
    """

    noise_counts: float = 0.5
    amplitude: float = ROUNDED_AMPLITUDE
    phase_cycles: float | None = None


@dataclass(frozen=True, kw_only=True)
class Situation:
    """All that a plan depends on.

    bit_rate        bit/s, 10000..1000000
    sync_hz         SYNC rate
    jitter_s        of the SYNC at its producer, +-
    aperture_s      of the instant at which the tracks are held, +-, whatever the sample time says
    extra_load      of frames of other nodes, 0..1
    heartbeat_s     of every node, 0.0: as each node has it
    modules         at least one
    others          further nodes, by node-ID: their objects
    """

    bit_rate: int
    sync_hz: float
    modules: tuple[PlannedModule, ...]
    motion: StatedMotion
    errors: EncoderErrors = field(default_factory=EncoderErrors)
    jitter_s: float = 0.0
    aperture_s: float = 0.0
    extra_load: float = 0.0
    heartbeat_s: float = 0.0
    others: tuple[tuple[int, Values], ...] = ()

    @cached_property
    def bus(self) -> BusLoad:
        """The frames on the bus."""
        messages: list[Message] = [sync_message(self.modules[0].values)]
        for module in self.modules:
            messages += self._beating(module.node_id, module.values, sampled=True)
            messages += [] if module.samples_itself else adc_messages(module.values)
        for node_id, values in self.others:
            messages += self._beating(node_id, values, sampled=False)
        return BusLoad(self.bit_rate, self.sync_hz, in_order(messages), self.extra_load)

    def _beating(self, node_id: int, values: Values, *, sampled: bool) -> list[Message]:
        found = node_messages(values, node_id, sampled=sampled)
        if self.heartbeat_s and not values.get(HEARTBEAT):
            found.append(heartbeat_message(node_id, self.heartbeat_s))
        return found
