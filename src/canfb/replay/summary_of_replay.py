"""What a replay found: for people, for programs."""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Any

from canfb.replay.drift_of_log import LogDrift
from canfb.replay.fault_list import KINDS
from canfb.replay.margins import Extreme
from canfb.replay.module_replay import ModuleReplay

RPM = 60.0 / (2.0 * math.pi)
WIDTH = 24
SHOWN_FAULTS = 10
SHOWN_CHANNELS = 6
PERCENT = 100.0


def as_json(replay: ModuleReplay, drift: LogDrift | None, left_out: int = 0) -> dict[str, Any]:
    """All figures; None for what is not known. Times are stamps of the log, seconds.

    ``left_out``: frames of this module on channels of the log that were not taken.
    """
    counters, times, margins = replay.counters, replay.times, replay.margins
    table = replay.module.chain.correction
    return {
        "node_id": replay.module.node.node_id,
        "first_s": counters.first_s,
        "last_s": counters.last_s,
        "left_out": left_out,
        "samples": replay.samples.rows - replay.faults.samples["missed"],
        "faults": {
            kind: {"times": replay.faults.times[kind], "samples": replay.faults.samples[kind]}
            for kind in KINDS
        },
        "emergencies": replay.faults.emergencies_sent,
        "margins": {
            "residual": _extreme(margins.residual),
            "amplitude_low": _extreme(margins.amplitude_low),
            "amplitude_high": _extreme(margins.amplitude_high),
            "acceleration_cycles": _extreme(margins.acceleration),
            "machine_acceleration_cycles": _extreme(margins.machine_acceleration),
            "speed_rad_s": _extreme(margins.speed_rad_s),
        },
        "acceleration_rad_s2": margins.acceleration_rad_s2,
        "drift": None if drift is None else _drift(drift),
        "table_crc32": f"{table.crc32:08X}",
        "sent": counters.sent,
        "compared": {f"{can_id:03X}h": _compared(replay, can_id) for can_id in replay.compared},
        "restarts": counters.restarts,
        "steps_back": times.steps_back,
        "gaps": times.gaps,
    }


def _extreme(found: Extreme) -> dict[str, float | None]:
    return {name: _known(getattr(found, name)) for name in ("value", "limit", "margin", "time_s")}


def _drift(found: LogDrift) -> dict[str, Any]:
    return {
        "rms_cycles": _known(found.rms),
        "peak_cycles": _known(found.peak),
        "uncertainty_rms_cycles": _known(found.uncertainty_rms),
        "reason": found.reason,
    }


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _compared(replay: ModuleReplay, can_id: int) -> dict[str, Any]:
    found = replay.compared[can_id]
    words: dict[str, Any] = {
        name: getattr(found, name) for name in ("equal", "different", "only_recorded", "only_replayed")
    }
    if found.first is not None:
        words["first_different"] = {
            "time_s": found.first.time_s,
            "recorded": found.first.recorded.hex(),
            "replayed": found.first.replayed.hex(),
        }
    fields = replay.fields(can_id)
    if fields is not None and fields.differences:
        words["objects"] = {
            one.name: {"pairs": one.pairs, "least": _known(one.least), "most": _known(one.most)}
            for one in fields.differences
        }
    return words


def verdict(replay: ModuleReplay, left_out: int = 0) -> str:
    """One line: is it the position of the recorded module, and were there faults?

    ``left_out`` as for :func:`as_json`: then it is not known whether there were none.
    """
    missing = f"; {left_out} frames with CAN-IDs of this module were left out (--channel)" if left_out else ""
    samples = replay.samples.rows - replay.faults.samples["missed"]
    if not samples:
        return f"no sample came to the module: look at --encoder-interface, --begin and --channel{missing}"
    bad = [f"{times} × {kind}" for kind, times in replay.faults.times.items() if times]
    found = ", ".join(bad) if bad else "none in what was taken" if left_out else "none"
    return f"{samples} samples; faults: {found}{missing}"


def lines_of(replay: ModuleReplay, drift: LogDrift | None, left_out: int = 0) -> list[str]:
    """For the terminal; ``left_out`` as for :func:`as_json`."""
    lines = [f"{'samples':{WIDTH}}{verdict(replay, left_out)}"]
    lines += [f"{name:{WIDTH}}{text}" for name, text in margin_facts(replay)]
    lines += [f"{name:{WIDTH}}{text}" for name, text in other_facts(replay, drift)]
    faults = replay.faults.in_order()
    lines += [f"{'fault':{WIDTH}}{text}" for text in fault_words(replay)[:SHOWN_FAULTS]]
    if len(faults) > SHOWN_FAULTS:
        lines.append(f"{'':{WIDTH}}... and {sum(replay.faults.times.values()) - SHOWN_FAULTS} more")
    lines += [f"{name:{WIDTH}}{text}" for name, text in comparison_facts(replay)]
    return lines


def fault_words(replay: ModuleReplay) -> list[str]:
    """The faults that are listed, one line each."""
    first = replay.counters.first_s
    return [
        f"{fault.begin_s - first:.6f} s: {fault.kind}, {fault.samples} "
        f"{'interval' if fault.samples == 1 else 'intervals'}"
        for fault in replay.faults.in_order()
    ]


def margin_facts(replay: ModuleReplay) -> list[tuple[str, str]]:
    """How near it came to each limit, and when (seconds from the beginning of the log)."""
    margins = replay.margins
    rows = [
        ("residual", margins.residual, "cycles", 1.0, ".4f"),
        ("lowest amplitude", margins.amplitude_low, "counts", 1.0, ".0f"),
        ("highest amplitude", margins.amplitude_high, "counts", 1.0, ".0f"),
        ("acceleration", margins.acceleration, "cycles per interval²", 1.0, ".4f"),
        ("acceleration (2010:02)", margins.machine_acceleration, "cycles per interval²", 1.0, ".4f"),
        ("speed", margins.speed_rad_s, "rpm", RPM, ".1f"),
    ]
    first = replay.counters.first_s
    return [
        (name, _margin_words(one, unit, factor, form, first))
        for name, one, unit, factor, form in rows
        if not math.isnan(one.value)
    ]


def _margin_words(found: Extreme, unit: str, factor: float, form: str, first_s: float) -> str:
    value = f"{found.value * factor:{form}}"
    when = f"at {found.time_s - first_s:.3f} s"
    if not math.isfinite(found.limit):
        return f"{value} {unit} {when}"
    return f"{value} of {found.limit * factor:{form}} {unit} {when}; margin {PERCENT * found.margin:.0f} %"


def other_facts(replay: ModuleReplay, drift: LogDrift | None) -> list[tuple[str, str]]:
    """Drift, and what was odd about the log."""
    times, counters = replay.times, replay.counters
    odd = {
        "restarts": (counters.restarts, "power-ups of the recorded module within the log"),
        "clock": (times.steps_back, "times the clock of the log was set back"),
        "gaps": (times.gaps, "silences of more than a minute, each replayed as one of a minute"),
        "time stamps": (times.bad, "that are no numbers"),
        "EMCY": (replay.faults.emergencies_sent, "sent"),
    }
    rows = [] if drift is None else [("drift from the table", _drift_words(drift))]
    return rows + [(name, f"{n} {text}") for name, (n, text) in odd.items() if n]


def _drift_words(drift: LogDrift) -> str:
    if drift.reason is not None:
        return f"not seen: {drift.reason}"
    return (
        f"{PERCENT * drift.rms:.3f} % rms, {PERCENT * drift.peak:.3f} % peak of a cycle, known to "
        f"{PERCENT * drift.uncertainty_rms:.3f} %"
    )


def comparison_facts(replay: ModuleReplay) -> list[tuple[str, str]]:
    """What the recorded module sent against the replay, by CAN-ID."""
    rows: list[tuple[str, str]] = []
    for can_id, found in replay.compared.items():
        words = [f"{found.equal} equal"]
        words += [
            f"{number} {name}"
            for number, name in (
                (found.different, "different"),
                (found.only_recorded, "only in the log"),
                (found.only_replayed, "only in the replay"),
            )
            if number
        ]
        rows.append((f"recorded {can_id:03X}h", ", ".join(words)))
        if found.first is not None:
            at = found.first.time_s - replay.counters.first_s
            first = f"{found.first.recorded.hex()} recorded, {found.first.replayed.hex()} replayed"
            rows.append(("", f"first at {at:.6f} s: {first}"))
        fields = replay.fields(can_id)
        for one in [] if fields is None else fields.differences:
            if one.pairs:
                how = f"by {one.least:g}" if one.is_constant else f"by {one.least:g} to {one.most:g}"
                rows.append(("", f"{one.name} differs {how}"))
    return rows


def log_facts(counters: Any, trouble: str | None) -> list[tuple[str, str]]:
    """What was left out of the log and why, for people; the channels first."""
    rows = [("log", text) for text in channel_facts(counters)]
    facts = [
        (counters.damaged_lines, f"damaged lines left out, the first is line {counters.first_damaged_line}"),
        (counters.error_frames, "error frames left out"),
        (counters.not_canopen, "frames with 29-bit identifiers or CAN FD left out"),
    ]
    rows += [("log", f"{number} {text}") for number, text in facts if number]
    return rows + ([("log", trouble)] if trouble else [])


def channel_facts(counters: Any) -> list[str]:
    """Channels of the log that were taken and left out; empty if the only one was taken."""
    if counters.left_out:
        number = sum(sum(one.values()) for one in counters.left_out.values())
        return [
            f"{number} frames of channel {_names(counters.left_out)} left out: "
            f"--channel takes those of {_names(counters.channels)} alone"
        ]
    if len(counters.channels) > 1:
        return [
            f"channels {_names(counters.channels)} are taken as one bus; "
            "if they are several, --channel takes one"
        ]
    return []


def _names(channels: Collection[str]) -> str:
    names = sorted(channels)
    if len(names) > SHOWN_CHANNELS:
        names[SHOWN_CHANNELS:] = [f"and {len(names) - SHOWN_CHANNELS} more"]
    return ", ".join(names)
