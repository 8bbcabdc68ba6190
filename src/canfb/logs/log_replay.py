"""Replay of a bus log with its modules or other ones, and files of the results; all logs of a folder as one
table, which a second run completes, on all processors of this machine. A failing log does not end the others.

For larger tasks pass an ``executor``, such as ``dask.distributed.Client(address).get_executor()``, whose
workers see the logs under the same names.
"""

from __future__ import annotations

import contextlib
import csv
import hashlib
import multiprocessing
import os
from collections import deque
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from canfb.cia301.frame import Frame
from canfb.device.storage.storage import MemoryStore
from canfb.errors import CanfbError, ConfigError, reason, saying
from canfb.files import as_utf8, check_writable, replacing, writing
from canfb.hosting.state_files import SavedParameters
from canfb.logfile.bus_logs import BusLogFile
from canfb.logfile.log_files import is_log
from canfb.module.module_config import ModuleConfig
from canfb.replay.findings import COLUMNS as SAMPLE_COLUMNS, KINDS, Block, DriftTracks, Overview
from canfb.replay.module_replay import Begin, ModuleReplay
from canfb.replay.replay_result import ReplayResult
from canfb.report.page import beside, figure, gallery, page, table
from canfb.report.pictures import Curve, lissajous, over_time
from canfb.rows import Row
from canfb.signal.correction import Correction
from canfb.signal.limits import RPM

HINT = "Parquet needs pyarrow: pip install 'canfb[fleet]'"
Take = Callable[[Block], None]


def _pyarrow() -> tuple[Any, Any]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise CanfbError(HINT) from error
    return pyarrow, pyarrow.parquet


@contextlib.contextmanager
def _parquet(path: Path) -> Iterator[Take]:
    arrow, parquet = _pyarrow()
    schema = arrow.schema([(name, arrow.from_numpy_dtype(kind)) for name, kind in SAMPLE_COLUMNS.items()])
    with parquet.ParquetWriter(str(path), schema) as writer:
        yield lambda block: writer.write_table(
            arrow.Table.from_arrays([arrow.array(block[name]) for name in SAMPLE_COLUMNS], schema=schema)
        )


@contextlib.contextmanager
def _csv(path: Path) -> Iterator[Take]:
    with path.open("w", newline="", encoding="ascii") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(SAMPLE_COLUMNS)
        yield lambda block: rows.writerows(
            zip(*(block[name].tolist() for name in SAMPLE_COLUMNS), strict=True)
        )


@contextlib.contextmanager
def _npz(path: Path) -> Iterator[Take]:
    """Writer of NPZ; keeps all blocks in memory until the end."""
    blocks: list[Block] = []
    yield blocks.append
    columns: dict[str, Any] = {
        name: np.concatenate([np.empty(0, kind), *(block[name] for block in blocks)])
        for name, kind in SAMPLE_COLUMNS.items()
    }
    with path.open("wb") as file:
        np.savez_compressed(file, **columns)


WRITERS = {".csv": _csv, ".npz": _npz, ".parquet": _parquet}


def write_rows(path: Path, rows: Sequence[Mapping[str, Any]], types: Mapping[str, type]) -> None:
    """Write rows as one table; ``types`` of the columns: str, int, float or bool; values may be None."""
    arrow, parquet = _pyarrow()
    kinds = {str: arrow.string(), int: arrow.int64(), float: arrow.float64(), bool: arrow.bool_()}
    schema = arrow.schema([(name, kinds[kind]) for name, kind in types.items()])
    plain = [
        {name: as_utf8(one) if isinstance(one, str) else one for name, one in row.items()} for row in rows
    ]
    parquet.write_table(arrow.Table.from_pylist(plain, schema=schema), str(path))


@contextlib.contextmanager
def published(path: Path) -> Iterator[Take]:
    """A function that writes blocks of samples; the file appears when it is complete.

    ConfigError for an invalid name or folder; CanfbError if writing fails, or for Parquet without pyarrow.
    """
    writer = WRITERS.get(path.suffix.lower())
    if writer is None:
        raise ConfigError(f"--out {path}: the name must end with {', '.join(WRITERS)}")
    check_writable(path, "--out")
    with writing(path, "--out"), replacing(path) as part, writer(part) as take:
        yield take


MOST_FAULTS = 40


def write_page(path: Path, log: BusLogFile, result: ReplayResult, overview: Overview) -> None:
    replay = result.replay
    whole = not (result.left_out or log.counters.damaged_lines or log.trouble)
    subjects = {
        "Margins": [*result.facts(), *log.counters.facts(log.trouble)],
        "The recorded module and the replay": result.comparison(),
    }
    tables = "".join(table(title, rows) for title, rows in subjects.items() if rows)
    conditioning = replay.module.chain.correction.conditioning
    picture = lissajous(overview.sine, overview.cosine, conditioning, replay.module.limits.sample)
    shown = figure("Lissajous figure", f"{len(overview.sine)} samples, evenly chosen", picture)
    body = beside(tables, shown) + gallery("Over time", _pictures(replay, overview))
    faults = result.faults()
    if faults:
        rows = [Row(f"{n}", text) for n, text in enumerate(faults[:MOST_FAULTS], 1)]
        more = sum(replay.faults.times.values()) - MOST_FAULTS
        body += table("Faults", [*rows, Row("", f"and {more} more" if more > 0 else None)])
    other = any(one.different or one.only_recorded or one.only_replayed for one in replay.compared.values())
    good = whole and not other and not any(replay.faults.times.values())
    text = page(
        f"Replay of {log.path.name}",
        result.head(),
        [*result.notes(), result.verdict()],
        body,
        "Margin: what is left of it",
        good,
    )
    with writing(path, "--report"):
        path.write_text(text, encoding="utf-8")


def _pictures(replay: ModuleReplay, overview: Overview) -> list[str]:
    found = overview.stretches
    time_s = found["begin_s"] - replay.first_s
    if not len(time_s):
        return []
    residual = [
        Curve(found["residual"], "after", "largest residual"),
        Curve(found["residual_limit"], "limit dashed", "limit"),
    ]
    amplitude = [
        Curve(found["amplitude_least"], "after", "lowest"),
        Curve(found["amplitude_most"], "before", "highest"),
        Curve(found["amplitude_low_counts"], "limit dashed", "limits"),
        Curve(found["amplitude_high_counts"], "limit dashed", None),
    ]
    speed = [
        Curve(RPM * found["speed_most"], "before", "highest"),
        Curve(RPM * found["speed_least"], "after", "lowest"),
    ]
    faults = [
        Curve(np.where(found["faults"] > 0.0, found["faults"], 0.0), "before", "intervals with a fault")
    ]
    stretch = f"in each of {len(time_s)} equal parts of the log"
    extremes = f"lowest and highest {stretch}"
    return [
        figure("Residual", f"largest {stretch}", over_time("Residual", "cycles", time_s, residual, 0.0)),
        figure("Amplitude", extremes, over_time("Amplitude", "counts", time_s, amplitude, 0.0)),
        figure("Speed", f"{extremes}, while valid", over_time("Speed", "rpm", time_s, speed)),
        figure("Faults", f"intervals {stretch}", over_time("Faults", "intervals", time_s, faults, 0.0)),
    ]


@dataclass(frozen=True)
class ReplayOptions:
    """How a log is replayed.

    modules      the modules; none with its own source
    correction   table and conditioning instead of saved ones
    state_dir    folder with parameters saved by `save` (1010h), read-only
    begin        the NMT state at the beginning of the log
    channel      channel of the log; None: all of them, as one bus
    drift        whether to measure the drift of the encoders from their tables; takes seconds
    """

    modules: tuple[ModuleConfig, ...]
    correction: Correction | None = None
    state_dir: Path | None = None
    begin: Begin = Begin.AUTO
    channel: str | None = None
    drift: bool = False

    def __post_init__(self) -> None:
        for module in self.modules:
            if module.source is not None:
                raise ConfigError(
                    f"module {module.node_id} has a source of its own: its samples are not on the bus"
                )
        if self.state_dir is not None and len(self.modules) != 1:
            raise ConfigError("--state: is for one module; choose it by NODE")
        if self.state_dir is not None and not self.state_dir.is_dir():
            raise ConfigError(f"--state {self.state_dir}: there is no such folder")


def replay_log(
    path: Path,
    settings: ReplayOptions,
    takers: Sequence[Callable[[Block], None]] = (),
    sent: Callable[[Frame], None] | None = None,
    progress: Callable[[float], None] = lambda part: None,
) -> tuple[BusLogFile, list[ReplayResult]]:
    """Read a log once, for all modules. ``progress`` gets 0..1.

    ``takers`` and ``sent`` get the samples and the frames of the modules, see ModuleReplay. LogError for
    a log without frames, or an unreadable one.
    """
    log = BusLogFile(path, settings.channel)
    tracks = [DriftTracks() for _ in settings.modules]
    replays = [
        ModuleReplay(
            module,
            _store(module, settings.state_dir),
            correction=settings.correction,
            begin=settings.begin,
            takers=[*([track.take] if settings.drift else []), *takers],
            sent=sent,
        )
        for module, track in zip(settings.modules, tracks, strict=True)
    ]
    for batch in log.batches():
        for replay in replays:
            replay.feed(batch)
        progress(log.part_read)
    if not log.counters.channels:
        kind = f"of channel {log.channel}" if log.counters.left_out else "with an 11-bit identifier"
        raise log.no_frame(f"classic frame {kind}")
    results = []
    for replay, track, module in zip(replays, tracks, settings.modules, strict=True):
        replay.close()
        drift = track.drift(replay.module.chain.correction, module.adc_bits) if settings.drift else None
        results.append(ReplayResult(replay, drift, log.counters.left_out_of(replay.own_can_ids)))
    return log, results


def _store(module: ModuleConfig, state_dir: Path | None) -> MemoryStore | None:
    """Saved parameters, copied to memory: the log may contain a `save`, which must not change the folder."""
    if state_dir is None and module.state_dir is None:
        return None
    store = MemoryStore()
    if state_dir is not None:
        for group, image in SavedParameters(state_dir).load().items():
            if isinstance(image, OSError):
                raise CanfbError(f"--state {state_dir}: {group.name.lower()} parameters: {image.strerror}")
            store.images[group] = image
    return store


MARGINS = {
    "residual": "residual_cycles",
    "amplitude_low": "lowest_amplitude_counts",
    "amplitude_high": "highest_amplitude_counts",
    "acceleration_cycles": "acceleration_cycles",
    "speed_rad_s": "speed_rad_s",
}

# Columns of the table. A column named as a kind of fault counts its intervals, ``..._times`` its occurrences;
# ``..._margin`` is as in :class:`.Extreme`. ``left_out``: frames of the module on channels of the log that
# were not selected. ``error``: why the other columns are empty.
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

LogRow = dict[str, Any]


@dataclass(frozen=True)
class LogJob:
    """A log to replay: its name within the folder, path, size, and fingerprint of all input."""

    name: str
    path: Path
    size: int
    fingerprint: str


def job_of(folder: Path, path: Path, settings: ReplayOptions) -> LogJob:
    """The job for a log. OSError if it does not exist any more.

    Fingerprint of: size and modification time, settings, files in state_dir, columns, version of canfb.
    """
    status, used, words = path.stat(), settings.correction, repr(replace(settings, correction=None))
    saved = [
        (one.name, one.read_bytes())
        for one in sorted(settings.state_dir.glob("*.bin") if settings.state_dir else [])
    ]
    correction = None if used is None else (used.crc32, repr(used.conditioning))
    parts = (version("canfb"), tuple(COLUMNS), status.st_size, status.st_mtime_ns, words, correction, saved)
    return LogJob(
        as_utf8(str(path.relative_to(folder))),
        path,
        status.st_size,
        hashlib.sha256(repr(parts).encode()).hexdigest()[:32],
    )


def rows_of(job: LogJob, settings: ReplayOptions) -> list[LogRow]:
    """The rows of a log, even if it is damaged."""
    try:
        log, results = replay_log(job.path, settings)
    except Exception as error:  # one log must not end the others
        kind = "" if isinstance(error, CanfbError) else f"{type(error).__name__}: "
        return failed_rows(job, settings, f"{kind}{reason(error)}")
    return [_row(job, log, one.figures()) for one in results]


def failed_rows(job: LogJob, settings: ReplayOptions, why: str) -> list[LogRow]:
    empty: LogRow = dict.fromkeys(COLUMNS)
    return [
        empty | {"log": job.name, "module": module.node_id, "error": why, "fingerprint": job.fingerprint}
        for module in settings.modules
    ]


def _row(job: LogJob, log: BusLogFile, figures: dict[str, Any]) -> LogRow:
    faults, margins, drift = figures["faults"], figures["margins"], figures["drift"] or {}
    pairs = figures["compared"].values()
    row: LogRow = {
        "log": job.name,
        "module": figures["node_id"],
        "error": None,
        "frames": log.counters.frames,
        "damaged_lines": log.counters.damaged_lines,
        "trouble": log.trouble,
        **{kind: faults[kind]["samples"] for kind in KINDS},
        **{f"{kind}_times": faults[kind]["times"] for kind in KINDS},
        **{column: margins[name]["value"] for name, column in MARGINS.items()},
        **{f"{column}_margin": margins[name]["margin"] for name, column in MARGINS.items()},
        "drift_rms_cycles": drift.get("rms_cycles"),
        "drift_peak_cycles": drift.get("peak_cycles"),
        "drift_uncertainty_rms_cycles": drift.get("uncertainty_rms_cycles"),
        "drift_reason": drift.get("reason"),
        "compared_equal": sum(one["equal"] for one in pairs),
        "compared_different": sum(one["different"] for one in pairs),
        "compared_missing": sum(one["only_recorded"] + one["only_replayed"] for one in pairs),
        "fingerprint": job.fingerprint,
    }
    return {name: row[name] if name in row else figures[name] for name in COLUMNS}


def work_of(folder: Path, settings: ReplayOptions, out: Path | None) -> tuple[list[LogJob], list[LogRow]]:
    """The logs below ``folder`` that remain, and the rows of the others in the table ``out``.

    ConfigError for an impossible table; CanfbError for a folder without logs, or an unreadable table.
    """
    if out is not None:
        if out.suffix.lower() != ".parquet":
            raise ConfigError("--out: a folder of logs needs a table, such as --out month.parquet")
        check_writable(out, "--out")
    paths = sorted(path for path in folder.rglob("*") if path.is_file() and is_log(path))
    if not paths:
        raise CanfbError(f"{folder}: there is no bus log in this folder")
    jobs = {job.name: job for job in (job_of(folder, path, settings) for path in paths)}
    known = {job.name: job.fingerprint for job in jobs.values()}
    done = [] if out is None else [row for row in _table(out) if known.get(row["log"]) == row["fingerprint"]]
    names = {row["log"] for row in done}
    return [job for name, job in jobs.items() if name not in names], done


def do_work(
    jobs: list[LogJob],
    done: list[LogRow],
    settings: ReplayOptions,
    out: Path | None,
    workers: int | None = None,
    executor: Executor | None = None,
    progress: Callable[[float], None] = lambda part: None,
) -> list[LogRow]:
    """Replay the logs, write the table ``out`` (None: no table), and return its rows, by log and module.

    Runs in ``workers`` processes (None: one for each processor, 1: this one), or on ``executor``. A log
    whose process is killed is replayed once more. After an interruption the table contains finished logs.
    CanfbError if a file fails.
    """
    rows = list(done)
    total, ready = sum(job.size for job in jobs) or 1, 0
    try:
        for job, found in _done(deque(sorted(jobs, key=lambda job: -job.size)), settings, workers, executor):
            rows += found
            ready += job.size
            progress(ready / total)
    finally:
        rows.sort(key=lambda row: (row["log"], row["module"]))
        if out is not None:
            with writing(out, "--out"), replacing(out) as part:
                write_rows(part, rows, COLUMNS)
    return rows


def _table(out: Path) -> list[LogRow]:
    if not out.exists():
        return []
    said = f"--out {out}: exists, and is not a table"
    with saying(CanfbError, said, OSError, ValueError):  # pyarrow's errors are subclasses of these
        rows: list[LogRow] = _pyarrow()[1].read_table(str(out)).to_pylist()
    if rows and not COLUMNS.keys() <= rows[0].keys():
        raise CanfbError(f"{said} of logs; take another name")
    return rows


def _done(
    jobs: deque[LogJob], settings: ReplayOptions, workers: int | None, executor: Executor | None
) -> Iterator[tuple[LogJob, list[LogRow]]]:
    number = min(len(jobs), workers or os.cpu_count() or 1)
    lost: list[LogJob] = []
    spawn = multiprocessing.get_context("spawn")
    if executor is not None:
        lost += yield from _on(executor, jobs, settings, len(jobs))
    while jobs and number > 1:
        with ProcessPoolExecutor(number, spawn) as pool:
            suspects = yield from _on(pool, jobs, settings, number)
        for suspect in suspects:
            with ProcessPoolExecutor(1, spawn) as pool:
                lost += yield from _on(pool, deque([suspect]), settings, 1)
    for job in jobs:
        yield job, rows_of(job, settings)
    for job in lost:
        yield job, failed_rows(job, settings, "its process was ended repeatedly")


def _on(
    executor: Executor, jobs: deque[LogJob], settings: ReplayOptions, number: int
) -> Generator[tuple[LogJob, list[LogRow]], None, list[LogJob]]:
    """Run ``jobs``, ``number`` at a time, until a process is killed; returns the unfinished ones."""
    running: dict[Future[list[LogRow]], LogJob] = {}
    while jobs or running:
        while jobs and len(running) < number:
            running[executor.submit(rows_of, jobs[0], settings)] = jobs[0]
            jobs.popleft()
        for future in wait(running, return_when=FIRST_COMPLETED).done:
            job = running.pop(future)
            try:
                rows = future.result()
            except BrokenExecutor:
                return [job, *running.values()]
            except Exception as error:
                rows = failed_rows(job, settings, f"{type(error).__name__}: {reason(error)}")
            yield job, rows
    return []
