"""The files of a replay: samples as CSV, NPZ or Parquet, tables as Parquet by pyarrow, which is an extra, and
the report, one HTML file that stands alone."""

from __future__ import annotations

import contextlib
import csv
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from canfb.errors import CanfbError, ConfigError
from canfb.files import check_writable, replacing, writing
from canfb.logfile.log_reader import BusLogFile
from canfb.replay.findings import COLUMNS, Block, Overview
from canfb.replay.module_replay import ModuleReplay
from canfb.replay.replay_result import ReplayResult
from canfb.report.page import beside, figure, gallery, page, table
from canfb.report.pictures import Curve, lissajous, over_time
from canfb.rows import Row
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
    schema = arrow.schema([(name, arrow.from_numpy_dtype(kind)) for name, kind in COLUMNS.items()])
    with parquet.ParquetWriter(str(path), schema) as writer:
        yield lambda block: writer.write_table(
            arrow.Table.from_arrays([arrow.array(block[name]) for name in COLUMNS], schema=schema)
        )


@contextlib.contextmanager
def _csv(path: Path) -> Iterator[Take]:
    with path.open("w", newline="", encoding="ascii") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(COLUMNS)
        yield lambda block: rows.writerows(zip(*(block[name].tolist() for name in COLUMNS), strict=True))


@contextlib.contextmanager
def _npz(path: Path) -> Iterator[Take]:
    """All blocks are in the memory until the end."""
    blocks: list[Block] = []
    yield blocks.append
    columns: dict[str, Any] = {
        name: np.concatenate([np.empty(0, kind), *(block[name] for block in blocks)])
        for name, kind in COLUMNS.items()
    }
    with path.open("wb") as file:
        np.savez_compressed(file, **columns)


WRITERS = {".csv": _csv, ".npz": _npz, ".parquet": _parquet}


def write_rows(path: Path, rows: Sequence[Mapping[str, Any]], types: Mapping[str, type]) -> None:
    """One table from rows; ``types`` are the columns: str, int, float or bool, each may be None."""
    arrow, parquet = _pyarrow()
    kinds = {str: arrow.string(), int: arrow.int64(), float: arrow.float64(), bool: arrow.bool_()}
    schema = arrow.schema([(name, kinds[kind]) for name, kind in types.items()])
    parquet.write_table(arrow.Table.from_pylist([dict(row) for row in rows], schema=schema), str(path))


def read_rows(path: Path) -> list[dict[str, Any]]:
    _, parquet = _pyarrow()
    rows: list[dict[str, Any]] = parquet.read_table(str(path)).to_pylist()
    return rows


@contextlib.contextmanager
def published(path: Path) -> Iterator[Take]:
    """What takes the blocks of samples; the file is there when it is whole.

    ConfigError for a name or a place that cannot be; CanfbError when it cannot be written, or for Parquet
    without pyarrow.
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
    tables = table("Margins", [*result.facts(), *log.counters.facts(log.trouble)])
    compared = result.comparison()
    if compared:
        tables += table("The recorded module and the replay", compared)
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
    said = [f"{one[:1].upper()}{one[1:]}." for one in (*result.notes(), result.verdict())]
    text = page(f"Replay of {log.path.name}", result.head(), said, body, "Margin: what is left of it", good)
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
