"""``canfb replay FOLDER``: a folder of logs on Dask."""

from __future__ import annotations

import argparse
import contextlib

from canfb.cli.progress import Progress
from canfb.errors import ConfigError
from canfb.logs.folder_replay import InThisProcess, Pool, check_table, do_work, work_of
from canfb.logs.log_replay import ReplayOptions
from canfb.logs.on_dask import LOCAL, DaskPool
from canfb.replay.fault_list import KINDS

NONE = "none"


def replay_folder(options: argparse.Namespace, settings: ReplayOptions, progress: Progress) -> int:
    """Do what is not done yet; 0 when it is: table and lines say which logs could not be done, and why.

    In this process (``--scheduler none``) a table is not required: each log is a line then.
    """
    in_this_process = options.scheduler == NONE
    out = None if in_this_process and options.out is None else check_table(options.out)
    if in_this_process and options.workers is not None:
        raise ConfigError("--workers: there are none with --scheduler none")
    dask = None if in_this_process else DaskPool(options.scheduler or LOCAL, options.workers)
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
    if out is None:
        for row in rows:
            if row["error"] is None:
                faults = ", ".join(f"{kind} {row[kind]}" for kind in KINDS if row[kind]) or "no faults"
                print(f"{row['log']}, module {row['module']}: {row['samples']} samples, {faults}")
    samples = sum(row["samples"] or 0 for row in rows)
    print(f"{len(rows)} rows, {samples} samples; {len(bad)} not done")
    if out is not None:
        print(f"written  {out}")
    return 0
