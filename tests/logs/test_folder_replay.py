"""A folder of logs: one table, the same from one process and from two of which one is killed."""

from __future__ import annotations

import math
import os
import signal
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest

from canfb.cli.main import main
from canfb.errors import CanfbError, ConfigError
from canfb.logs.folder_replay import DaskPool, InThisProcess, do_work, work_of
from canfb.logs.log_replay import COLUMNS, LogJob, ReplayOptions, Row
from canfb.logs.published_files import read_rows
from replay_kit import Planned, adc, config, live, session, write_log

pytest.importorskip("pyarrow")

SETTINGS = ReplayOptions((config(),))
GOOD = 8


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
        write_log(root / f"{'monday/' if n > 3 else ''}{n}{suffix}", live(faulty(200 + 10 * n, n))[0])
    (root / "bad.log").write_text("no log\n")
    (root / "notes.csv").write_text("when,what\n")
    (root / "readme.txt").write_text("mine")
    return root


def comparable(rows: Iterable[Row]) -> list[list[Any]]:
    return [
        [None if isinstance(row[name], float) and math.isnan(row[name]) else row[name] for name in COLUMNS]
        for row in rows
    ]


def test_each_log_has_its_row(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "month.parquet"
    parts: list[float] = []
    rows = do_work(work_of(folder, SETTINGS, out), SETTINGS, out, InThisProcess(), parts.append)
    assert comparable(read_rows(out)) == comparable(rows)
    assert [row["log"] for row in rows] == sorted(
        ["bad.log", *(f"{'monday/' if n > 3 else ''}{n}{('.log', '.blf')[n % 2]}" for n in range(GOOD))]
    )
    by_name = {Path(row["log"]).stem: row for row in rows}
    assert by_name.pop("bad")["error"].endswith("1 damaged lines")
    for n in range(GOOD):
        row = by_name[str(n)]
        assert (row["error"], row["samples"], row["amplitude_times"]) == (None, 200 + 10 * n, n)
        assert row["compared_different"] == row["compared_missing"] == 0
        assert row["compared_equal"] > 400
        assert (row["highest_amplitude_counts_margin"] < 0.0) == (n > 0)
    assert parts == sorted(parts)
    assert parts[-1] == 1.0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["month", "month.parquet"]


def test_a_second_run_does_what_has_changed(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "month.parquet"
    first = do_work(work_of(folder, SETTINGS, out), SETTINGS, out, InThisProcess())
    work = work_of(folder, SETTINGS, out)
    assert (work.jobs, work.skipped) == ([], GOOD + 1), "a bad one is not done again either"
    assert comparable(do_work(work, SETTINGS, out, InThisProcess())) == comparable(first)
    (folder / "2.log").unlink()
    write_log(folder / "0.log", live(session(50))[0])
    write_log(folder / "new.log", live(session(60))[0])
    work = work_of(folder, SETTINGS, out)
    assert [job.name for job in work.jobs] == ["0.log", "new.log"]
    rows = do_work(work, SETTINGS, out, InThisProcess())
    assert {row["log"]: row["samples"] for row in rows}["0.log"] == 50
    assert "2.log" not in {row["log"] for row in rows}
    others = [
        ReplayOptions((config(coast_samples=5),)),
        ReplayOptions((config(),), channel="can0"),
        ReplayOptions((config(),), drift=True),
    ]
    for other in others:
        assert work_of(folder, other, out).skipped == 0


class Interrupted:
    """Gives up in the middle, as Ctrl-C would."""

    def __init__(self, after: int) -> None:
        self.after = after

    def run(self, jobs: Iterable[LogJob], settings: ReplayOptions) -> Iterator[tuple[LogJob, list[Row]]]:
        for number, done in enumerate(InThisProcess().run(jobs, settings)):
            if number == self.after:
                raise KeyboardInterrupt
            yield done


def test_an_interrupted_run_goes_on_where_it_was(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "month.parquet"
    whole = do_work(
        work_of(folder, SETTINGS, tmp_path / "x.parquet"), SETTINGS, tmp_path / "x.parquet", InThisProcess()
    )
    with pytest.raises(KeyboardInterrupt):
        do_work(work_of(folder, SETTINGS, out), SETTINGS, out, Interrupted(4))
    assert not out.exists()
    notes = tmp_path / "month.parquet.unfinished"
    notes.write_text(notes.read_text() + '{"log": "cut o')
    work = work_of(folder, SETTINGS, out)
    assert (len(work.jobs), work.skipped) == (GOOD - 3, 4)
    assert comparable(do_work(work, SETTINGS, out, InThisProcess())) == comparable(whole)
    assert not notes.exists()


def test_two_processes_of_which_one_is_killed_give_what_one_gives(folder: Path, tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    alone, out = tmp_path / "alone.parquet", tmp_path / "month.parquet"
    expected = do_work(work_of(folder, SETTINGS, alone), SETTINGS, alone, InThisProcess())

    class Killing(DaskPool):
        """Kills the process of a worker after the first log."""

        killed = 0

        def run(self, jobs: Iterable[LogJob], settings: ReplayOptions) -> Iterator[tuple[LogJob, list[Row]]]:
            for done in super().run(jobs, settings):
                if not self.killed:
                    self.killed = self.cluster.workers[0].pid
                    os.kill(self.killed, signal.SIGKILL)
                yield done

    with Killing("local", 2) as pool:
        before = set(pool.client.run(os.getpid).values())
        rows = do_work(work_of(folder, SETTINGS, out), SETTINGS, out, pool)
        pool.client.wait_for_workers(2, timeout=60)
        after = set(pool.client.run(os.getpid).values())
    assert pool.killed in before
    assert pool.killed not in after
    assert len(after) == 2, "it was started again"
    assert comparable(rows) == comparable(expected)
    assert comparable(read_rows(out)) == comparable(read_rows(alone))


def test_what_cannot_be_is_one_line(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "no.parquet").write_text("mine")
    out = ["--out", str(tmp_path / "x.parquet")]
    wrong = [
        ([str(tmp_path / "empty"), *out, "--scheduler", "none"], 1, "there is no bus log in this folder"),
        ([str(folder)], 2, "a folder of logs needs a table, such as --out month.parquet"),
        ([str(folder), "--out", "x.csv"], 2, "needs a table"),
        ([str(folder), "--out", str(tmp_path / "none" / "x.parquet")], 2, "there is no folder"),
        ([str(folder), "--out", str(tmp_path / "no.parquet")], 1, "is there already, and is no table"),
        ([str(folder), *out, "--report", "x.html"], 2, "--report: is for one log, not for a folder"),
        ([str(folder), *out, "--scheduler", "none", "--workers", "2"], 2, "--workers: "),
        ([str(folder), *out, "--scheduler", "tcp://127.0.0.1:1", "--workers", "2"], 2, "--workers: "),
        ([str(folder), *out, "--workers", "0"], 2, "--workers 0: must be 1 at least"),
    ]
    for words, code, said in wrong:
        assert main(["replay", *words]) == code, words
        errors = [line for line in capsys.readouterr().err.splitlines() if not line.startswith("...")]
        assert len(errors) == 1, errors
        assert said in errors[0]
    assert (tmp_path / "no.parquet").read_text() == "mine"


def test_the_command_says_which_log_is_bad(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [str(folder), "--out", str(tmp_path / "x.parquet"), "--scheduler", "none", "--no-drift"]
    assert main(["replay", *words]) == 0
    captured = capsys.readouterr()
    assert captured.out.splitlines()[0].startswith("not done  bad.log, module 32: ")
    assert f"{GOOD + 1} rows, " in captured.out
    assert captured.err == f"... {GOOD + 1} logs to replay, 0 are done\n"


def test_settings_that_cannot_be() -> None:
    with pytest.raises(ConfigError, match="must be 1 at least"):
        DaskPool("local", 0)
    with pytest.raises(CanfbError, match="choose it by --module"):
        ReplayOptions((config(), config()), state_dir=Path())


def test_without_dask_no_table_is_needed(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["replay", str(folder), "--scheduler", "none", "--no-drift"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "0.log, module 32: 200 samples, no faults" in lines
    assert any(line.startswith("monday/5.blf, module 32: 250 samples, amplitude ") for line in lines)
    assert sum(line.startswith("not done  bad.log") for line in lines) == 1
    assert not any(line.startswith("written") for line in lines)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["month"]
