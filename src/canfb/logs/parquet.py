"""Parquet by pyarrow, which is an extra: the one place that knows it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from canfb.errors import CanfbError
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
