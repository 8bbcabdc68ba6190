"""All logs of a folder as one table, which a second run completes; on the processors of this machine.

What outgrows it needs an ``executor``, such as ``dask.distributed.Client(address).get_executor()``, whose
workers see the logs under the same names.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
from collections import deque
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, ProcessPoolExecutor, wait
from pathlib import Path

from canfb.errors import CanfbError, ConfigError, reason
from canfb.files import check_writable, replacing, writing
from canfb.logfile.log_files import is_log
from canfb.logs.log_replay import COLUMNS, LogJob, ReplayOptions, Row, failed_rows, job_of, rows_of
from canfb.logs.replay_files import read_rows, write_rows


def check_table(out: Path) -> Path:
    if out.suffix.lower() != ".parquet":
        raise ConfigError("--out: a folder of logs needs a table, such as --out month.parquet")
    check_writable(out, "--out")
    return out


def work_of(folder: Path, settings: ReplayOptions, out: Path | None) -> tuple[list[LogJob], list[Row]]:
    """The logs below ``folder`` that are to do, and the rows of the table ``out`` of the others.

    CanfbError for a folder without logs, and for a table that cannot be read.
    """
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
    done: list[Row],
    settings: ReplayOptions,
    out: Path | None,
    workers: int | None = None,
    executor: Executor | None = None,
    progress: Callable[[float], None] = lambda part: None,
) -> list[Row]:
    """Do the logs, write the table, and give all its rows, by log and module; None: no table is written.

    In ``workers`` processes, None: one for each processor, 1: this one; or on ``executor``. A log whose
    process is killed is done once more. Interrupted, the table has what is done. CanfbError if a file fails.
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


def _table(out: Path) -> list[Row]:
    if not out.exists():
        return []
    try:
        rows = read_rows(out)
    except (OSError, ValueError) as error:  # pyarrow's errors are of these kinds
        raise CanfbError(f"--out {out}: is there already, and is no table: {reason(error)}") from None
    if rows and not COLUMNS.keys() <= rows[0].keys():
        raise CanfbError(f"--out {out}: is there already, and is no table of logs; take another name")
    return rows


def _done(
    jobs: deque[LogJob], settings: ReplayOptions, workers: int | None, executor: Executor | None
) -> Iterator[tuple[LogJob, list[Row]]]:
    number = min(len(jobs), workers or os.cpu_count() or 1)
    lost: list[LogJob] = []
    if executor is not None:
        lost += yield from _on(executor, jobs, settings, len(jobs))
    while jobs and number > 1:
        with _processes(number) as pool:
            suspects = yield from _on(pool, jobs, settings, number)
        for suspect in suspects:
            with _processes(1) as pool:
                lost += yield from _on(pool, deque([suspect]), settings, 1)
    for job in jobs:
        yield job, rows_of(job, settings)
    for job in lost:
        yield job, failed_rows(job, settings, "its process was ended again and again")


def _on(
    executor: Executor, jobs: deque[LogJob], settings: ReplayOptions, number: int
) -> Generator[tuple[LogJob, list[Row]], None, list[LogJob]]:
    """Takes ``jobs``, ``number`` at a time, until a process is killed; returns those in work then."""
    running: dict[Future[list[Row]], LogJob] = {}
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


@contextlib.contextmanager
def _processes(number: int) -> Iterator[Executor]:
    pool = ProcessPoolExecutor(number, multiprocessing.get_context("spawn"))
    try:
        yield pool
    finally:
        pool.shutdown(cancel_futures=True)
