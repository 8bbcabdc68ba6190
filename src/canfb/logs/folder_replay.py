"""All logs of a folder: one table, which a second run completes; in this process, or on Dask.

Each log is noted beside the table as soon as it is done, with a fingerprint of the file, the settings and the
version: a run that was interrupted goes on where it was, and a log that has changed is done again.
"""

from __future__ import annotations

import contextlib
import json
import logging
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, Self

from canfb.errors import CanfbError, ConfigError, reason
from canfb.logs.log_reader import is_log
from canfb.logs.log_replay import COLUMNS, LogJob, ReplayOptions, Row, failed_rows, job_of, rows_of
from canfb.logs.published_files import read_rows, write_rows

PARQUET = ".parquet"


class Pool(Protocol):
    """Who does the logs."""

    def run(self, jobs: Iterable[LogJob], settings: ReplayOptions) -> Iterator[tuple[LogJob, list[Row]]]:
        """Each log with its rows, in any order."""


class InThisProcess:
    """One log after the other."""

    def run(self, jobs: Iterable[LogJob], settings: ReplayOptions) -> Iterator[tuple[LogJob, list[Row]]]:
        """Each log with its rows."""
        for job in jobs:
            yield job, rows_of(job, settings)


@dataclass(frozen=True)
class FolderWork:
    """What there is to do, and the rows that an earlier run has left."""

    jobs: list[LogJob]
    done: list[Row]
    skipped: int


def check_table(out: Path | None) -> Path:
    """Where the table goes. ConfigError if that cannot be."""
    if out is None or out.suffix.lower() != PARQUET:
        raise ConfigError(f"--out: a folder of logs needs a table, such as --out month{PARQUET}")
    if not out.parent.is_dir():
        raise ConfigError(f"--out {out}: there is no folder {out.parent}")
    return out


def work_of(folder: Path, settings: ReplayOptions, out: Path | None) -> FolderWork:
    """The logs below ``folder`` whose rows are not in the table ``out``, or in what an interrupted run has
    left beside it; None: no table, all of them.

    CanfbError for a folder without logs, and for a table that cannot be read.
    """
    paths = sorted(path for path in folder.rglob("*") if path.is_file() and is_log(path))
    if not paths:
        raise CanfbError(f"{folder}: there is no bus log in this folder")
    jobs = {job.name: job for job in (job_of(folder, path, settings) for path in paths)}
    done: dict[tuple[str, int], Row] = {}
    for row in [] if out is None else [*_table_rows(out), *_unfinished_rows(out)]:
        job = jobs.get(row["log"])
        if job is not None and job.fingerprint == row["fingerprint"]:
            done[row["log"], row["module"]] = row
    names = {name for name, _ in done}
    return FolderWork(
        [job for name, job in jobs.items() if name not in names], list(done.values()), len(names)
    )


def do_work(
    work: FolderWork,
    settings: ReplayOptions,
    out: Path | None,
    pool: Pool,
    progress: Callable[[float], None] = lambda part: None,
) -> list[Row]:
    """Do the logs, write the table, and give all its rows, by log and module; None: no table is written.

    Each log is noted beside the table as soon as it is done: a run that is interrupted loses only those
    that were in work. ``progress`` gets the part that is done, by bytes. CanfbError if a file fails.
    """
    rows = list(work.done)
    if out is None:
        rows += [row for _, found in pool.run(work.jobs, settings) for row in found]
        return sorted(rows, key=lambda row: (row["log"], row["module"]))
    total, ready = sum(job.size for job in work.jobs) or 1, 0
    try:
        with _unfinished(out).open("a", encoding="utf-8") as notes:
            for job, found in pool.run(work.jobs, settings):
                rows += found
                notes.writelines(f"{json.dumps(row)}\n" for row in found)
                notes.flush()
                ready += job.size
                progress(ready / total)
        rows.sort(key=lambda row: (row["log"], row["module"]))
        part = out.with_name(f"{out.name}.part")
        write_rows(part, rows, COLUMNS)
        part.replace(out)
        _unfinished(out).unlink()
    except OSError as error:
        raise CanfbError(f"--out {out}: cannot be written: {reason(error)}") from error
    return rows


def _unfinished(out: Path) -> Path:
    return out.with_name(f"{out.name}.unfinished")


def _table_rows(out: Path) -> list[Row]:
    if not out.exists():
        return []
    try:
        rows = read_rows(out)
    except (OSError, ValueError) as error:  # pyarrow's errors are of these kinds
        raise CanfbError(f"--out {out}: is there already, and is no table: {reason(error)}") from None
    if rows and not {"log", "module", "fingerprint"} <= set(rows[0]):
        raise CanfbError(f"--out {out}: is there already, and is no table of logs; take another name")
    return rows


def _unfinished_rows(out: Path) -> list[Row]:
    """What an interrupted run has noted; its last line may be cut off."""
    try:
        lines = _unfinished(out).read_text(encoding="utf-8", errors="replace").splitlines()
    except FileNotFoundError:
        return []
    except OSError as error:
        raise CanfbError(f"{_unfinished(out)}: cannot be read: {reason(error)}") from None
    rows = []
    for line in lines:
        try:
            row = json.loads(line)
        except (ValueError, RecursionError):
            continue
        whole = isinstance(row, dict) and set(COLUMNS) <= set(row)
        if whole and isinstance(row["log"], str) and isinstance(row["module"], int):
            rows.append(row)
    return rows


HINT = "Dask is not there: pip install 'canfb[fleet]'; or --scheduler none, in this process alone"
LOCAL = "local"
CONNECT_S = 10
RETRIES = 3  # of a log whose process was killed


class DaskPool:
    """A context manager around :meth:`run`.

    ``scheduler`` is "local", for ``workers`` processes of this machine (None: one per CPU), each started
    again if it is killed, or the address of a scheduler, whose workers must see the logs under the same
    names. CanfbError without Dask, and for a scheduler that does not answer.
    """

    def __init__(self, scheduler: str = LOCAL, workers: int | None = None) -> None:
        if scheduler != LOCAL and workers is not None:
            raise ConfigError("--workers: a cluster has its own")
        if workers is not None and workers < 1:
            raise ConfigError(f"--workers {workers}: must be 1 at least")
        self._scheduler, self._workers = scheduler, workers
        self._opened = contextlib.ExitStack()
        self.client: Any = None
        self.cluster: Any = None

    def __enter__(self) -> Self:
        try:
            import distributed as installed
        except ImportError as error:
            raise CanfbError(HINT) from error
        distributed: Any = installed
        self._distributed: Any = distributed
        logging.getLogger("distributed").setLevel(logging.CRITICAL)  # a log that fails has its row
        with contextlib.ExitStack() as opened:
            if self._scheduler == LOCAL:
                self.cluster = opened.enter_context(
                    distributed.LocalCluster(
                        n_workers=self._workers,
                        threads_per_worker=1,
                        processes=True,
                        scheduler_kwargs={"dashboard": False},
                        silence_logs=logging.CRITICAL,
                    )
                )
            try:
                client = distributed.Client(self.cluster or self._scheduler, timeout=CONNECT_S)
            except (OSError, ValueError, TimeoutError) as error:
                raise CanfbError(
                    f"--scheduler {self._scheduler}: does not answer: {reason(error)}"
                ) from error
            self.client = opened.enter_context(client)
            self._opened = opened.pop_all()
        return self

    def __exit__(self, *raised: object) -> None:
        self._opened.close()

    def run(self, jobs: Iterable[LogJob], settings: ReplayOptions) -> Iterator[tuple[LogJob, list[Row]]]:
        """Each log with its rows, as they are done.

        A log whose process is killed is done again, a few times. The largest come first: the end is not
        spent waiting for one of them.
        """
        ordered = sorted(jobs, key=lambda job: -job.size)
        shared = self.client.scatter(settings, broadcast=True)
        futures = {
            self.client.submit(rows_of, job, shared, pure=False, retries=RETRIES): job for job in ordered
        }
        for future in self._distributed.as_completed(list(futures)):
            job = futures.pop(future)
            error = future.exception()
            if error is None:
                yield job, future.result()
            else:
                why = f"{type(error).__name__}: its process was ended again and again"
                yield job, failed_rows(job, settings, why)
            future.release()
