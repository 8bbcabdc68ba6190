"""Position and velocity in the units of the machine."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

RPM = 60.0 / (2.0 * math.pi)
SPELLING = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*([^\s\d.,;]{1,8})\s*", re.ASCII)


@dataclass(frozen=True)
class MachineUnits:
    """``per_revolution`` of ``name`` are one revolution of the encoder; by default 1 rev, and min⁻¹."""

    per_revolution: float = 1.0
    name: str = "rev"

    @classmethod
    def parse(cls, text: str) -> MachineUnits:
        """``"5 mm"``: 5 mm for each revolution. ValueError for anything else."""
        match = SPELLING.fullmatch(text)
        number = float(match[1]) if match else math.nan
        if match is None or not math.isfinite(number) or number == 0.0:
            raise ValueError(f"{text!r} is not a distance per revolution such as '5 mm' or '360 deg'")
        return cls(number, match[2])

    def position(self, revolutions: float | None) -> str:
        """In words, with the unit."""
        return "-" if revolutions is None else f"{revolutions * self.per_revolution:.5f} {self.name}"

    def velocity(self, rad_s: float | None) -> str:
        """In words, with the unit."""
        if rad_s is None:
            return "-"
        if self.name == "rev":
            return f"{rad_s * RPM:.2f} rpm"
        return f"{rad_s / (2.0 * math.pi) * self.per_revolution:.3f} {self.name}/s"
