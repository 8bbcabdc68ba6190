"""What a program can listen to on a node."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from canfb.cia301.nmt import NmtState
from canfb.device.od.entry import Entry
from canfb.device.storage.image import ParameterGroup

Groups = list[ParameterGroup]


class Hooks:
    """Functions of the program that the node calls; None for what it does not want to hear.

    They are called from within the calls of the node. They may write entries and call
    `trigger_tpdo`, `emergency` and `clear_emergency`, but not `receive` or `tick`. What they raise
    comes out of the call: it is a mistake in the program.

    on_rpdo(number, now): the data of RPDO `number` stands in the dictionary (a property of the node).
    on_time(days, milliseconds, now): a TIME, with the days since 1984-01-01 and the milliseconds of
    the day, while 1012h says that it is consumed.
    accepts_sync(counter, now): whether a SYNC in OPERATIONAL counts as one, before anything is done
    with it; False drops it.
    on_idle_sync(counter): a SYNC in PRE-OPERATIONAL.
    on_sync(counter, now): a SYNC in OPERATIONAL, after synchronous RPDOs were taken over, before
    synchronous TPDOs are sampled; `counter` is None without 1019h.
    on_synchronised(): the synchronous TPDOs of a SYNC are sampled.
    on_state(old, new, now): after a change of the NMT state.
    on_reset(communication_only, now): the dictionary is back at its defaults (at `start`: is as it
    is), stored parameters are restored, and all errors are forgotten, before boot-up; report again
    what persists.
    on_parameter_faults(faults, now): stored parameters of these groups were refused, and why; the
    defaults are in force. After each reset while there are any, and when a save or a load changes them.
    on_duplicate(can_id, now): another node sends with a CAN-ID that belongs to this one, most likely
    with the same node-ID. For the first such frame after each reset; `counters` counts them all.
    on_bad_rpdo(number, received, mapped, now): an RPDO too short, in bytes; its data was dropped.
    on_communication_error(now): a heartbeat or the guarding master is lost, or the bus, before the NMT
    state changes as 1029h says.
    on_configured(): PDO parameters or the NMT state have changed; mappings may be others now.
    on_emergency(code, register, detail, now): an EMCY goes out, with 1001h and its 5 manufacturer bytes.
    on_write(entry): an SDO is about to write this entry, or LSS to configure the node (None); raises SdoAbort
    to refuse it.
    on_saved(saved, forgotten, now): these groups of parameters were saved, or dropped from the store.
    on_save_failed(groups, reason, now): these groups could not be saved or dropped; the store is as before.
    on_bit_rate(kbit_s, delay_s, now): LSS activates this bit rate. Change it at `now` + `delay_s`; the
    node by itself sends nothing up to `now` + 2 `delay_s`. What waits in a driver's queue is yours.
    """

    def __init__(self) -> None:
        self.on_time: Callable[[int, int, float], None] | None = None
        self.accepts_sync: Callable[[int | None, float], bool] | None = None
        self.on_idle_sync: Callable[[int | None], None] | None = None
        self.on_sync: Callable[[int | None, float], None] | None = None
        self.on_synchronised: Callable[[], None] | None = None
        self.on_state: Callable[[NmtState, NmtState, float], None] | None = None
        self.on_reset: Callable[[bool, float], None] | None = None
        self.on_parameter_faults: Callable[[Mapping[ParameterGroup, str], float], None] | None = None
        self.on_duplicate: Callable[[int, float], None] | None = None
        self.on_bad_rpdo: Callable[[int, int, int, float], None] | None = None
        self.on_communication_error: Callable[[float], None] | None = None
        self.on_configured: Callable[[], None] | None = None
        self.on_emergency: Callable[[int, int, bytes, float], None] | None = None
        self.on_write: Callable[[Entry | None], None] | None = None
        self.on_saved: Callable[[Groups, Groups, float], None] | None = None
        self.on_save_failed: Callable[[Groups, str, float], None] | None = None
        self.on_bit_rate: Callable[[int, float, float], None] | None = None
