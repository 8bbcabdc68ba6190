"""The samples of a replay as CSV, NPZ or Parquet, and tables as Parquet by pyarrow, which is an extra."""

from __future__ import annotations

import contextlib
import csv
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from canfb.errors import CanfbError, ConfigError
from canfb.files import check_writable, replacing, writing
from canfb.replay.sample_columns import COLUMNS, Block

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
