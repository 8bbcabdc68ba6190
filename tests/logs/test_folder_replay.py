"""A folder of logs: one table, the same from one process and from two; a killed one costs its log."""

from __future__ import annotations

import math
import os
import signal
from collections.abc import Iterable
from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any

import pytest

from canfb.errors import CanfbError
from canfb.logs import log_replay
from canfb.logs.log_replay import COLUMNS, LogJob, ReplayOptions, Row, do_work, rows_of, work_of
from canfb.logs.replay_files import read_rows
from commands import Command
from replay_kit import Planned, adc, config, live, session, write_log

pytest.importorskip("pyarrow")

SETTINGS = ReplayOptions((config(),))
GOOD = 4


def faulty(samples: int, bad: int) -> list[Planned]:
    plan = session(samples)
    for n in range(bad):
        place = 40 + 40 * n  # a sample
        plan[place] = (plan[place][0], adc(0.1, 3000.0))
    return plan


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Good logs in two folders, one that is no log, and files that are none."""
    root = tmp_path / "month"
    (root / "monday").mkdir(parents=True)
    for n in range(GOOD):
        suffix = (".log", ".blf")[n % 2]
        write_log(root / f"{'monday/' if n > 1 else ''}{n}{suffix}", live(faulty(100 + 10 * n, n))[0])
    (root / "bad.log").write_text("no log\n")
    (root / "notes.csv").write_text("when,what\n")
    (root / "readme.txt").write_text("mine")
    return root


def comparable(rows: Iterable[Row]) -> list[list[Any]]:
    return [
        [None if isinstance(row[name], float) and math.isnan(row[name]) else row[name] for name in COLUMNS]
        for row in rows
    ]


def test_each_log_has_its_row_and_a_second_run_does_what_has_changed(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "month.parquet"
    parts: list[float] = []
    rows = do_work(*work_of(folder, SETTINGS, out), SETTINGS, out, 1, progress=parts.append)
    assert comparable(read_rows(out)) == comparable(rows)
    by_name = {Path(row["log"]).stem: row for row in rows}
    assert by_name.pop("bad")["error"].endswith("1 damaged lines")
    for n in range(GOOD):
        row = by_name[str(n)]
        assert (row["error"], row["samples"], row["amplitude_times"]) == (None, 100 + 10 * n, n)
        assert row["compared_different"] == row["compared_missing"] == 0
        assert (row["highest_amplitude_counts_margin"] < 0.0) == (n > 0)
    assert parts == sorted(parts)
    assert parts[-1] == 1.0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["month", "month.parquet"]

    work = work_of(folder, SETTINGS, out)
    assert (work[0], comparable(work[1])) == ([], comparable(rows)), "a bad one is not done again either"
    (folder / "1.blf").unlink()
    write_log(folder / "0.log", live(session(50))[0])
    work = work_of(folder, SETTINGS, out)
    assert [job.name for job in work[0]] == ["0.log"]
    assert {row["log"] for row in do_work(*work, SETTINGS, out, 1)} == {
        "0.log", "bad.log", "monday/2.log", "monday/3.blf"
    }  # fmt: skip
    for other in (
        ReplayOptions((config(coast_samples=5),)),
        ReplayOptions((config(),), channel="can0"),
        ReplayOptions((config(),), drift=True),
    ):
        assert work_of(folder, other, out)[1] == []


class InTurn(Executor):
    """An executor of another kind: it works when it is asked."""

    def submit(self, fn: Any, /, *words: Any, **named: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future.set_result(fn(*words, **named))
        return future


def test_another_executor_and_an_interruption(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "x.parquet"
    whole = do_work(*work_of(folder, SETTINGS, None), SETTINGS, None, executor=InTurn())

    def interrupt(part: float) -> None:
        if part > 0.4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        do_work(*work_of(folder, SETTINGS, out), SETTINGS, out, 1, progress=interrupt)
    work = work_of(folder, SETTINGS, out)
    assert 0 < len(work[1]) < GOOD
    assert comparable(do_work(*work, SETTINGS, out, 1)) == comparable(whole)


def kill_first(job: LogJob, settings: ReplayOptions) -> list[Row]:
    """Like an end for lack of memory: the largest log ends its process whenever it is tried."""
    if job.name.endswith("3.blf"):
        os.kill(os.getpid(), signal.SIGKILL)
    return rows_of(job, settings)


def test_of_two_processes_the_one_that_is_killed_costs_its_log(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = do_work(*work_of(folder, SETTINGS, None), SETTINGS, None, 1)
    monkeypatch.setattr(log_replay, "rows_of", kill_first)
    rows = do_work(*work_of(folder, SETTINGS, None), SETTINGS, None, 2)
    lost = [row for row in rows if row["log"] == "monday/3.blf"]
    assert [row["error"] for row in lost] == ["its process was ended again and again"]
    assert comparable(row for row in rows if row not in lost) == comparable(
        row for row in expected if row["log"] != "monday/3.blf"
    )


def test_what_cannot_be_is_one_line(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: Command
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    (tmp_path / "no.parquet").write_text("mine")
    for line, code, said in (
        ("empty", 1, "there is no bus log in this folder"),
        ("month --out x.csv", 2, "needs a table, such as --out month.parquet"),
        ("month --out none/x.parquet", 2, "there is no folder"),
        ("month --out no.parquet", 1, "is there already, and is no table"),
        ("month --report x.html", 2, "--report: is for one log, not for a folder"),
        ("month --workers 0", 2, "--workers 0: must be 1 at least"),
    ):
        lines = command(f"log replay {line}", code=code).err.splitlines()
        errors = [one for one in lines if not one.startswith("...")]
        assert len(errors) == 1, errors
        assert said in errors[0]
    assert (tmp_path / "no.parquet").read_text() == "mine"
    with pytest.raises(CanfbError, match="choose it by NODE"):
        ReplayOptions((config(), config()), state_dir=Path())


def test_the_command_says_which_log_is_bad_or_incomplete(
    folder: Path, tmp_path: Path, command: Command
) -> None:
    line = "log replay --workers 1 --no-drift"
    captured = command(line, folder)
    assert "not done  bad.log, module 32: " in captured.out
    assert "0.log, module 32: 100 samples, no faults\n" in captured.out
    assert f"{GOOD + 1} rows, " in captured.out
    assert captured.err == f"... {GOOD + 1} logs to replay, 0 are done\n"
    path = folder / "1.blf"
    path.write_bytes(path.read_bytes()[:-200])
    assert "damaged or incomplete" in command(line, folder, "--out", tmp_path / "x.parquet", code=1).out
