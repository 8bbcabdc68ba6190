"""``canfb replay FOLDER``: a folder of logs on Dask."""

from __future__ import annotations

import argparse
import contextlib

from canfb.cli.progress import Progress
from canfb.errors import ConfigError
from canfb.logs.folder_replay import InThisProcess, Pool, check_table, do_work, work_of
from canfb.logs.log_replay import ReplaySettings
from canfb.logs.on_dask import LOCAL, DaskPool

NONE = "none"


def replay_folder(options: argparse.Namespace, settings: ReplaySettings, progress: Progress) -> int:
    """Do what is not done yet; 0 when the table is written: it says which logs could not be done, and why."""
    out = check_table(options.out)
    if options.scheduler == NONE and options.workers is not None:
        raise ConfigError("--workers: there are none with --scheduler none")
    dask = None if options.scheduler == NONE else DaskPool(options.scheduler or LOCAL, options.workers)
    work = work_of(options.log, settings, out)
    progress.step(f"{len(work.jobs)} logs to replay, {work.skipped} are done")
    with contextlib.ExitStack() as opened:
        pool: Pool = InThisProcess() if dask is None or not work.jobs else opened.enter_context(dask)
        rows = do_work(work, settings, out, pool, progress.part)
    progress.clear()
    bad = [row for row in rows if row["error"] is not None]
    for row in bad:
        print(f"not done  {row['log']}, module {row['module']}: {row['error']}")
    for row in rows:
        if row.get("left_out"):
            print(
                f"left out  {row['log']}, module {row['module']}: {row['left_out']} frames with its CAN-IDs "
                "(--channel)"
            )
    samples = sum(row["samples"] or 0 for row in rows)
    print(f"{len(rows)} rows, {samples} samples; {len(bad)} not done")
    print(f"written  {out}")
    return 0
