"""Table and conditioning of a module: read, activate, restore, save."""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Sequence

from canfb import objects as od
from canfb.master.access import CommissioningError, NodeAccess, ObjectAbsentError
from canfb.master.supervision_limits import as_real32
from canfb.signal.conditioning import IDENTITY, Conditioning
from canfb.signal.correction import Correction, CorrectionTable

STORES = (od.STORE_MANUFACTURER_PARAMETERS, od.STORE_ALL_PARAMETERS)  # the narrower one first
OLD_CONDITIONING = 5  # sub-indices of 2002h, before it had delays
SAVE = b"save"
SAVES_ON_COMMAND = 1
SAVE_WITHIN_S = 10.0


def read_active(module: NodeAccess) -> Correction:
    """The active set. CommissioningError if the node is not a feedback module, or the table is incomplete."""
    try:
        crc32 = module.integer(*od.TABLE_ACTIVE_CRC, "I")
    except ObjectAbsentError:
        raise CommissioningError(
            f"{module.name} has no correction table (2020h): not a feedback module; set --module"
        ) from None
    conditioning = active_conditioning(module)
    if crc32 == 0:
        return Correction(None, conditioning)
    try:
        table = CorrectionTable.from_bytes(module.upload_domain(*od.TABLE_STAGED))
    except ValueError as error:
        raise CommissioningError(f"{module.name}: 2020:01 is not a correction table: {error}") from None
    if table.crc32 != crc32:
        raise CommissioningError(
            f"{module.name}: the table read has CRC {table.crc32:08X}h, the active table {crc32:08X}h"
        )
    return Correction(table, conditioning)


def active_conditioning(module: NodeAccess) -> Conditioning:
    """The conditioning in force (2020:07); that of 2002h from an older module, which does not report it."""
    try:
        data = module.read_bytes(*od.TABLE_ACTIVE_CONDITIONING)
    except ObjectAbsentError:
        return read_conditioning(module)
    try:
        return Conditioning(*struct.unpack(f"<{len(od.CONDITIONING)}f", data))
    except (struct.error, ValueError) as error:
        raise CommissioningError(f"{module.name}: conditioning (2020:07) cannot be used: {error}") from None


def read_conditioning(module: NodeAccess) -> Conditioning:
    """2002h and 2005h, in force with the next activation; the identity where there is none, no delays where
    an older module has none.
    """
    try:
        values = [float(module.read(*place, "f")) for place in od.CONDITIONING[:OLD_CONDITIONING]]
        with contextlib.suppress(ObjectAbsentError):
            values += [float(module.read(*place, "f")) for place in od.CONDITIONING[OLD_CONDITIONING:]]
        return Conditioning(*values)
    except ObjectAbsentError:
        return IDENTITY
    except ValueError as error:
        raise CommissioningError(f"{module.name}: conditioning (2002h) cannot be used: {error}") from None


def put_in_force(module: NodeAccess, correction: Correction) -> None:
    """Write conditioning and table, check the staged bytes, activate both together, check again.

    CommissioningError where anything is not as it must be; the module may then be in between.
    """
    write_conditioning(module, correction.conditioning)
    if correction.table is not None and module.integer(*od.TABLE_ACTIVE_CRC, "I") != correction.crc32:
        stage(module, correction.table)
    activate(module, correction.crc32)


def stage(module: NodeAccess, table: CorrectionTable) -> None:
    """Write a table to 2020:01, where it waits for its activation. CommissioningError if the CRC differs."""
    module.download_domain(*od.TABLE_STAGED, table.to_bytes())
    _check_crc(module, od.TABLE_STAGED_CRC, "staged", table.crc32)


def activate(module: NodeAccess, crc32: int) -> None:
    """Put the table with this CRC in force, with 2002h; 0: none. CommissioningError if that does not work."""
    module.write(*od.TABLE_ACTIVATE, "I", crc32)
    _check_crc(module, od.TABLE_ACTIVE_CRC, "active", crc32)


def put_in_force_again(module: NodeAccess, before: Correction) -> None:
    """Activate the old set, and prove it. CommissioningError if that fails."""
    put_in_force(module, before)
    if read_active(module) != before:
        raise CommissioningError(f"{module.name}: the previous table and conditioning are not active")


def check_unlocked(module: NodeAccess) -> None:
    """CommissioningError while the write lock (2040h) refuses every write: before a long measurement."""
    if module.read_known(od.WRITE_LOCK_LOCKED):
        raise CommissioningError(
            f"{module.name} is locked (2040h): canfb sdo write {module.node_id:#04x} 2040:02 CODE unlocks "
            "it; with write_lock: preop nothing is written in OPERATIONAL (docs/security.md)"
        )


def save(module: NodeAccess, stores: Sequence[od.Multiplexer] = STORES) -> str | None:
    """Keep table and parameters over a loss of power: the object used, None where nothing can be kept.

    CommissioningError if the node can save and fails to.
    """
    store = saving_object(module, stores)
    if store is None:
        return None
    module.write_bytes(*store, SAVE, SAVE_WITHIN_S)
    return f"1010:{store.subindex:02X}"


def check_can_save(module: NodeAccess, stores: Sequence[od.Multiplexer] = STORES) -> None:
    """CommissioningError if the module cannot save, before anything is written."""
    if saving_object(module, stores) is None:
        raise CommissioningError(
            f"--save: {module.name} cannot save (1010h; canfb run needs a state_dir for it)"
        )


def saving_object(module: NodeAccess, stores: Sequence[od.Multiplexer] = STORES) -> od.Multiplexer | None:
    """The first of these objects that saves on command, None where nothing can be kept."""
    for store in stores:
        try:
            ability = module.integer(*store, "I")
        except ObjectAbsentError:
            continue
        if ability & SAVES_ON_COMMAND:
            return store
    return None


def write_conditioning(module: NodeAccess, conditioning: Conditioning) -> None:
    """Write 2002h, which waits for the next activation. CommissioningError if it reads otherwise then."""
    values = zip(od.CONDITIONING, conditioning.values, read_conditioning(module).values, strict=True)
    changed = [(place, value) for place, value, before in values if value != before]
    for place, value in changed:
        module.write(*place, "f", value)
    if any(module.read(*place, "f") != as_real32(value) for place, value in changed):
        raise CommissioningError(
            f"{module.name}: the conditioning read back (2002h) differs from what was written"
        )


def _check_crc(module: NodeAccess, place: od.Multiplexer, which: str, expected: int) -> None:
    found = module.integer(*place, "I")
    if found != expected:
        raise CommissioningError(
            f"{module.name}: the CRC of the {which} table is {found:08X}h, not {expected:08X}h"
        )
