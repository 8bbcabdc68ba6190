"""A correction table as it stands in a module or in a file, in figures and in words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from canfb import objects as od
from canfb.calibration.evaluate import peak, root_mean
from canfb.master.access import NodeAccess, ObjectAbsentError
from canfb.master.active import read_active
from canfb.master.circumstances import Circumstances
from canfb.signal.correction import Correction, CorrectionTable
from canfb.tables.table_file import TableFile, conditioning_in_words, conditioning_words, table_words

DEGREES = 360.0


@dataclass(frozen=True)
class TableState:
    """A table with its conditioning.

    name                    of the node or the file
    cycles_per_revolution   None if not known
    in_file                 it is that of a file: nothing is staged, active or saved
    staged_crc32            2020:02, 0: nothing is staged
    saved_crc32             2020:06, 0: the identity; None where the module does not say it
    """

    name: str
    used: Correction
    cycles_per_revolution: int | None
    in_file: bool = False
    staged_crc32: int = 0
    saved_crc32: int | None = None

    @classmethod
    def of_module(cls, module: NodeAccess) -> TableState:
        """Read it. CommissioningError where that does not work."""
        used = read_active(module)
        cycles = module.integer(*od.ENCODER_CYCLES_PER_REVOLUTION, "I")
        staged = module.integer(*od.TABLE_STAGED_CRC, "I")
        try:
            saved = module.integer(*od.TABLE_SAVED_CRC, "I")
        except ObjectAbsentError:
            return cls(module.name, used, cycles, False, staged)
        return cls(module.name, used, cycles, False, staged, saved)

    @classmethod
    def of_file(cls, file: TableFile) -> TableState:
        """What a file holds."""
        return cls(str(file.path), file.used, file.cycles_per_revolution, True)

    @property
    def saved(self) -> bool | None:
        """Whether a reset brings this very table back; None if that is not known."""
        return None if self.in_file or self.saved_crc32 is None else self.saved_crc32 == self.used.crc32

    def figures(self) -> dict[str, Any]:
        """For programs: cycles, degrees of the cycle."""
        rms, high = difference(self.used.table, None)
        return {
            "name": self.name,
            "crc32": f"{self.used.crc32:08X}",
            "entries": 0 if self.used.table is None else len(self.used.table),
            "deviation_rms_cycles": rms,
            "deviation_peak_cycles": high,
            "deviation_rms_degrees": DEGREES * rms,
            "deviation_peak_degrees": DEGREES * high,
            "cycles_per_revolution": self.cycles_per_revolution,
            "conditioning": conditioning_words(self.used.conditioning),
            "staged_crc32": None if self.in_file else f"{self.staged_crc32:08X}",
            "saved_crc32": None if self.saved_crc32 is None else f"{self.saved_crc32:08X}",
            "saved": self.saved,
        }

    def lines(self) -> list[str]:
        """For people."""
        rms, high = difference(self.used.table, None)
        rows = [
            ("table" if self.in_file else "active table", table_words(self.used)),
            ("deviation, rms", self.cycles_in_words(rms)),
            ("deviation, peak", self.cycles_in_words(high)),
            ("conditioning", conditioning_in_words(self.used.conditioning) + self._waiting()),
        ]
        if not self.in_file:
            rows += [("staged", self._staged()), ("saved", self._saved())]
        return [self.name, *(f"{name:17}{text}" for name, text in rows)]

    def cycles_in_words(self, cycles: float) -> str:
        """A part of a cycle, in degrees as well, and as an angle of the shaft where that is known."""
        arc = Circumstances("", cycles_per_revolution=self.cycles_per_revolution).arc_seconds(cycles)
        shaft = "" if arc is None else f"; {arc:.2g}″ of the shaft"
        return f"{cycles:.3g} cycle ({DEGREES * cycles:.3g}° of the cycle{shaft})"

    def _waiting(self) -> str:
        """2002h cannot be read as it is in force, only as it will be."""
        return "" if self.staged_crc32 in (0, self.used.crc32) else "; in force with the next activation"

    def _staged(self) -> str:
        if not self.staged_crc32:
            return "nothing"
        active = "the active one" if self.staged_crc32 == self.used.crc32 else "not active"
        return f"{self.staged_crc32:08X}h, {active}"

    def _saved(self) -> str:
        if self.saved is None:
            return "not known: this module does not say it (2020:06)"
        if self.saved:
            return "yes" if self.used.crc32 else "none is saved, none is active"
        kept = f"{self.saved_crc32:08X}h" if self.saved_crc32 else "none"
        return f"no: after a reset the table is {kept}"


def difference(one: CorrectionTable | None, other: CorrectionTable | None) -> tuple[float, float]:
    """How far two tables are from each other, cycles: rms and peak over the cycle; None is the identity."""
    length = max(len(table) for table in (one, other) if table is not None) if one or other else 1
    raw = np.arange(length) / length
    apart = (_phases(one, raw) - _phases(other, raw) + 0.5) % 1.0 - 0.5
    return root_mean(apart), peak(apart)


def _phases(table: CorrectionTable | None, raw: np.ndarray[Any, Any]) -> Any:
    return raw if table is None else table(raw)
