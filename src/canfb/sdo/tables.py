"""Correction tables as files (YAML, or the bytes of 2020:01), and the changes that ``canfb table`` makes in a
module, as a whole or not at all."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from canfb import objects as od
from canfb.calibration.result import peak, root_mean
from canfb.errors import saying
from canfb.files import read_bytes, write_whole
from canfb.marked_yaml import MarkedYaml
from canfb.master.access import CommissioningError, NodeAccess, as_real32, but_then
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
from canfb.master.machine_watch import Provenance
from canfb.master.session import AMPLITUDES
from canfb.rows import Result, Row, as_figures, as_lines
from canfb.signal.conditioning import IDENTITY, Conditioning
from canfb.signal.correction import Correction, CorrectionTable
from canfb.signal.limits import PHASE_ERROR_CYCLES
from canfb.view.module_view import LIMIT_UNITS

DELAYS = frozenset({"cosine_delay_s", "delay_s"})
# Keys of a table file that describe encoder and analog path of the measurement.
NOTED = {
    "cycles_per_revolution": od.ENCODER_CYCLES_PER_REVOLUTION,
    "corner_hz": od.ENCODER_CORNER_FREQUENCY,
    "cosine_corner_hz": od.ENCODER_COSINE_CORNER_FREQUENCY,
}


def as_yaml(used: Correction, meta: dict[str, Any]) -> str:
    """YAML of ``meta``, conditioning and entries, in cycles."""
    table = used.table or CorrectionTable.identity()
    content = {
        "canfb_table": 1,
        **meta,
        "crc32": f"{table.crc32:08X}",
        "conditioning": conditioning_words(used.conditioning),
    }
    # Nine digits reproduce every REAL32 exactly.
    entries = [float(f"{value:.9g}") for value in table.entries.tolist()]
    head: str = yaml.safe_dump(content, sort_keys=False, allow_unicode=True)
    listed: str = yaml.safe_dump({"entries": entries}, default_flow_style=None, width=100)
    return (
        f"# Correction table of canfb: entries[n] is the phase, in cycles, at raw phase n/N.\n{head}{listed}"
    )


def conditioning_words(conditioning: Conditioning) -> dict[str, float]:
    """2002:01..07 by name, and the harmonics (2005h) that are not zero."""
    words = conditioning.words.items()
    return {name: float(value) for name, value in words if value or not name.startswith("harmonic")}


def table_words(used: Correction) -> str:
    return "none" if used.table is None else f"{used.crc32:08X}h, {len(used.table)} entries"


def conditioning_in_words(conditioning: Conditioning) -> str:
    if conditioning.is_identity:
        return "none"
    words = (
        f"offset {conditioning.sine_offset_counts:+.1f}/{conditioning.cosine_offset_counts:+.1f}, gain "
        f"{conditioning.sine_gain:.4f}/{conditioning.cosine_gain:.4f}, phase "
        f"{conditioning.phase_error_rad:+.4f} rad"
    )
    delays = (("cosine later by", conditioning.cosine_delay_s), ("delay", conditioning.delay_s))
    return ", ".join([words, *(f"{what} {delay_s * 1e6:.4g} µs" for what, delay_s in delays if delay_s)])


@dataclass(frozen=True)
class TableFile:
    """The content of a table file.

    with_conditioning   False for bytes of 2020:01
    with_delays         it contains 2002:06 and 2002:07
    noted               values of :data:`NOTED`
    """

    path: Path
    used: Correction
    with_conditioning: bool
    noted: Mapping[od.Multiplexer, float] = field(default_factory=dict)
    with_delays: bool = False

    @property
    def cycles_per_revolution(self) -> int | None:
        """None if not noted."""
        cycles = self.noted.get(od.ENCODER_CYCLES_PER_REVOLUTION)
        return None if cycles is None else int(cycles)

    def for_module(self, active: Conditioning) -> Correction:
        """The correction for a module; parts of 2002h that the file lacks are ``active``."""
        if not self.with_conditioning:
            return Correction(self.used.table, active)
        if self.with_delays:
            return self.used
        return Correction(self.used.table, self.used.conditioning.with_delays_of(active))


def read_table(path: Path) -> TableFile:
    """Read a table file; CommissioningError if it is not a table."""
    data = read_bytes(path, CommissioningError)
    with saying(CommissioningError, f"{path}: this is not a correction table", ValueError, TypeError):
        if is_yaml(path):
            return _from_yaml(path, data)
        return TableFile(path, Correction(CorrectionTable.from_bytes(data), IDENTITY), False)


def is_yaml(path: Path) -> bool:
    return path.suffix.lower() in (".yaml", ".yml")


def _from_yaml(path: Path, data: bytes) -> TableFile:
    marked = MarkedYaml(data)
    content = marked.content
    if not isinstance(content, dict) or "entries" not in content:
        raise ValueError("a mapping with 'entries' is required")
    table, words = table_in(marked, content), content.get("conditioning") or {}
    check_keys(marked, words, IDENTITY.words, (), "conditioning")
    noted = {place: content.get(key) for key, place in NOTED.items()}
    return TableFile(
        path,
        Correction(table, _conditioning(marked, words)),
        True,
        {at: value for at, value in noted.items() if isinstance(value, (int, float)) and 0 <= value < 1e9},
        not DELAYS.isdisjoint(words),
    )


def table_in(marked: MarkedYaml, content: Any, *above: str) -> CorrectionTable:
    """The table of the entries, checked by crc32 if present. ValueError with the line."""
    try:
        table = CorrectionTable(content["entries"])
    except (ValueError, TypeError) as error:
        raise wrong(marked, str(error), *above, "entries") from None
    noted = content.get("crc32")
    if noted is not None and str(noted).upper() != f"{table.crc32:08X}":
        said = f"the CRC of the entries is {table.crc32:08X}, the file states {noted}: an entry was changed"
        raise wrong(marked, said, *above, "crc32")
    return table


def check_keys(
    marked: MarkedYaml, content: Any, known: Collection[str], needed: Collection[str], *above: str
) -> None:
    """ValueError unless ``content`` is a mapping with these keys."""
    if not isinstance(content, dict):
        raise wrong(marked, f"must be a mapping with {', '.join(known)}, not {content!r}", *above)
    for key in content:
        if key not in known:
            raise wrong(marked, f"unknown key; known are {', '.join(known)}", *above, key)
    for key in needed:
        if key not in content:
            raise wrong(marked, f"{key!r} is missing", *above)


def wrong(marked: MarkedYaml, text: str, *keys: Any) -> ValueError:
    names = [str(key) for key in keys]
    return ValueError(f"line {marked.line(*names)}: {'.'.join(names)}{': ' * bool(names)}{text}")


def _conditioning(marked: MarkedYaml, words: dict[str, float]) -> Conditioning:
    try:
        Conditioning(**words)  # ValueError for a value that is not a number
        return Conditioning(**{key: as_real32(value) for key, value in words.items()})
    except ValueError as error:
        named = [key for key in words if str(error).startswith(key)]
        raise ValueError(f"line {marked.line('conditioning', *named)}: {error}") from None


DEGREES = 360.0
WIDTH = 17


@dataclass(frozen=True)
class TableState:
    """A table with its conditioning, in a module or a file.

    staged_crc32   2020:02, 0: nothing is staged; None: a file
    saved_crc32    2020:06, 0: the identity; None: not known
    waiting        2002h and 2005h, if not yet in force
    """

    name: str
    used: Correction
    cycles_per_revolution: int | None
    staged_crc32: int | None = None
    saved_crc32: int | None = None
    waiting: Conditioning | None = None

    @classmethod
    def of_module(cls, module: NodeAccess) -> TableState:
        used = read_active(module)
        cycles = module.integer(*od.ENCODER_CYCLES_PER_REVOLUTION, "I")
        staged = module.integer(*od.TABLE_STAGED_CRC, "I")
        written = read_conditioning(module)
        waiting = None if written == used.conditioning else written
        saved_crc32 = module.integer_if_there(od.TABLE_SAVED_CRC, "I")
        return cls(module.name, used, cycles, staged, saved_crc32, waiting)

    @property
    def saved(self) -> bool | None:
        """Whether a reset restores this table; None: not known."""
        return None if self.saved_crc32 is None else self.saved_crc32 == self.used.crc32

    def rows(self) -> list[Row]:
        used, waiting, in_module = self.used, self.waiting, self.staged_crc32 is not None
        rms, high = difference(used.table, None)
        return [
            Row(name=self.name, cycles_per_revolution=self.cycles_per_revolution),
            Row(
                "active table" if in_module else "table",
                table_words(used),
                crc32=f"{used.crc32:08X}",
                entries=0 if used.table is None else len(used.table),
            ),
            Row(
                "deviation, rms",
                self.cycles_in_words(rms),
                deviation_rms_cycles=rms,
                deviation_rms_degrees=DEGREES * rms,
            ),
            Row(
                "deviation, peak",
                self.cycles_in_words(high),
                deviation_peak_cycles=high,
                deviation_peak_degrees=DEGREES * high,
            ),
            Row(
                "conditioning",
                conditioning_in_words(used.conditioning),
                conditioning=conditioning_words(used.conditioning),
            ),
            Row(
                "waiting",
                f"{conditioning_in_words(waiting)}; in force with the next activation" if waiting else None,
                conditioning_waiting=conditioning_words(waiting) if waiting else None,
            ),
            Row(
                "staged",
                self._staged() if in_module else None,
                staged_crc32=f"{self.staged_crc32:08X}" if in_module else None,
            ),
            Row(
                "saved",
                self._saved() if in_module else None,
                saved_crc32=None if self.saved_crc32 is None else f"{self.saved_crc32:08X}",
                saved=self.saved,
            ),
        ]

    def result(self) -> Result:
        return Result(as_figures(self.rows()), [self.name, *as_lines(self.rows(), WIDTH)])

    def cycles_in_words(self, cycles: float) -> str:
        arc = Provenance("", cycles_per_revolution=self.cycles_per_revolution).arc_seconds(cycles)
        shaft = "" if arc is None else f"; {arc:.2g}″ of the shaft"
        return f"{cycles:.3g} cycle ({DEGREES * cycles:.3g}° of the cycle{shaft})"

    def _staged(self) -> str:
        if not self.staged_crc32:
            return "nothing"
        active = "the active one" if self.staged_crc32 == self.used.crc32 else "not active"
        return f"{self.staged_crc32:08X}h, {active}"

    def _saved(self) -> str:
        if self.saved is None:
            return "not known: this module does not report it (2020:06)"
        if self.saved:
            return "yes" if self.used.crc32 else "none is saved, none is active"
        kept = f"{self.saved_crc32:08X}h" if self.saved_crc32 else "none"
        return f"no: after a reset the table is {kept}"


def difference(one: CorrectionTable | None, other: CorrectionTable | None) -> tuple[float, float]:
    """Rms and peak of the difference, cycles; None is the identity."""
    length = max(len(table) for table in (one, other) if table is not None) if one or other else 1
    raw = np.arange(length) / length
    phases, others = (raw if table is None else np.asarray(table(raw)) for table in (one, other))
    apart = (phases - others + 0.5) % 1.0 - 0.5
    return root_mean(apart), peak(apart)


LOOKS, LOOK_S = 10, 0.01
AS_IT_WAS = "the previous table and conditioning"


class TableTasks:
    """Changes of the table of a module; ``guard`` protects the roll-back from interruption."""

    def __init__(self, module: NodeAccess, guard: Guard) -> None:
        self._module = module
        self._guard = guard

    def upload(self, file: TableFile, *, active: bool, keep: bool, force: bool = False) -> Result:
        """Stage the table of a file and verify it. ``active`` puts it in force, ``keep`` saves it.

        CommissioningError if anything fails or, unless ``force``, if the amplitude would leave its limits;
        at most a staged table is left then.
        """
        before, table = read_active(self._module), file.used.table
        assert table is not None  # every table file contains one
        new, notes = file.for_module(before.conditioning), self._other_settings(file)
        if active:
            self._check_amplitude(before.conditioning, new.conditioning, force)
            done = self._in_force(before, new, keep, lambda: put_in_force(self._module, new))
        else:
            done = self._staged(new, table)
        stays = "" if file.with_conditioning else "; it has no conditioning, that of the module stays"
        head = f"{file.path}: {table.crc32:08X}h, {len(table)} entries{stays}"
        return self._result(done, before, new, [head], notes)

    def activate(self, *, keep: bool, force: bool = False) -> Result:
        staged = self._module.integer(*od.TABLE_STAGED_CRC, "I")
        if not staged:
            raise CommissioningError(
                f"{self._module.name}: nothing is staged; canfb table write stages the table of a file"
            )
        before = read_active(self._module)
        self._check_amplitude(before.conditioning, read_conditioning(self._module), force)
        done = self._in_force(before, None, keep, lambda: activate(self._module, staged))
        return self._result(done, before, None)

    def clear(self, *, conditioning: bool, keep: bool) -> Result:
        """Activate the identity table; ``conditioning``: also reset the conditioning."""
        before = read_active(self._module)
        new = Correction(None, IDENTITY if conditioning else before.conditioning)
        done = self._in_force(before, new, keep, lambda: put_in_force(self._module, new))
        result = self._result(done, before, new)
        if not new.conditioning.is_identity:
            result.lines.append("the conditioning (2002h) stays in force; --conditioning clears it as well")
        return result

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
            **{key: self._module.read_known(place) for key, place in NOTED.items()},
        }
        write_whole(path, as_yaml(used, meta).encode() if is_yaml(path) else table.to_bytes())
        what = "the identity: no table is active" if state.used.table is None else "the active table"
        lines = [f"{path}: {what}, {table.crc32:08X}h, {len(table)} entries"]
        if not is_yaml(path) and not used.conditioning.is_identity:
            lines.append(
                f"note: {path} has the table alone; a name with .yaml keeps the conditioning as well"
            )
        return Result(as_figures(state.rows()) | {"file": str(path)}, lines)

    def _other_settings(self, file: TableFile) -> list[str]:
        """Values of 2001h that differ from the measurement; they are not part of a table, so set by hand."""
        node = f"{self._module.node_id:#04x}"
        return [
            f"note: it was measured with {text} = {value:.9g}, {self._module.name} has {there:.9g}: "
            f"canfb sdo write {node} {text} {value:.9g}, if that is right"
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

    def _staged(self, new: Correction, table: CorrectionTable) -> dict[str, Any]:
        waiting = read_conditioning(self._module)

        def act() -> None:
            write_conditioning(self._module, new.conditioning)
            stage(self._module, table)

        change(
            self._module,
            self._guard,
            act,
            lambda: write_conditioning(self._module, waiting),
            what=AS_IT_WAS,
            undone=self._as_before,
        )
        return {"staged": True, "active": False, "saved_as": None}

    def _as_before(self) -> str:
        return f"the table and the conditioning from before are in force in {self._module.name}"

    def _in_force(
        self, before: Correction, new: Correction | None, keep: bool, put: Callable[[], None]
    ) -> dict[str, Any]:
        """Put the change in force; a failure restores ``before``."""
        if keep:
            check_can_save(self._module)
        staged = self._module.integer(*od.TABLE_STAGED_CRC, "I")
        waiting = read_conditioning(self._module)
        declared = self._module.read_known(od.SUPERVISION_PHASE_ERROR)

        def act() -> None:
            if declared is not None and new is not None and new.table is None:
                # Without a table the phase error is at least the default.
                least = round(PHASE_ERROR_CYCLES * LIMIT_UNITS)
                self._module.write(*od.SUPERVISION_PHASE_ERROR, "H", max(declared, least))
            put()
            if new is not None and read_active(self._module).crc32 != new.crc32:
                raise CommissioningError(f"{self._module.name}: another table is active than was written")

        def back() -> None:
            put_in_force_again(self._module, before)
            if declared is not None:
                self._module.write(*od.SUPERVISION_PHASE_ERROR, "H", declared)
            if self._module.integer(*od.TABLE_STAGED_CRC, "I") == staged:
                write_conditioning(self._module, waiting)

        saved_as = change(
            self._module, self._guard, act, back, what=AS_IT_WAS, undone=self._as_before, keep=keep
        )
        return {"staged": False, "active": True, "saved_as": saved_as}

    def _result(
        self,
        done: dict[str, Any],
        before: Correction,
        new: Correction | None,
        head: Sequence[str] = (),
        notes: Sequence[str] = (),
    ) -> Result:
        """The new state of the module, and the shift of positions; ``new`` None: only staged."""
        saved = f"saved ({done['saved_as']})" if done["saved_as"] else ""
        what = "table" if new is None else f"table {new.crc32:08X}h" if new.table else "no table"
        where = "in force" if done["active"] else "staged"
        with but_then(f"{what} {where} in {self._module.name}{', ' * bool(saved)}{saved}"):
            state = TableState.of_module(self._module)
        used, module = new or state.used, self._module
        _, apart = difference(before.table, used.table)
        moves = f"positions move by at most {state.cycles_in_words(apart)}"
        if before.conditioning != used.conditioning:
            moves += ", and with the conditioning, which changes too"
        table = "no table" if used.table is None else f"table {used.crc32:08X}h"
        outcome = f"{table} in force in {module.name}; {saved or 'not saved: --save keeps it'}"
        if not done["active"]:
            outcome = f"staged in {module.name}, not in force yet: canfb table activate {module.node_id:#04x}"
        return Result(as_figures(state.rows()) | done, [*head, moves, *notes, outcome])
