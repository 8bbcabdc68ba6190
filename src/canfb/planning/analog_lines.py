"""What the analog path of a module does at the highest speed of a plan, in words."""

from __future__ import annotations

import math

from canfb import objects as od
from canfb.planning.planned_module import PlannedModule
from canfb.signal.conditioning import IDENTITY, Conditioning
from canfb.signal.front_end import LARGEST_RAD, FrontEnd

EXCEEDED = "   <- exceeded"


def analog_lines(module: PlannedModule, speed_rad_s: float | None) -> list[str]:
    """One line, none for a module that knows no delay and no low-pass (2002:06, 2002:07, 2001:05)."""
    hertz = (speed_rad_s or 0.0) * module.cycles_per_revolution / (2.0 * math.pi)
    used = Conditioning(
        *(
            float(module.values.get(place, default))
            for place, default in zip(od.CONDITIONING, IDENTITY.values, strict=True)
        )
    )
    corners = module.settings.corners
    front = FrontEnd(used, corners)
    front.use_interval(1.0)
    parts = []
    turned = front.turned_rad(hertz)
    exceeded = abs(turned) + abs(used.phase_error_rad) >= LARGEST_RAD
    if turned:
        parts.append(f"{turned / (2.0 * math.pi):+.3f} cycle between the tracks, removed")
    if corners.corner_hz:
        left = 1.0 / math.hypot(1.0, hertz / corners.corner_hz)
        parts.append(f"{100.0 * left:.0f} % of the amplitude left")
    if used.delay_s:
        parts.append(f"{front.lag_intervals(hertz) * hertz:+.3f} cycle of delay, added to the position")
    if not parts or not hertz:
        return []
    return [f"    analog path at {hertz / 1e3:.4g} kHz: {'; '.join(parts)}{EXCEEDED * exceeded}"]
