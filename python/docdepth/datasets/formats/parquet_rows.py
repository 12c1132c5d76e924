"""Rows of a Parquet file by their keys, through pyarrow."""

from __future__ import annotations

import threading
from importlib import import_module
from pathlib import Path
from typing import Any

from docdepth.datasets.files import extra, unreadable
from docdepth.errors import DatasetError

Key = tuple[int, ...]


class ParquetRows:
    """A Parquet file whose rows are read one at a time, from any thread.

    Parameters
    ----------
    file : Path
    keys : tuple of str
        Columns of whole numbers that tell a row.
    remedy : str
        What to do if the file is missing or damaged.

    Attributes
    ----------
    file : Path
    rows : dict
        By key the number of the group of rows, and of the row in it.

    Raises
    ------
    DatasetError
        The file is missing, damaged or lacks a column.
    MissingExtraError
        pyarrow is not installed.
    """

    def __init__(self, file: Path, keys: tuple[str, ...], remedy: str) -> None:
        self.file, self._remedy = file, remedy
        self._lock = threading.Lock()
        self._opened: Any = None
        self._group: tuple[int, tuple[str, ...], Any] | None = None
        self.rows: dict[Key, tuple[int, int]] = {}
        for group in range(self._call(lambda parquet: parquet.num_row_groups, str(file))):
            table = self._read_group(group, keys, str(file))
            columns = [table[name].to_pylist() for name in keys]
            for row, key in enumerate(zip(*columns, strict=True)):
                self.rows[tuple(int(part) for part in key)] = group, row
        self._group = None

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_lock": None, "_opened": None, "_group": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._lock = threading.Lock()

    def read(self, key: Key, columns: tuple[str, ...], where: str) -> list[Any]:
        """Values of the columns in a row, as scalars of pyarrow.

        Groups of rows are read whole: the last one is kept, as rows are asked for in turn.

        Raises
        ------
        DatasetError
            There is no such row or column, or the file is damaged.
        """
        if key not in self.rows:
            raise DatasetError(f"{where}: the file has no such row; {self._remedy}")
        group, row = self.rows[key]
        with self._lock:
            if self._group is None or self._group[:2] != (group, columns):
                self._group = group, columns, self._read_group(group, columns, where)
            table = self._group[2]
        return [table[name][row] for name in columns]

    def _read_group(self, group: int, columns: tuple[str, ...], where: str) -> Any:
        def read(parquet: Any) -> Any:
            lacking = [name for name in columns if name not in parquet.schema_arrow.names]
            if lacking:
                raise DatasetError(f"{where} has no column {lacking[0]}; {self._remedy}")
            return parquet.read_row_group(group, columns=list(columns))

        return self._call(read, where)

    def _call(self, function: Any, where: str) -> Any:
        """A result of the opened file; the lock is held, or no one else has the object."""
        parquet = extra("pyarrow.parquet", "Parquet files need pyarrow", "argoverse")
        pyarrow = import_module("pyarrow")
        if not self.file.is_file():
            raise unreadable(self.file, self._remedy)
        try:
            if self._opened is None:
                self._opened = parquet.ParquetFile(self.file)
            return function(self._opened)
        except (pyarrow.ArrowException, OSError) as error:
            raise DatasetError(
                f"{where} is no whole Parquet file ({error}); {self._remedy}"
            ) from None
