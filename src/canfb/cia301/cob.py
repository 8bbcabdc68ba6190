"""COB-ID entries: flags, restricted CAN-IDs, and the rules for a new value."""

from __future__ import annotations

from collections.abc import Callable

from canfb.cia301.codes import AbortCode, SdoAbort

NOT_VALID = 1 << 31  # Bit 31 of PDO, SDO and EMCY COB-IDs: the object does not exist (is not valid).
NO_RTR = 1 << 30  # Bit 30 of a TPDO COB-ID: no remote frame allowed.
GENERATE = 1 << 30  # Bit 30 of 1005h: the device produces SYNC.

EXTENDED = 1 << 29  # Bit 29 of a COB-ID: a CAN-ID of 29 bits, which a classic CANopen device does not use.

CAN_ID = 0x7FF

# The predefined connection set: COB-IDs without the node-ID (CiA 301, 7.3.5).
NMT = 0x000
SYNC = 0x080
EMERGENCY = 0x080
TPDOS = TPDO1, TPDO2, TPDO3, TPDO4 = 0x180, 0x280, 0x380, 0x480
SDO_RESPONSE = 0x580
SDO_REQUEST = 0x600
ERROR_CONTROL = 0x700
NODES = range(1, 128)
NODE_ID = 0x7F  # mask of the node-ID in a CAN-ID of the predefined connection set
BOOT_UP = b"\0"  # data of a boot-up (ERROR_CONTROL); a heartbeat never has the state 0

_EXTENDED_OR_RESERVED = 0x3FFFF800

_RESTRICTED = (
    (0x000, 0x07F),
    (0x101, 0x180),
    (0x581, 0x5FF),
    (0x601, 0x67F),
    (0x6E0, 0x6FF),
    (0x701, 0x7FF),
)


def is_valid(value: int) -> bool:
    return not value & NOT_VALID


def is_restricted(can_id: int) -> bool:
    return any(first <= can_id <= last for first, last in _RESTRICTED)


def check(
    new: int,
    old: int,
    exists: Callable[[int], object] = is_valid,
    *,
    always_named: bool = False,
    reserved: int = 0,
) -> None:
    """Refuse a COB-ID that an 11-bit device cannot use, or a change of one in use: SdoAbort 06090030h (CiA
    301, 7.5.2).

    `exists`: whether the object exists (is valid) with a given value.
    """
    # The CAN-ID of an object that does not exist is arbitrary, unless it is `always_named`.
    restricted = is_restricted(new & CAN_ID) and (always_named or exists(new))
    changed = exists(new) and exists(old) and (new ^ old) & CAN_ID
    if restricted or changed or new & (_EXTENDED_OR_RESERVED | reserved):
        raise SdoAbort(AbortCode.INVALID_VALUE)
