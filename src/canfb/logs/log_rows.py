"""A log of a folder as rows of a table: one for each module. What is wrong with a log is in its rows."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from canfb.errors import CanfbError
from canfb.logs.log_replay import LogReplayed, ReplayOptions, replay_log
from canfb.replay.fault_list import KINDS
from canfb.replay.summary_of_replay import figures as figures_of

MARGINS = {
    "residual": "residual_cycles",
    "amplitude_low": "lowest_amplitude_counts",
    "amplitude_high": "highest_amplitude_counts",
    "acceleration_cycles": "acceleration_cycles",
    "speed_rad_s": "speed_rad_s",
}

COLUMNS: dict[str, type] = {
    "log": str,
    "module": int,
    "error": str,
    "frames": int,
    "damaged_lines": int,
    "trouble": str,
    "left_out": int,
    "first_s": float,
    "last_s": float,
    "samples": int,
    **dict.fromkeys(KINDS, int),
    **{f"{kind}_times": int for kind in KINDS},
    "emergencies": int,
    **{name: float for column in MARGINS.values() for name in (column, f"{column}_margin")},
    "acceleration_rad_s2": float,
    "drift_rms_cycles": float,
    "drift_peak_cycles": float,
    "drift_uncertainty_rms_cycles": float,
    "drift_reason": str,
    "table_crc32": str,
    "compared_equal": int,
    "compared_different": int,
    "compared_missing": int,
    "restarts": int,
    "steps_back": int,
    "gaps": int,
    "fingerprint": str,
}
"""The columns. A column named as a kind of fault counts intervals, ``..._times`` how often it began;
``..._margin`` is the part of the limit that was left. ``left_out``: frames of the module on other channels
of the log than the chosen one. ``error`` says why there is nothing else."""

Row = dict[str, Any]


@dataclass(frozen=True)
class LogJob:
    """A log to do: its name within the folder, where it is, and what its result is the result of."""

    name: str
    path: Path
    size: int
    fingerprint: str


def job_of(folder: Path, path: Path, settings: ReplayOptions) -> LogJob:
    """The job for a log. OSError if it has gone.

    Its fingerprint is of size and time of change of the file, the settings, what is saved in their
    state_dir, the columns, and the version of canfb: another one, and the log is done again.
    """
    status = path.stat()
    saved = [
        (one.name, one.read_bytes())
        for one in sorted(settings.state_dir.glob("*.bin") if settings.state_dir else [])
    ]
    parts = (version("canfb"), tuple(COLUMNS), status.st_size, status.st_mtime_ns, _in_words(settings), saved)
    digest = hashlib.sha256(repr(parts).encode()).hexdigest()[:32]
    return LogJob(str(path.relative_to(folder)), path, status.st_size, digest)


def _in_words(settings: ReplayOptions) -> tuple[str, ...]:
    used = settings.correction
    table = "" if used is None or used.table is None else used.table.to_bytes().hex()
    conditioning = "" if used is None else repr(used.conditioning)
    return (
        repr(settings.modules),
        table,
        conditioning,
        repr(used is None),
        settings.begin.value,
        repr(settings.channel),
        repr(settings.drift),
    )


def rows_of(job: LogJob, settings: ReplayOptions) -> list[Row]:
    """Its rows, whatever is the matter with it."""
    try:
        replayed = replay_log(job.path, settings)
    except CanfbError as error:
        return failed_rows(job, settings, str(error))
    except Exception as error:  # one log must not cost the others
        return failed_rows(job, settings, f"{type(error).__name__}: {' '.join(str(error).split())}")
    return [_row(job, replayed, place) for place in range(len(replayed.replays))]


def failed_rows(job: LogJob, settings: ReplayOptions, why: str) -> list[Row]:
    """Rows of a log that could not be done."""
    empty: Row = dict.fromkeys(COLUMNS)
    return [
        empty | {"log": job.name, "module": module.node_id, "error": why, "fingerprint": job.fingerprint}
        for module in settings.modules
    ]


def _row(job: LogJob, replayed: LogReplayed, place: int) -> Row:
    replay, counters = replayed.replays[place], replayed.log.counters
    figures = figures_of(replay, replayed.drifts[place], replayed.left_out(replay))
    faults, margins, drift = figures["faults"], figures["margins"], figures["drift"] or {}
    pairs = figures["compared"].values()
    row: Row = {
        "log": job.name,
        "module": figures["node_id"],
        "error": None,
        "frames": counters.frames,
        "damaged_lines": counters.damaged_lines,
        "trouble": replayed.log.trouble,
        **{kind: faults[kind]["samples"] for kind in KINDS},
        **{f"{kind}_times": faults[kind]["times"] for kind in KINDS},
        "drift_rms_cycles": drift.get("rms_cycles"),
        "drift_peak_cycles": drift.get("peak_cycles"),
        "drift_uncertainty_rms_cycles": drift.get("uncertainty_rms_cycles"),
        "drift_reason": drift.get("reason"),
        "compared_equal": sum(one["equal"] for one in pairs),
        "compared_different": sum(one["different"] for one in pairs),
        "compared_missing": sum(one["only_recorded"] + one["only_replayed"] for one in pairs),
        "fingerprint": job.fingerprint,
    }
    for name, column in MARGINS.items():
        row |= {column: margins[name]["value"], f"{column}_margin": margins[name]["margin"]}
    return {name: row[name] if name in row else figures[name] for name in COLUMNS}
