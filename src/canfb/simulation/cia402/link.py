"""What makes the drive of the EDS file the one of this machine: its motor, and its feedback module."""

from __future__ import annotations

from dataclasses import dataclass

from canfb import objects as od
from canfb.checks import integer_in
from canfb.cia301 import cob
from canfb.device.od.dictionary import Dictionary
from canfb.simulation.cia402.motor import MotorConfig

U32 = 0xFFFFFFFF
G_CM2_PER_KG_M2 = 1e7


@dataclass(frozen=True, kw_only=True)
class FeedbackModuleLink:
    """The feedback module that a drive listens to: its ``node_id``, 1..127, and its scale.

    increments_per_revolution   6501h of the module, with scaling on 6001h
    total_range                 where its position wraps: 6501h times 6502h, with scaling on 6002h; 0 is 2^32
    synchronous                 take the position at the next SYNC (RPDO type 1) instead of at once (255)
    """

    node_id: int
    increments_per_revolution: int = 20_480_000
    total_range: int = 4_280_320_000
    synchronous: bool = False

    def __post_init__(self) -> None:
        integer_in("node_id", self.node_id, 1, 127)
        integer_in("increments_per_revolution", self.increments_per_revolution, 1, U32)
        integer_in("total_range", self.total_range, 0, U32)


def apply_defaults(
    dictionary: Dictionary, motor: MotorConfig, link: FeedbackModuleLink | None, serial_number: int
) -> None:
    """Replace defaults and values of the dictionary: a reset comes back to these."""
    defaults = {
        od.IDENTITY_SERIAL_NUMBER: serial_number,
        (0x6076, 0): max(1, min(U32, round(motor.rated_torque_nm * 1000))),
        (0x2100, 5): max(1, min(U32, round(motor.inertia_kg_m2 * G_CM2_PER_KG_M2))),
    }
    if link is not None:
        defaults |= {
            (0x1403, 1): cob.TPDO1 + link.node_id,
            (0x1403, 2): 1 if link.synchronous else 255,
            (0x2110, 5): link.total_range,
            (0x2110, 7): cob.EMERGENCY + link.node_id,
            (0x60E6, 1): link.increments_per_revolution,
        }
    for (index, subindex), value in defaults.items():
        entry = dictionary.entry(index, subindex)
        entry.default = entry.value = value
        entry.follows_node_id = False
