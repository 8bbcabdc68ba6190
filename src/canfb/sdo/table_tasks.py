"""What ``canfb table`` does to a module, as a whole or not at all."""

from __future__ import annotations

import math
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

from canfb import objects as od
from canfb.errors import CanfbError
from canfb.files import write_whole
from canfb.master.access import CommissioningError, NodeAccess
from canfb.master.all_or_nothing import (
    Guard,
    activate,
    change,
    check_can_save,
    put_in_force,
    put_in_force_again,
    read_active,
    read_conditioning,
    stage,
    write_conditioning,
)
from canfb.master.supervision_limits import AMPLITUDES, as_real32
from canfb.rows import Result, as_figures
from canfb.sdo.table_file import TableFile, TableState, as_yaml, difference, is_yaml
from canfb.signal.conditioning import IDENTITY, Conditioning
from canfb.signal.correction import Correction, CorrectionTable

LOOKS, LOOK_S = 10, 0.01
AS_IT_WAS = "the previous table and conditioning"


class TableTasks:
    """``guard`` keeps interruptions away from what puts things back."""

    def __init__(self, module: NodeAccess, guard: Guard) -> None:
        self._module = module
        self._guard = guard

    def upload(self, file: TableFile, *, active: bool, keep: bool, force: bool = False) -> Result:
        """Stage the table of a file and prove it. ``active`` puts it in force, ``keep`` saves it.

        CommissioningError if anything fails or, unless ``force``, if the amplitude would leave its limits;
        at most a staged table is left then.
        """
        before, table = read_active(self._module), file.used.table
        if table is None:
            raise CommissioningError(
                f"{file.path}: it has no table; canfb table clear goes back to the identity"
            )
        new = file.for_module(before.conditioning)
        if active:
            self._check_amplitude(before.conditioning, new.conditioning, force)
            done = self._in_force(before, new, keep, lambda: put_in_force(self._module, new))
        else:
            self._staged(new, table)
            done = {"staged": True, "active": False, "saved_as": None}
        source = f"{file.path}: {table.crc32:08X}h, {len(table)} entries"
        if not file.with_conditioning:
            source += "; it knows no conditioning, that of the module stays"
        state = self._state_after(new, done)
        lines = [source, self._moves(state, before, new), *self._other_settings(file)]
        if not active:
            how = f"canfb table activate {self._module.node_id:#04x}"
            lines.append(f"staged in {self._module.name}, not in force yet: {how}")
        return _result(state, [*lines, *self._outcome(new, done)], done)

    def activate(self, *, keep: bool, force: bool = False) -> Result:
        staged = self._module.integer(*od.TABLE_STAGED_CRC, "I")
        if not staged:
            raise CommissioningError(
                f"{self._module.name}: nothing is staged; canfb table write stages the table of a file"
            )
        before = read_active(self._module)
        self._check_amplitude(before.conditioning, read_conditioning(self._module), force)
        done = self._in_force(before, None, keep, lambda: activate(self._module, staged))
        now = self._state_after(None, done)
        return _result(now, [self._moves(now, before, now.used), *self._outcome(now.used, done)], done)

    def clear(self, *, conditioning: bool, keep: bool) -> Result:
        """Back to the identity, the ``conditioning`` too."""
        before = read_active(self._module)
        new = Correction(None, IDENTITY if conditioning else before.conditioning)
        done = self._in_force(before, new, keep, lambda: put_in_force(self._module, new))
        state = self._state_after(new, done)
        lines = [self._moves(state, before, new), *self._outcome(new, done)]
        if not new.conditioning.is_identity:
            lines.append("the conditioning (2002h) stays in force; --conditioning clears it as well")
        return _result(state, lines, done)

    def download(self, path: Path, date: str) -> Result:
        state = TableState.of_module(self._module)
        table = state.used.table or CorrectionTable.identity()
        used = Correction(table, state.used.conditioning)
        day, _, time = date.partition(" ")
        meta = {
            "date": day,
            "time": time,
            "canfb": version("canfb"),
            "module": self._module.node_id,
            "cycles_per_revolution": state.cycles_per_revolution,
        }
        write_whole(path, as_yaml(used, meta).encode() if is_yaml(path) else table.to_bytes())
        what = "the identity: no table is active" if state.used.table is None else "the active table"
        lines = [f"{path}: {what}, {table.crc32:08X}h, {len(table)} entries"]
        if not is_yaml(path) and not used.conditioning.is_identity:
            lines.append(
                f"note: {path} has the table alone; a name with .yaml keeps the conditioning as well"
            )
        return _result(state, lines, {"file": str(path)})

    def _other_settings(self, file: TableFile) -> list[str]:
        """2001h where it differs from that of the measurement: set up by hand, no part of a table."""
        node = f"{self._module.node_id:#04x}"
        return [
            f"note: it was measured with {text} = {value:g}, {self._module.name} has {there:g}: "
            f"canfb sdo write {node} {text} {value:g}, if that is right"
            for place, value in file.noted.items()
            for text in [od.place_text(place)]
            if (there := self._module.read_known(place)) is not None and there != as_real32(value)
        ]

    def _check_amplitude(self, before: Conditioning, new: Conditioning, force: bool) -> None:
        module = self._module
        low, high = (module.integer(*place, "H") for place in AMPLITUDES)
        kept, wrong = 0, list[float]()
        for _ in range(0 if force or new == before else LOOKS):
            pair = (module.integer(*od.SAMPLE_SINE, "h"), module.integer(*od.SAMPLE_COSINE, "h"))
            if low <= math.hypot(*before.apply(*pair)) <= high:
                kept += 1
                amplitude = math.hypot(*new.apply(*pair))
                wrong += [] if low <= amplitude <= high else [amplitude]
            module.master.wait(LOOK_S)
        if 2 * len(wrong) > kept:
            raise CommissioningError(
                f"{module.name}: with this conditioning the amplitude is {wrong[-1]:.0f} counts, outside "
                f"{low}..{high} (2001:03, 2001:04), and now it is not. Is the table of another encoder? "
                "--force activates it"
            )

    def _staged(self, new: Correction, table: CorrectionTable) -> None:
        waiting = read_conditioning(self._module)

        def act() -> None:
            write_conditioning(self._module, new.conditioning)
            stage(self._module, table)

        def back() -> None:
            write_conditioning(self._module, waiting)

        change(self._module, self._guard, act, back, what=AS_IT_WAS, undone=self._as_before)

    def _as_before(self) -> str:
        return f"the table and the conditioning from before are in force in {self._module.name}"

    def _in_force(
        self, before: Correction, new: Correction | None, keep: bool, put: Callable[[], None]
    ) -> dict[str, Any]:
        """A failure leaves ``before``."""
        if keep:
            check_can_save(self._module)
        staged = self._module.integer(*od.TABLE_STAGED_CRC, "I")
        waiting = read_conditioning(self._module)

        def act() -> None:
            put()
            if new is not None and read_active(self._module).crc32 != new.crc32:
                raise CommissioningError(f"{self._module.name}: another table is active than was written")

        def back() -> None:
            put_in_force_again(self._module, before)
            if self._module.integer(*od.TABLE_STAGED_CRC, "I") == staged:
                write_conditioning(self._module, waiting)

        saved_as = change(
            self._module, self._guard, act, back, what=AS_IT_WAS, undone=self._as_before, keep=keep
        )
        return {"staged": False, "active": True, "saved_as": saved_as}

    def _state_after(self, used: Correction | None, done: dict[str, Any]) -> TableState:
        try:
            return TableState.of_module(self._module)
        except CanfbError as error:
            table = "table" if used is None or used.table is None else f"table {used.crc32:08X}h"
            where = "in force" if done["active"] else "staged"
            saved = f", saved ({done['saved_as']})" if done["saved_as"] else ""
            raise CommissioningError(
                f"done: {table} {where} in {self._module.name}{saved}; but then {error}"
            ) from error

    def _moves(self, state: TableState, before: Correction, after: Correction) -> str:
        _, apart = difference(before.table, after.table)
        words = f"positions move by at most {state.cycles_in_words(apart)}"
        same = before.conditioning == after.conditioning
        return words if same else f"{words}, and with the conditioning, which changes too"

    def _outcome(self, used: Correction, done: dict[str, Any]) -> list[str]:
        if not done["active"]:
            return []
        what = "no table" if used.table is None else f"table {used.crc32:08X}h"
        saved = f"saved ({done['saved_as']})" if done["saved_as"] else "not saved: --save keeps it"
        return [f"{what} in force in {self._module.name}; {saved}"]


def _result(state: TableState, lines: list[str], done: dict[str, Any]) -> Result:
    return Result(as_figures(state.rows()) | done, lines)
