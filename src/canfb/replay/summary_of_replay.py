"""What a replay found: for people, for programs."""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Any

from canfb.replay.findings import KINDS, Extreme, LogDrift
from canfb.replay.module_replay import ModuleReplay
from canfb.rows import Row, as_figures, as_lines

RPM = 60.0 / (2.0 * math.pi)
SHOWN_FAULTS = 10
SHOWN_CHANNELS = 6
PERCENT = 100.0
PER_INTERVAL = "cycles per interval²"


def figures(replay: ModuleReplay, drift: LogDrift | None, left_out: int = 0) -> dict[str, Any]:
    """All figures; None for what is not known. Times are stamps of the log, seconds.

    ``left_out``: frames of this module on channels of the log that were not taken.
    """
    counters = replay.counters
    head = Row(
        node_id=replay.module.node.node_id,
        first_s=counters.first_s,
        last_s=counters.last_s,
        left_out=left_out,
        samples=replay.samples.rows - replay.faults.samples["missed"],
        faults={
            kind: {"times": replay.faults.times[kind], "samples": replay.faults.samples[kind]}
            for kind in KINDS
        },
        table_crc32=f"{replay.module.chain.correction.crc32:08X}",
        sent=counters.sent,
        compared={f"{can_id:03X}h": _compared(replay, can_id) for can_id in replay.compared},
        acceleration_rad_s2=replay.margins.acceleration_rad_s2,
        margins=as_figures(margin_facts(replay)),
    )
    return as_figures([head], other_facts(replay, drift))


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

    ``left_out`` as for :func:`figures`: then it is not known whether there were none.
    """
    missing = f"; {left_out} frames with CAN-IDs of this module were left out (--channel)" if left_out else ""
    samples = replay.samples.rows - replay.faults.samples["missed"]
    if not samples:
        return f"no sample came to the module: look at --encoder-interface, --begin and --channel{missing}"
    bad = [f"{times} × {kind}" for kind, times in replay.faults.times.items() if times]
    found = ", ".join(bad) if bad else "none in what was taken" if left_out else "none"
    return f"{samples} samples; faults: {found}{missing}"


def lines(replay: ModuleReplay, drift: LogDrift | None, left_out: int = 0) -> list[str]:
    """For the terminal; ``left_out`` as for :func:`figures`."""
    faults = fault_words(replay)
    rows = [Row("samples", verdict(replay, left_out)), *margin_facts(replay), *other_facts(replay, drift)]
    rows += [Row("fault", text) for text in faults[:SHOWN_FAULTS]]
    if len(faults) > SHOWN_FAULTS:
        rows.append(Row("", f"... and {sum(replay.faults.times.values()) - SHOWN_FAULTS} more"))
    return as_lines([*rows, *comparison_facts(replay)])


def fault_words(replay: ModuleReplay) -> list[str]:
    """The faults that are listed, one line each."""
    first = replay.counters.first_s
    return [
        f"{fault.begin_s - first:.6f} s: {fault.kind}, {fault.samples} "
        f"{'interval' if fault.samples == 1 else 'intervals'}"
        for fault in replay.faults.in_order()
    ]


def margin_facts(replay: ModuleReplay) -> list[Row]:
    """How near it came to each limit, and when (seconds from the beginning of the log)."""
    margins, first_s = replay.margins, replay.counters.first_s
    rows = [
        ("residual", "residual", margins.residual, "cycles", 1.0, ".4f"),
        ("lowest amplitude", "amplitude_low", margins.amplitude_low, "counts", 1.0, ".0f"),
        ("highest amplitude", "amplitude_high", margins.amplitude_high, "counts", 1.0, ".0f"),
        ("acceleration", "acceleration_cycles", margins.acceleration, PER_INTERVAL, 1.0, ".4f"),
        (
            "acceleration (2010:02)",
            "machine_acceleration_cycles",
            margins.machine_acceleration,
            PER_INTERVAL,
            1.0,
            ".4f",
        ),
        ("speed", "speed_rad_s", margins.speed_rad_s, "rpm", RPM, ".1f"),
    ]
    return [
        Row(name, _margin_words(one, unit, factor, form, first_s), **{key: _extreme(one)})
        for name, key, one, unit, factor, form in rows
    ]


def _extreme(found: Extreme) -> dict[str, float | None]:
    return {name: _known(getattr(found, name)) for name in ("value", "limit", "margin", "time_s")}


def _margin_words(found: Extreme, unit: str, factor: float, form: str, first_s: float) -> str | None:
    if math.isnan(found.value):
        return None
    value = f"{found.value * factor:{form}}"
    when = f"at {found.time_s - first_s:.3f} s"
    if not math.isfinite(found.limit):
        return f"{value} {unit} {when}"
    return f"{value} of {found.limit * factor:{form}} {unit} {when}; margin {PERCENT * found.margin:.0f} %"


def other_facts(replay: ModuleReplay, drift: LogDrift | None) -> list[Row]:
    """Drift, and what was odd about the log."""
    times, counters = replay.times, replay.counters
    odd = (
        ("restarts", "restarts", counters.restarts, "power-ups of the recorded module within the log"),
        ("clock", "steps_back", times.steps_back, "times the clock of the log was set back"),
        ("gaps", "gaps", times.gaps, "silences of more than a minute, each replayed as one of a minute"),
        ("time stamps", None, times.bad, "that are no numbers"),
        ("EMCY", "emergencies", replay.faults.emergencies_sent, "sent"),
    )
    return [
        Row(
            "drift from the table",
            None if drift is None else _drift_words(drift),
            drift=drift and _drift(drift),
        ),
        *(
            Row(name, f"{count} {text}" if count else None, **({key: count} if key else {}))
            for name, key, count, text in odd
        ),
    ]


def _drift(drift: LogDrift) -> dict[str, Any]:
    return {
        "rms_cycles": _known(drift.rms),
        "peak_cycles": _known(drift.peak),
        "uncertainty_rms_cycles": _known(drift.uncertainty_rms),
        "reason": drift.reason,
    }


def _drift_words(drift: LogDrift) -> str:
    if drift.reason is not None:
        return f"not seen: {drift.reason}"
    return (
        f"{PERCENT * drift.rms:.3f} % rms, {PERCENT * drift.peak:.3f} % peak of a cycle, known to "
        f"{PERCENT * drift.uncertainty_rms:.3f} %"
    )


def comparison_facts(replay: ModuleReplay) -> list[Row]:
    """What the recorded module sent against the replay, by CAN-ID."""
    rows: list[Row] = []
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
        rows.append(Row(f"recorded {can_id:03X}h", ", ".join(words)))
        if found.first is not None:
            at = found.first.time_s - replay.counters.first_s
            first = f"{found.first.recorded.hex()} recorded, {found.first.replayed.hex()} replayed"
            rows.append(Row("", f"first at {at:.6f} s: {first}"))
        fields = replay.fields(can_id)
        for one in [] if fields is None else fields.differences:
            if one.pairs:
                how = f"by {one.least:g}" if one.is_constant else f"by {one.least:g} to {one.most:g}"
                rows.append(Row("", f"{one.name} differs {how}"))
    return rows


def log_facts(counters: Any, trouble: str | None) -> list[Row]:
    """What was left out of the log and why; the channels first."""
    left_out = {name: sum(one.values()) for name, one in sorted(counters.left_out.items())}
    damaged = f"damaged lines left out, the first is line {counters.first_damaged_line}"
    counted = (
        (counters.damaged_lines, damaged),
        (counters.error_frames, "error frames left out"),
        (counters.not_canopen, "frames with 29-bit identifiers or CAN FD left out"),
    )
    return [
        Row(
            frames=counters.frames,
            damaged_lines=counters.damaged_lines,
            channels=sorted(counters.channels),
            left_out=left_out,
        ),
        *(Row("log", text) for text in channel_facts(counters)),
        *(Row("log", f"{number} {text}") for number, text in counted if number),
        Row("log", trouble, trouble=trouble),
    ]


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
