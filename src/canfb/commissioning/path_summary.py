"""The analog path and the error over the speed: for the terminal, the report and programs."""

from __future__ import annotations

import math
from typing import Any

from canfb.calibration.path_fit import LowPass
from canfb.commissioning.circumstances import PERCENT, Circumstances, percent
from canfb.commissioning.error_over_speed import ErrorAtSpeed
from canfb.commissioning.speed_measurement import OverSpeeds

SAME_DELAY = 1e-3  # relative: REAL32
LOST = "position lost"


def speed_words(hertz: float, where: Circumstances) -> str:
    """A speed in rpm, or in cycles per second where the encoder is not known."""
    if not where.cycles_per_revolution:
        return f"{hertz:.6g} cycles/s"
    return f"{60.0 * hertz / where.cycles_per_revolution:.4g} rpm"


def speed_rows(over: OverSpeeds, where: Circumstances) -> list[tuple[str, str, str]]:
    """Error at each speed: rms before and after, then the mean."""
    rows = []
    for one in over.errors:
        before = LOST if one.before is None else percent(one.before, where)
        rows.append((f"{speed_words(one.hertz, where)}, rms", before, percent(one.after, where)))
    for one in over.errors:
        before = LOST if one.mean_before is None else percent(one.mean_before, where)
        rows.append((f"{speed_words(one.hertz, where)}, mean", before, percent(one.mean_after, where)))
    return rows


def path_facts(over: OverSpeeds, where: Circumstances) -> list[tuple[str, str]]:
    """Delay between the tracks, low-pass, delay; how sure each is."""
    path = over.path
    between = f"{path.cosine_delay_s * 1e9:.4g} ± {path.cosine_delay_sigma_s * 1e9:.2g} ns (2002:06)"
    if not path.cosine_delay_s:
        between = f"none; ± {path.cosine_delay_sigma_s * 1e9:.2g} ns"
    return [
        ("cosine after the sine", between),
        ("low-pass", _low_pass_words(over, where)),
        ("delay, by amplitude", delay_words(over.low_pass, where)),
        ("delay, 2002:07", delay_set_words(over)),
    ]


def delay_words(low_pass: LowPass, where: Circumstances) -> str:
    """What the amplitude over the speed says of the delay, and how sure that is."""
    at = speed_words(low_pass.top_hz, where)
    if low_pass.rises:
        return "not known: the amplitude rises with the speed"
    if not low_pass.is_seen:
        if not math.isfinite(low_pass.delay_sigma_s):
            return "not known: all measured speeds are of one size"
        return (
            f"none is seen up to {at}; one pole would delay by less than "
            f"{low_pass.delay_sigma_s * 1e6:.2g} µs. A delay of the converter does not show"
        )
    words = (
        f"{low_pass.delay_s * 1e6:.4g} ± {low_pass.delay_sigma_s * 1e6:.1g} µs, "
        f"{low_pass.delay_cycles(low_pass.top_hz):.3g} ± "
        f"{low_pass.delay_sigma_cycles(low_pass.top_hz):.1g} cycle at {at}, if the low-pass has one pole; "
    )
    if low_pass.may_have_two_poles and low_pass.other is not None:
        return (
            f"{words}{low_pass.other.delay_s * 1e6:.3g} µs with two equal poles, which these speeds do not "
            "rule out: half of the highest speed would. Without the delay of the converter"
        )
    if not low_pass.is_one_pole:
        return (
            f"{words}but the amplitude is up to {PERCENT * low_pass.misfit:.2g} % away from that of one "
            "pole: take the delay from data sheets"
        )
    return f"{words}the amplitudes agree with that. Without the delay of the converter"


def delay_set_words(over: OverSpeeds) -> str:
    """What 2002:07 is to be, and how to change that."""
    estimate, delay_s = over.low_pass.delay_s, over.delay_s
    if delay_s and abs(delay_s - estimate) <= SAME_DELAY * estimate:
        return f"{delay_s * 1e6:.4g} µs, as estimated"
    if delay_s:
        return f"{delay_s * 1e6:.4g} µs, as given"
    return "0: no delay is removed" + (" (--delay estimate)" if estimate else "")


def path_json(over: OverSpeeds) -> dict[str, Any]:
    """For programs; cycles, seconds, hertz."""
    path, low_pass, corners = over.path, over.low_pass, over.after.corners
    seen = low_pass.is_seen
    sigma_s = low_pass.delay_sigma_s
    return {
        "speeds": [_speed_json(one) for one in over.errors],
        "cosine_delay_s": path.cosine_delay_s,
        "cosine_delay_uncertainty_s": path.cosine_delay_sigma_s,
        "corner_hz": corners.corner_hz,
        "corner_uncertainty_hz": low_pass.corner_sigma_hz if seen else None,
        "cosine_corner_hz": corners.cosine_corner_hz,
        "amplitude_left": low_pass.left,
        "delay_estimate_s": low_pass.delay_s if seen else None,
        "delay_estimate_uncertainty_s": sigma_s if math.isfinite(sigma_s) else None,
        "delay_estimate_two_poles_s": (
            low_pass.other.delay_s if low_pass.may_have_two_poles and low_pass.other else None
        ),
        "delay_estimate_one_pole": low_pass.is_one_pole and low_pass.checked,
        "delay_s": over.delay_s,
    }


def _speed_json(one: ErrorAtSpeed) -> dict[str, Any]:
    return {
        "cycles_per_s": one.hertz,
        "before_rms_cycles": one.before,
        "after_rms_cycles": one.after,
        "before_mean_cycles": one.mean_before,
        "after_mean_cycles": one.mean_after,
        "held_out_samples": len(one.deviation.error),
    }


def _low_pass_words(over: OverSpeeds, where: Circumstances) -> str:
    low_pass, corners = over.low_pass, over.after.corners
    if low_pass.rises:
        return "none: the amplitude rises with the speed"
    if not low_pass.is_seen:
        return "none is seen"
    words = f"{corners.corner_hz / 1e3:.4g} ± {low_pass.corner_sigma_hz / 1e3:.1g} kHz"
    if corners.cosine_corner_hz:
        words += f", cosine {corners.cosine_corner_hz / 1e3:.4g} kHz"
    left, at = PERCENT * low_pass.left, speed_words(low_pass.top_hz, where)
    return f"{words} (2001:05, 2001:06): {left:.0f} % of the amplitude at {at}"
