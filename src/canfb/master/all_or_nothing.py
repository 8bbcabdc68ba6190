"""Changes of a module or its table: as a whole or not at all."""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Callable, Iterator, Sequence

from canfb import objects as od
from canfb.cia301.codes import AbortCode
from canfb.errors import BusError, CanfbError, saying
from canfb.master.access import (
    CommissioningError,
    Master,
    NodeAccess,
    ObjectAbsentError,
    RefusedError,
    as_real32,
    without_restart,
)
from canfb.signal.conditioning import IDENTITY, Conditioning
from canfb.signal.correction import Correction, CorrectionTable

STORES = (od.STORE_MANUFACTURER_PARAMETERS, od.STORE_ALL_PARAMETERS)  # in order of preference
OLD_CONDITIONING = 5  # sub-indices of 2002h in versions without delays
SAVE = b"save"
SAVES_ON_COMMAND = 1
SAVE_WITHIN_S = 10.0


def read_active(module: NodeAccess) -> Correction:
    """Table and conditioning in force. CommissioningError if the node is not a feedback module."""
    try:
        crc32 = module.integer(*od.TABLE_ACTIVE_CRC, "I")
    except ObjectAbsentError:
        raise CommissioningError(
            f"{module.name} has no correction table (2020h): not a feedback module: give the NODE of one"
        ) from None
    conditioning = active_conditioning(module)
    if crc32 == 0:
        return Correction(None, conditioning)
    with saying(CommissioningError, f"{module.name}: 2020:01 is not a correction table", ValueError):
        table = CorrectionTable.from_bytes(module.upload_domain(*od.TABLE_STAGED))
    if table.crc32 != crc32:
        raise CommissioningError(
            f"{module.name}: the table read has CRC {table.crc32:08X}h, the active table {crc32:08X}h"
        )
    return Correction(table, conditioning)


def active_conditioning(module: NodeAccess) -> Conditioning:
    """The conditioning in force: 2020:07, or 2002h of an older module."""
    try:
        data = module.read_bytes(*od.TABLE_ACTIVE_CONDITIONING)
    except ObjectAbsentError:
        return read_conditioning(module)
    with saying(
        CommissioningError, f"{module.name}: conditioning (2020:07) cannot be used", struct.error, ValueError
    ):
        return Conditioning(*struct.unpack(f"<{len(od.CONDITIONING)}f", data))


def read_conditioning(module: NodeAccess) -> Conditioning:
    """The conditioning of 2002h and 2005h, which need not be in force."""
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
    """Write conditioning and table, activate both, check. CommissioningError may leave a partial change."""
    write_conditioning(module, correction.conditioning)
    if correction.table is not None and module.integer(*od.TABLE_ACTIVE_CRC, "I") != correction.crc32:
        stage(module, correction.table)
    activate(module, correction.crc32)


def stage(module: NodeAccess, table: CorrectionTable) -> None:
    module.download_domain(*od.TABLE_STAGED, table.to_bytes())
    check_crc(module, od.TABLE_STAGED_CRC, "staged", table.crc32)


def activate(module: NodeAccess, crc32: int) -> None:
    """Activate the staged table with this CRC, and 2002h; 0: the identity."""
    module.write(*od.TABLE_ACTIVATE, "I", crc32)
    check_crc(module, od.TABLE_ACTIVE_CRC, "active", crc32)


def put_in_force_again(module: NodeAccess, before: Correction) -> None:
    put_in_force(module, before)
    if read_active(module) != before:
        raise CommissioningError(f"{module.name}: the previous table and conditioning are not active")


def check_unlocked(module: NodeAccess) -> None:
    """CommissioningError if the write lock (2040h) is closed."""
    if module.read_known(od.WRITE_LOCK_LOCKED):
        raise CommissioningError(
            f"{module.name} is locked (2040h): canfb sdo write {module.node_id:#04x} 2040:02 CODE unlocks "
            "it; with write_lock: preop nothing is written in OPERATIONAL (docs/service.md)"
        )


def save(module: NodeAccess, stores: Sequence[od.Multiplexer] = STORES) -> str:
    """Save; returns the object used. CommissioningError if it fails."""
    store = check_can_save(module, stores)
    try:
        module.write_bytes(*store, SAVE, SAVE_WITHIN_S)
    except RefusedError as error:
        if error.code != AbortCode.HARDWARE:
            raise
        raise CommissioningError(
            f"{module.name} cannot save: no space left for its parameters, or failing memory "
            f"(its log, of canfb run, names the file): {error}"
        ) from None
    return f"1010:{store.subindex:02X}"


def check_can_save(module: NodeAccess, stores: Sequence[od.Multiplexer] = STORES) -> od.Multiplexer:
    """The object that saves; CommissioningError if the module cannot."""
    for store in stores:
        if int(module.read_known(store) or 0) & SAVES_ON_COMMAND:
            return store
    raise CommissioningError(f"--save: {module.name} cannot save (1010h; canfb run needs a state_dir for it)")


def write_conditioning(module: NodeAccess, conditioning: Conditioning) -> None:
    values = zip(od.CONDITIONING, conditioning.values, read_conditioning(module).values, strict=True)
    changed = [(place, value) for place, value, before in values if value != before]
    for place, value in changed:
        module.write(*place, "f", value)
    if any(module.read(*place, "f") != as_real32(value) for place, value in changed):
        raise CommissioningError(
            f"{module.name}: the conditioning read back (2002h) differs from what was written"
        )


def check_crc(module: NodeAccess, place: od.Multiplexer, which: str, expected: int) -> None:
    found = module.integer(*place, "I")
    if found != expected:
        raise CommissioningError(
            f"{module.name}: the CRC of the {which} table is {found:08X}h, not {expected:08X}h"
        )


class Guard:
    """Protects critical sections from interruption.

    :meth:`interrupt`, for a signal handler, raises KeyboardInterrupt once, but not while :meth:`held`.
    """

    def __init__(self) -> None:
        self._held = self._interrupted = False

    def interrupt(self) -> None:
        if not self._held and not self._interrupted:
            self._interrupted = True
            raise KeyboardInterrupt

    @contextlib.contextmanager
    def held(self) -> Iterator[None]:
        """Context without interruption."""
        self._held = True
        try:
            yield
        finally:
            self._held = False


PAUSES_S = 0.0, 1.0  # before each attempt, so that a bus may recover or a node boot
EITHER = "either what was saved before or the new values, whole"


def change(
    module: NodeAccess,
    guard: Guard,
    act: Callable[[], None],
    back: Callable[[], None],
    *,
    what: str,
    undone: Callable[[], str],
    keep: bool = False,
    stores: Sequence[od.Multiplexer] = STORES,
    step: Callable[[str], None] = lambda text: None,
) -> str | None:
    """Call ``act``, then save if ``keep``; returns the object that saved, or None.

    After a failure, an interruption or a restart of the module ``back`` restores ``what``, uninterrupted, and
    it is saved again if saving had begun. The CommissioningError says ``undone()``, or that this failed.
    """
    with guard.held():
        check_unlocked(module)  # a lock would refuse the undo as well
    saving = False

    def undo() -> str:
        put_back(module, what, back, saving=saving)
        try:
            if saving:
                save(module, stores)
        except CanfbError as error:
            raise CommissioningError(
                f"{undone()}, and what is saved is {EITHER}: save it when that works again"
            ) from error
        return undone()

    try:
        with without_restart(module) as check:
            act()
            if not keep:
                return None
            check()  # after a restart the change is incomplete and must not be saved
            step("saving")
            saving = True
            return save(module, stores)
    except BaseException as error:
        with guard.held():
            try:
                said, is_back = undo(), True
            except CanfbError as failure:
                said, is_back = str(failure), False
        if isinstance(error, CanfbError) or not is_back:
            raise CommissioningError(f"{str(error) or 'interrupted'}; {said}") from error
        raise


def put_back(module: NodeAccess, what: str, act: Callable[[], None], *, saving: bool = False) -> None:
    """Restore ``what`` by ``act``, with a second attempt after a pause; CommissioningError with advice."""
    for pause_s in PAUSES_S:
        try:
            _pause(module.master, pause_s)
            with without_restart(module):
                act()
            return
        except CanfbError as error:
            failure = error
    saved = EITHER if saving else "what is saved in it"
    raise CommissioningError(
        f"{what} could not be restored ({failure}): switch {module.name} off and on, which restores {saved}"
    ) from failure


def _pause(master: Master, duration_s: float) -> None:
    """Though the bus fails meanwhile."""
    end_s = master.now() + duration_s
    while master.now() < end_s:
        with contextlib.suppress(BusError):
            master.wait(end_s - master.now())
