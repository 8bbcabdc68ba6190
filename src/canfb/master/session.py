"""A module and its encoder interface: what is active, what limits it, where samples come from."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from canfb import objects as od
from canfb.calibration.over_speeds import counts_at
from canfb.master.access import CommissioningError, Master, NodeAccess, Progress
from canfb.master.all_or_nothing import read_active
from canfb.master.machine_watch import Provenance, check_valid
from canfb.master.samples import Listener, TrackSamples, listen, record
from canfb.signal.correction import Correction
from canfb.signal.harmonics import Corners
from canfb.signal.supervision import SampleLimits
from canfb.view.module_view import PdoLayout, interface_layout, module_layout

Source = Callable[[float, int, Progress], TrackSamples]
"""Collects samples: seconds, least number of samples, and a callable that gets 0..1."""
DEFAULT_INTERFACE = 0x10
SAMPLE_LIMITS = (od.ENCODER_FULL_SCALE, od.ENCODER_LOWEST_AMPLITUDE, od.ENCODER_HIGHEST_AMPLITUDE)
CORNERS = (od.ENCODER_CORNER_FREQUENCY, od.ENCODER_COSINE_CORNER_FREQUENCY)


@dataclass(frozen=True)
class Session:
    """Both nodes, read once.

    limits               2001:02..04
    samples_itself       no ADC PDO, and no interface was named
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
        """CommissioningError if the node is not a feedback module."""
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
        """Of "pdo", until ``enough``, or of a "recording" of "interface" or "module"."""
        if kind == "recording":
            self.check_interface()
            node = self.module if recorder == "module" else self.interface
            return lambda seconds, least, progress: record(node, seconds, rate_hz, progress)
        layout = self.layout()
        return lambda seconds, least, progress: listen(self.master, layout, seconds, least, progress, enough)

    def speed_rad_s(self) -> float:
        try:
            speed = float(self.module.read(*od.FEEDBACK_VELOCITY, "f"))
        except CommissioningError:
            return 0.0
        return speed if math.isfinite(speed) else 0.0

    @property
    def corners(self) -> Corners:
        return read_corners(self.module)

    @property
    def path_is_known(self) -> bool:
        """The speed matters, and the active table is that of standstill."""
        conditioning = self.active.conditioning
        return any(conditioning.harmonics) and bool(conditioning.cosine_delay_s or self.corners.are_there)

    def together(self, samples: TrackSamples) -> TrackSamples:
        """The samples without the delay of 2002:06; CommissioningError if the speed is not known."""
        delay_s = self.active.conditioning.cosine_delay_s
        corners = self.corners
        if not (delay_s or corners.are_there):
            return samples
        check_valid(self.module)
        hertz = self.speed_rad_s() * self.cycles_per_revolution / (2.0 * math.pi)
        at_speed = counts_at(hertz, delay_s, corners)
        return replace(samples.together(delay_s, hertz), at_speed=at_speed)

    def provenance(self, where: Provenance) -> Provenance:
        """``where``, with what is known of both nodes."""
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
    return tuple(iter(lambda: next(numbers, None), None)) or None  # up to the first that is not there


def _interface_of(module: NodeAccess) -> int | None:
    layout = module_layout(module.read_known)
    return None if layout is None else layout.sender or DEFAULT_INTERFACE


def agreed_layout(module: NodeAccess, interface: NodeAccess) -> PdoLayout:
    """The PDO that the interface sends and the module takes; CommissioningError if they differ.

    An interface that does not answer is taken to send what the module expects.
    """
    taken = module_layout(module.read_known)
    if taken is None:
        raise CommissioningError(
            f"{module.name} has no valid RPDO with both tracks (2000:01, 2000:02): map and enable one; for a "
            "module with its own ADC: --source recording --recorder module"
        )
    if not interface.answers():
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
