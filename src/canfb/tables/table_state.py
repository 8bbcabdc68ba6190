"""A correction table as it stands in a module or in a file, in figures and in words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from canfb import objects as od
from canfb.calibration.figures import peak, root_mean
from canfb.master.access import NodeAccess, ObjectAbsentError
from canfb.master.active_table import read_active, read_conditioning
from canfb.master.provenance import Provenance
from canfb.rows import Result, Row, as_figures, as_lines
from canfb.signal.conditioning import Conditioning
from canfb.signal.correction import Correction, CorrectionTable
from canfb.tables.table_file import TableFile, conditioning_in_words, conditioning_words, table_words

DEGREES = 360.0
WIDTH = 17


@dataclass(frozen=True)
class TableState:
    """A table with its conditioning.

    name                    of the node or the file
    cycles_per_revolution   None if not known
    in_file                 it is that of a file: nothing is staged, active or saved
    staged_crc32            2020:02, 0: nothing is staged
    saved_crc32             2020:06, 0: the identity; None where the module does not say it
    waiting                 2002h and 2005h where they are not in force: those of the next activation
    """

    name: str
    used: Correction
    cycles_per_revolution: int | None
    in_file: bool = False
    staged_crc32: int = 0
    saved_crc32: int | None = None
    waiting: Conditioning | None = None

    @classmethod
    def of_module(cls, module: NodeAccess) -> TableState:
        """Read it. CommissioningError where that does not work."""
        used = read_active(module)
        cycles = module.integer(*od.ENCODER_CYCLES_PER_REVOLUTION, "I")
        staged = module.integer(*od.TABLE_STAGED_CRC, "I")
        written = read_conditioning(module)
        waiting = None if written == used.conditioning else written
        try:
            saved: int | None = module.integer(*od.TABLE_SAVED_CRC, "I")
        except ObjectAbsentError:
            saved = None
        return cls(module.name, used, cycles, False, staged, saved, waiting)

    @classmethod
    def of_file(cls, file: TableFile) -> TableState:
        """What a file holds."""
        return cls(str(file.path), file.used, file.cycles_per_revolution, True)

    @property
    def saved(self) -> bool | None:
        """Whether a reset brings this very table back; None if that is not known."""
        return None if self.in_file or self.saved_crc32 is None else self.saved_crc32 == self.used.crc32

    def rows(self) -> list[Row]:
        """What there is to say of it: cycles, degrees of the cycle."""
        used, waiting, in_module = self.used, self.waiting, not self.in_file
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
        """For ``canfb table show``."""
        return Result(as_figures(self.rows()), [self.name, *as_lines(self.rows(), WIDTH)])

    def cycles_in_words(self, cycles: float) -> str:
        """A part of a cycle, in degrees as well, and as an angle of the shaft where that is known."""
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
