"""Rows of a Parquet file by their keys, through pyarrow."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

from docdepth.datasets.files import OpenedOnce, extra, unreadable
from docdepth.errors import DatasetError

Key = tuple[int, ...]


class ParquetRows:
    """A Parquet file whose rows are read one at a time, from any thread.

    ``keys`` are columns of whole numbers that tell a row. Attribute ``rows`` has by key the number
    of the group of rows, and of the row in it.
    """

    def __init__(self, file: Path, keys: tuple[str, ...], remedy: str) -> None:
        self.file, self._remedy = file, remedy
        self._opened: OpenedOnce[Any] = OpenedOnce(partial(_open, file))
        self._group: tuple[int, tuple[str, ...], Any] | None = None
        self.rows: dict[Key, tuple[int, int]] = {}
        for group in range(self._call(lambda parquet: parquet.num_row_groups, str(file))):
            table = self._read_group(group, keys, str(file))
            columns = [table[name].to_pylist() for name in keys]
            for row, key in enumerate(zip(*columns, strict=True)):
                self.rows[tuple(int(part) for part in key)] = group, row
        self._group = None

    def __getstate__(self) -> dict[str, object]:
        return {**self.__dict__, "_group": None}

    def read(self, key: Key, columns: tuple[str, ...], where: str) -> list[Any]:
        """Values of the columns in a row, as scalars of pyarrow.

        Groups of rows are read whole: the last one is kept, as rows are asked for in turn.
        """
        if key not in self.rows:
            raise DatasetError(f"{where}: the file has no such row; {self._remedy}")
        group, row = self.rows[key]
        table = self._read_group(group, columns, where)
        return [table[name][row] for name in columns]

    def _read_group(self, group: int, columns: tuple[str, ...], where: str) -> Any:
        def read(parquet: Any) -> Any:
            lacking = [name for name in columns if name not in parquet.schema_arrow.names]
            if lacking:
                raise DatasetError(f"{where} has no column {lacking[0]}; {self._remedy}")
            if self._group is None or self._group[:2] != (group, columns):
                self._group = group, columns, parquet.read_row_group(group, columns=list(columns))
            return self._group[2]

        return self._call(read, where)

    def _call(self, function: Any, where: str) -> Any:
        """A result of the opened file."""
        pyarrow = extra("pyarrow", "Parquet files need pyarrow", "argoverse")
        if not self.file.is_file():
            raise unreadable(self.file, self._remedy)
        try:
            with self._opened as parquet:
                return function(parquet)
        except (pyarrow.ArrowException, OSError) as error:
            raise DatasetError(
                f"{where} is no whole Parquet file ({error}); {self._remedy}"
            ) from None


def _open(file: Path) -> Any:
    from pyarrow import parquet

    return parquet.ParquetFile(file)
