"""A module and its encoder interface: active table, limits, source of samples."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

from canfb import objects as od
from canfb.calibration.over_speeds import counts_at
from canfb.master.access import CommissioningError, Master, NodeAccess, Progress
from canfb.master.all_or_nothing import read_active
from canfb.master.machine_watch import Provenance, check_valid
from canfb.master.samples import Listener, TrackSamples, listen, record
from canfb.signal.chain_config import ChainLimits
from canfb.signal.correction import Correction
from canfb.signal.front_end import Corners
from canfb.signal.limits import MOST_IN_A_ROW
from canfb.signal.supervision import SampleLimits
from canfb.view.module_view import (
    LIMIT_UNITS,
    LimitSettings,
    Number,
    PdoLayout,
    interface_layout,
    limit_settings,
    module_layout,
)

AMPLITUDES = (od.ENCODER_LOWEST_AMPLITUDE, od.ENCODER_HIGHEST_AMPLITUDE)


class LimitObject(NamedTuple):
    """The object of a limit; ``layout`` as in struct."""

    place: od.Multiplexer
    layout: str
    name: str
    unit: str


LIMITS = (
    LimitObject(od.ENCODER_LOWEST_AMPLITUDE, "H", "lowest amplitude", "counts"),
    LimitObject(od.ENCODER_HIGHEST_AMPLITUDE, "H", "highest amplitude", "counts"),
    LimitObject(od.SUPERVISION_RESIDUAL_LIMIT, "H", "residual limit", "1/65536 cycle"),
    LimitObject(od.SUPERVISION_ACCELERATION, "f", "largest acceleration", "rad/s²"),
    LimitObject(od.SUPERVISION_PHASE_ERROR, "H", "phase error", "1/65536 cycle"),
    LimitObject(od.SUPERVISION_FROZEN, "B", "equal samples of a frozen input", "samples"),
    LimitObject(od.SUPERVISION_COARSE_LIMIT, "H", "coarse track limit", "1/65536 revolution"),
    LimitObject(od.SUPERVISION_PERIODS, "B", "periods without SYNC or sample", "periods"),
)
# Not a limit itself, but the limits of the amplitude depend on it; older modules lack it.
CORNER = LimitObject(od.ENCODER_CORNER_FREQUENCY, "f", "corner frequency", "Hz")
JITTER = LimitObject(od.SUPERVISION_SYNC_JITTER, "f", "jitter of the SYNC", "s")
KINDS = {one.place: one for one in (*LIMITS, CORNER, JITTER)}


@dataclass(frozen=True)
class SupervisionLimits:
    """The objects from which :attr:`settings` follow, and the noise, which the chain needs as well.

    values                  :data:`LIMITS` in their units, and other objects of the settings, with the RPDOs
    noise_cycles            2011:0B; None: not known
    """

    values: Mapping[od.Multiplexer, float]
    noise_cycles: float | None = None

    @classmethod
    def read(cls, module: NodeAccess) -> SupervisionLimits:
        values = {}
        for place, layout, name, _ in LIMITS:
            values[place] = module.read(*place, layout)
            if not math.isfinite(values[place]):
                raise CommissioningError(f"{module.name}: {od.place_text(place)}, {name}, is {values[place]}")
        others: dict[od.Multiplexer, Number | None] = {}
        limit_settings(lambda place: others.setdefault(place, module.read_known(place)))
        known = {place: value for place, value in others.items() if value is not None}
        return cls(
            {**known, **values},
            (module.read_known(od.FEEDBACK_NOISE) or 0) / LIMIT_UNITS or None,
        )

    @cached_property
    def settings(self) -> LimitSettings:
        return limit_settings(self.values.get)

    def changed(self, values: Mapping[od.Multiplexer, float]) -> SupervisionLimits:
        return replace(self, values={**self.values, **values})

    def chain_limits(self, interval_s: float) -> ChainLimits:
        """Limits of a chain that gets all samples individually, ``interval_s`` apart."""
        bridged = min(self.settings.coast_samples * self.settings.samples_per_sync, MOST_IN_A_ROW)
        one_by_one = replace(self.settings, coast_samples=bridged, samples_per_sync=1)
        return one_by_one.chain_limits(interval_s, self.noise_cycles)


# Limits that accept more samples when they are larger (1) or smaller (-1).
WIDENING = {
    od.ENCODER_LOWEST_AMPLITUDE: -1,
    od.ENCODER_HIGHEST_AMPLITUDE: 1,
    od.SUPERVISION_PHASE_ERROR: 1,  # widens the residual limit, which the others narrow
}


def write_limits(module: NodeAccess, limits: Mapping[od.Multiplexer, float]) -> None:
    """Write and read back; CommissioningError for a difference.

    Limits that become wider are written first, then the corner, which changes the amplitude, then all others:
    so the amplitude stays within its limits, and the lower limit below the upper one.
    """

    def turn(place: od.Multiplexer) -> int:
        if place in WIDENING:
            more = limits[place] - module.read(*place, KINDS[place].layout)
            return 0 if WIDENING[place] * more > 0 else 2
        return 1 if place == CORNER.place else 2

    for place in sorted((place for place in KINDS if place in limits), key=turn):
        layout = KINDS[place].layout
        module.write(*place, layout, limits[place] if layout == "f" else int(limits[place]))
    check_limits(module, limits)


def check_limits(module: NodeAccess, limits: Mapping[od.Multiplexer, float]) -> None:
    """CommissioningError if the module has other limits."""
    for place in limits:
        there = module.read(*place, KINDS[place].layout)
        if there != limits[place]:
            raise CommissioningError(
                f"{module.name}: {od.place_text(place)} reads {there:g}, not {limits[place]:g} as written"
            )


# Collects samples: seconds, least number of samples, and a callable that gets 0..1.
Source = Callable[[float, int, Progress], TrackSamples]
DEFAULT_INTERFACE = 0x10
SAMPLE_LIMITS = (od.ENCODER_FULL_SCALE, *AMPLITUDES)
CORNERS = (od.ENCODER_CORNER_FREQUENCY, od.ENCODER_COSINE_CORNER_FREQUENCY)


@dataclass(frozen=True)
class Session:
    """Both nodes, read once.

    limits               2001:02..04
    samples_itself       the module samples itself: it has no ADC PDO, and no interface was named
    identity             1018h of the module
    interface_identity   None if the interface does not answer
    """

    master: Master
    module: NodeAccess
    interface: NodeAccess
    active: Correction
    cycles_per_revolution: int
    limits: SampleLimits
    samples_itself: bool = False
    named: bool = False
    identity: tuple[int, ...] | None = None
    interface_identity: tuple[int, ...] | None = None

    @classmethod
    def open(cls, master: Master, module_id: int, interface_id: int | None) -> Session:
        """Read both nodes. CommissioningError if ``module_id`` is not a feedback module."""
        module = NodeAccess(master, module_id, "module")
        active = read_active(module)
        cycles = module.integer(*od.ENCODER_CYCLES_PER_REVOLUTION, "I")
        limits = SampleLimits(*(module.integer(*place, "H") for place in SAMPLE_LIMITS))
        named = interface_id if interface_id is not None else _interface_of(module)
        interface = NodeAccess(master, named or DEFAULT_INTERFACE, "encoder interface")
        return cls(
            master,
            module,
            interface,
            active,
            cycles,
            limits,
            samples_itself=named is None,
            named=interface_id is not None,
            identity=_identity_of(module),
            interface_identity=None if named is None else _identity_of(interface),
        )

    def source(
        self,
        kind: str,
        recorder: str,
        rate_hz: float | None,
        enough: Callable[[Listener], bool] = lambda listener: False,
    ) -> Source:
        """Samples by "pdo", until ``enough``, or by a "recording" of "interface" or "module"."""
        if kind == "recording":
            self.check_interface()
            node = self.module if recorder == "module" else self.interface
            return lambda seconds, least, progress: record(node, seconds, rate_hz, progress, least)
        layout = self.layout()
        return lambda seconds, least, progress: listen(self.master, layout, seconds, least, progress, enough)

    def speed_rad_s(self) -> float:
        try:
            speed = float(self.module.read(*od.FEEDBACK_VELOCITY, "f"))
        except CommissioningError:
            return 0.0
        return speed if math.isfinite(speed) else 0.0

    @property
    def path_is_known(self) -> bool:
        """Whether the errors depend on the speed, and the active table is that of standstill."""
        conditioning = self.active.conditioning
        return any(conditioning.harmonics) and bool(
            conditioning.cosine_delay_s or read_corners(self.module).are_there
        )

    def together(self, samples: TrackSamples) -> TrackSamples:
        """The samples without the delay of 2002:06; CommissioningError if the speed is not known."""
        delay_s = self.active.conditioning.cosine_delay_s
        corners = read_corners(self.module)
        if not (delay_s or corners.are_there):
            return samples
        check_valid(self.module)
        hertz = self.speed_rad_s() * self.cycles_per_revolution / (2.0 * math.pi)
        return replace(samples.together(delay_s, hertz), at_speed=counts_at(hertz, delay_s, corners))

    def provenance(self, where: Provenance) -> Provenance:
        """``where``, completed by data of both nodes."""
        return replace(
            where,
            module=self.module.node_id,
            encoder_interface=None if self.samples_itself else self.interface.node_id,
            cycles_per_revolution=self.cycles_per_revolution,
            identity=self.identity,
            interface_identity=self.interface_identity,
        )

    def check_interface(self) -> None:
        if self.named and module_layout(self.module.read_known) is not None:
            self.layout()

    def layout(self) -> PdoLayout:
        return agreed_layout(self.module, self.interface)


def read_corners(module: NodeAccess) -> Corners:
    return Corners(*(float(module.read_known(place) or 0.0) for place in CORNERS))


def _identity_of(node: NodeAccess) -> tuple[int, ...] | None:
    numbers = (node.integer_if_there(place, "I") for place in od.IDENTITY)
    return tuple(iter(lambda: next(numbers, None), None)) or None  # ends at the first missing one


def _interface_of(module: NodeAccess) -> int | None:
    layout = module_layout(module.read_known)
    return None if layout is None else layout.sender or DEFAULT_INTERFACE


def agreed_layout(module: NodeAccess, interface: NodeAccess) -> PdoLayout:
    """The PDO that the interface sends and the module receives; CommissioningError if they differ.

    An interface that does not answer is assumed to send what the module expects.
    """
    taken = module_layout(module.read_known)
    if taken is None:
        raise CommissioningError(
            f"{module.name} has no valid RPDO with both tracks (2000:01, 2000:02): map and enable one; for a "
            "module with its own ADC: --source recording --recorder module"
        )
    if interface.integer_if_there(od.DEVICE_TYPE, "I") is None:
        if taken.sender not in (None, interface.node_id):
            raise CommissioningError(
                f"{interface.name} does not answer, and {module.name} receives its samples from node "
                f"{taken.sender} ({taken.sender:02X}h, PDO {taken.can_id:03X}h): set the right "
                "--encoder-interface, or link the PDOs (1400:01)"
            )
        return taken
    sent = interface_layout(interface.read_known)
    if sent is None:
        raise CommissioningError(
            f"{interface.name} has no valid TPDO with both tracks (6401:01, 6401:02): map and enable one"
        )
    if taken.can_id != sent.can_id:
        raise CommissioningError(
            f"{module.name} receives its samples in PDO {taken.can_id:03X}h, but {interface.name} sends "
            f"them in {sent.can_id:03X}h: set the right --encoder-interface, or link the PDOs (1400:01)"
        )
    return sent
