"""The samples of a replay as CSV, NPZ or Parquet, and tables as Parquet by pyarrow, which is an extra."""

from __future__ import annotations

import csv
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol, Self

import numpy as np

from canfb.errors import CanfbError, ConfigError, reason
from canfb.replay.sample_columns import COLUMNS, Block

HINT = "Parquet needs pyarrow: pip install 'canfb[fleet]'"


def _pyarrow() -> tuple[Any, Any]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise CanfbError(HINT) from error
    return pyarrow, pyarrow.parquet


class ParquetBlocks:
    """A file of blocks of samples, one row group each."""

    def __init__(self, path: Path) -> None:
        self._arrow, parquet = _pyarrow()
        self._schema = self._arrow.schema(
            [(name, self._arrow.from_numpy_dtype(kind)) for name, kind in COLUMNS.items()]
        )
        self._writer = parquet.ParquetWriter(str(path), self._schema)

    def take(self, block: Block) -> None:
        """More rows."""
        arrays = [self._arrow.array(block[name]) for name in COLUMNS]
        self._writer.write_table(self._arrow.Table.from_arrays(arrays, schema=self._schema))

    def close(self) -> None:
        """The file is whole."""
        self._writer.close()


def write_rows(path: Path, rows: Sequence[Mapping[str, Any]], types: Mapping[str, type]) -> None:
    """One table from rows; ``types`` are the columns: str, int, float or bool, each may be None."""
    arrow, parquet = _pyarrow()
    kinds = {str: arrow.string(), int: arrow.int64(), float: arrow.float64(), bool: arrow.bool_()}
    schema = arrow.schema([(name, kinds[kind]) for name, kind in types.items()])
    parquet.write_table(arrow.Table.from_pylist([dict(row) for row in rows], schema=schema), str(path))


def read_rows(path: Path) -> list[dict[str, Any]]:
    """The rows of a table, None for what is not there."""
    _, parquet = _pyarrow()
    rows: list[dict[str, Any]] = parquet.read_table(str(path)).to_pylist()
    return rows


class _Writer(Protocol):
    def take(self, block: Block) -> None: ...

    def close(self) -> None: ...


class _Csv:
    """One line for each interval, below the names."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("w", newline="", encoding="ascii")
        self._rows = csv.writer(self._file, lineterminator="\n")
        self._rows.writerow(COLUMNS)

    def take(self, block: Block) -> None:
        self._rows.writerows(zip(*(block[name].tolist() for name in COLUMNS), strict=True))

    def close(self) -> None:
        self._file.close()


class _Npz:
    """One array for each column. All of them are in the memory until the end."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._blocks: list[Block] = []

    def take(self, block: Block) -> None:
        self._blocks.append(block)

    def close(self) -> None:
        columns: dict[str, Any] = {
            name: np.concatenate([np.empty(0, kind), *(block[name] for block in self._blocks)])
            for name, kind in COLUMNS.items()
        }
        with self._path.open("wb") as file:
            np.savez_compressed(file, **columns)


WRITERS: dict[str, Callable[[Path], _Writer]] = {".csv": _Csv, ".npz": _Npz, ".parquet": ParquetBlocks}


def check_place(option: str, path: Path) -> None:
    """ConfigError for a place where no file can be written."""
    if not path.parent.is_dir():
        raise ConfigError(f"{option} {path}: there is no folder {path.parent}")
    if path.is_dir() or not os.access(path if path.exists() else path.parent, os.W_OK):
        raise ConfigError(f"{option} {path}: cannot be written")


class PublishedFile:
    """A context manager: give it blocks by :meth:`take`. The file is there when it is whole.

    ConfigError for a name or a place that cannot be; CanfbError when it cannot be written, or for Parquet
    without pyarrow.
    """

    def __init__(self, path: Path) -> None:
        if path.suffix.lower() not in WRITERS:
            raise ConfigError(f"--out {path}: the name must end with {', '.join(WRITERS)}")
        check_place("--out", path)
        self._path = path
        self._part = path.with_name(f"{path.name}.part")
        self._writer: _Writer | None = None

    def __enter__(self) -> Self:
        try:
            self._writer = WRITERS[self._path.suffix.lower()](self._part)
        except OSError as error:
            raise self._failed(error) from error
        return self

    def take(self, block: Block) -> None:
        """More rows."""
        assert self._writer is not None
        try:
            self._writer.take(block)
        except OSError as error:
            raise self._failed(error) from error

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        assert self._writer is not None
        try:
            self._writer.close()
            if error is None:
                self._part.replace(self._path)
        except OSError as failure:
            if error is None:
                raise self._failed(failure) from failure
        finally:
            self._part.unlink(missing_ok=True)

    def _failed(self, error: OSError) -> CanfbError:
        return CanfbError(f"--out {self._path}: cannot be written: {reason(error)}")
