"""Contents of the PDOs of a module, and scaling of its values."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

from canfb import objects as od
from canfb.cia301 import cob
from canfb.configuration import Config
from canfb.module.module_config import UNCONFIGURED, ModuleConfig
from canfb.module.parameters import factory_dictionary
from canfb.view.module_view import LimitSettings, Number, Pdo, Read, limit_settings, valid_pdos, values_of

if TYPE_CHECKING:
    from canfb.signal.correction import Correction

# The objects of a module that are observed, and their types, as in struct.
VALUES: dict[od.Multiplexer, str] = {
    od.POSITION_VALUE: "I",
    od.FEEDBACK_STATUS: "H",
    od.FEEDBACK_RESIDUAL: "H",
    od.FEEDBACK_AMPLITUDE: "H",
    od.FEEDBACK_VELOCITY: "f",
    od.FEEDBACK_SAMPLES: "I",
    od.FEEDBACK_NOISE: "H",
    od.TABLE_ACTIVE_CRC: "I",
    od.COUNTER_LOSS_CAUSE: "I",
    **dict.fromkeys(od.COUNTERS, "I"),
}

# The same for the PDOs that it receives.
INPUTS: dict[od.Multiplexer, str] = {od.SAMPLE_SINE: "h", od.SAMPLE_COSINE: "h"}

# Values of a snapshot, and the settings on which they depend: assumed unless all of these were read.
NEEDED: dict[str, tuple[od.Multiplexer, ...]] = {
    "position_revolutions": (od.OPERATING_PARAMETERS, od.UNITS_PER_REVOLUTION),
    "velocity_rad_s": (od.OPERATING_PARAMETERS, od.UNITS_PER_REVOLUTION, od.TOTAL_RANGE),
    "residual_limit_cycles": (
        od.ENCODER_CYCLES_PER_REVOLUTION,
        od.SUPERVISION_RESIDUAL_LIMIT,
        od.SUPERVISION_ACCELERATION,
        od.SUPERVISION_NOISE_MARGIN,
    ),
    "amplitude_limits_counts": (od.ENCODER_LOWEST_AMPLITUDE, od.ENCODER_HIGHEST_AMPLITUDE),
    "full_scale_counts": (od.ENCODER_FULL_SCALE,),
}


class Origin(StrEnum):
    """Origin of a layout; saved values take precedence over a configuration."""

    DEFAULT = "EDS"
    CONFIGURATION = "configuration"
    MODULE = "module"
    ASSUMED = "assumed"


def known_values(pdo: Pdo, data: bytes, kinds: Mapping[od.Multiplexer, str]) -> dict[od.Multiplexer, Number]:
    return {
        place: struct.unpack(f"<{kinds[place]}", part)[0]
        for place, part in pdo.values(data).items()
        if place in kinds and struct.calcsize(f"<{kinds[place]}") == len(part)
    }


@dataclass(frozen=True)
class NodeLayout:
    """Settings of a module required to interpret its frames.

    supervision         settings of its limits
    reversed            6004h decreases while 2011:07 is positive (6000h)
    assumed             keys of :data:`NEEDED` not read from the module
    """

    node_id: int
    origin: Origin
    tpdos: tuple[Pdo, ...]
    inputs: tuple[Pdo, ...]
    supervision: LimitSettings
    sync_id: int = cob.SYNC
    emcy_id: int = 0
    units_per_revolution: int = 0
    total_range: int = 0
    reversed: bool = False
    assumed: frozenset[str] = frozenset(NEEDED)


@dataclass(frozen=True, eq=False)
class ModuleReading:
    """Values read from a module; ``correction`` None: not read."""

    values: Mapping[od.Multiplexer, Number]
    layout: NodeLayout
    correction: Correction | None = None


def layout_of(node_id: int, read: Read, origin: Origin) -> NodeLayout:
    """Layout of the module ``node_id`` (1..127)."""

    def integer(place: od.Multiplexer, default: int) -> int:
        value = read(place)
        return default if value is None else int(value)

    operating = integer(od.OPERATING_PARAMETERS, 0)
    per_turn, total = od.SINGLE_TURN_RESOLUTION, integer(od.DISTINGUISHABLE_REVOLUTIONS, 0)
    total *= integer(per_turn, 0)
    if operating & od.OperatingParameter.SCALING:
        per_turn, total = od.UNITS_PER_REVOLUTION, integer(od.TOTAL_RANGE, 0)
    return NodeLayout(
        node_id,
        origin,
        tpdos=_pdos(read, od.TPDO, od.TPDO_MAPPING, VALUES),
        inputs=_pdos(read, od.RPDO, od.RPDO_MAPPING, INPUTS),
        sync_id=integer(od.SYNC_COB_ID, cob.SYNC) & cob.CAN_ID,
        emcy_id=integer(od.EMCY_COB_ID, cob.EMERGENCY + node_id) & cob.CAN_ID,
        units_per_revolution=integer(per_turn, 0),
        total_range=total,
        reversed=bool(operating & od.OperatingParameter.CODE_SEQUENCE),
        supervision=limit_settings(read),
        assumed=frozenset(
            name
            for name, places in NEEDED.items()
            if origin is not Origin.MODULE or any(read(place) is None for place in places)
        ),
    )


def _pdos(read: Read, parameters: int, mapping: int, known: Mapping[od.Multiplexer, str]) -> tuple[Pdo, ...]:
    return tuple(
        pdo
        for pdo in valid_pdos(read, parameters, mapping)
        if known.keys() & pdo.values(bytes(pdo.length_bytes)).keys()
    )


def known_layouts(config: Config, nodes: Sequence[int] = ()) -> list[NodeLayout]:
    """Layouts of these nodes (1..127), by default of all configured ones."""
    return [layout_of(node, read, origin) for node, (read, origin) in known_objects(config, nodes).items()]


def assumed_layout(node_id: int) -> NodeLayout:
    return layout_of(node_id, assumed_objects(node_id), Origin.ASSUMED)


def assumed_objects(node_id: int) -> Read:
    return _reader(ModuleConfig.factory(node_id))


def known_objects(config: Config, nodes: Sequence[int] = ()) -> dict[int, tuple[Read, Origin]]:
    """Objects of these nodes by node-ID, as configured or by default."""
    configured = {module.node_id: module for module in config.modules if module.node_id != UNCONFIGURED}
    return {
        node: (_reader(configured[node]), Origin.CONFIGURATION)
        if node in configured
        else (assumed_objects(node), Origin.DEFAULT)
        for node in nodes or configured
    }


ALIKE = 16  # successive PDOs that must look like those of a module
POSITION_PDO = struct.Struct("<IHH")
LARGEST_RESIDUAL = 0x8000
NO_STATUS = 0xC000  # bits that are never set in a status word


class Recognition:
    """Recognises a module by ``ALIKE`` successive TPDO1 that can be position, status and residual."""

    def __init__(self) -> None:
        self._alike: dict[int, int] = {}

    def found(self, can_id: int, data: bytes) -> int | None:
        node_id = can_id - cob.TPDO1
        if not 1 <= node_id <= 127:
            return None
        alike = False
        if len(data) == POSITION_PDO.size:
            _, status, residual = POSITION_PDO.unpack(data)
            alike = not status & NO_STATUS and residual <= LARGEST_RESIDUAL
        self._alike[node_id] = self._alike.get(node_id, 0) + 1 if alike else 0
        return node_id if self._alike[node_id] >= ALIKE else None


def _reader(config: ModuleConfig) -> Read:
    return values_of(factory_dictionary(config, samples_itself=config.source is not None).find)
