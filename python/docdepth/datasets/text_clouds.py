"""Sweeps as text: a point a line, its values divided by commas, semicolons or blanks."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import DatasetError
from docdepth.io.untrusted import ArrayError, parse_numbers, read_file

_MOST_TEXT = 1 << 30  # bytes of a file
_LONGEST_HEAD = 100  # lines before the first point
_COMMENTS = (b"#", b"//")
_UNIT = re.compile(r"[\[(] *(\w*).*")  # behind a name: ``x [m]``
_METRES = {"mm": 1e-3, "cm": 1e-2}  # other units are found in the values, or mean nothing
_OF_PARAVIEW = re.compile(r"points.*:([012])")  # ``Points_m_XYZ:0`` of VeloView


def read_table(file: Path, where: str) -> tuple[list[str] | None, NDArray[np.float64]]:
    """The numbers of a text, one row a line, and the names of the columns if the text has them.

    Names stand in the line before the first row, as a comment or not. Values that are left out are
    NaN. ``where`` names file and frame in errors.

    Returns
    -------
    names : list of str or None
        In small letters, without units. Columns without a name are ``_``.
    table : ndarray of float64, shape (N, columns)

    Raises
    ------
    DatasetError
        The file holds no table of numbers.
    """
    content = read_file(file, _MOST_TEXT).removeprefix(b"\xef\xbb\xbf")
    numbered = [(n, line) for n, line in enumerate(content.splitlines(), 1) if line.strip()]
    lines = [line for _, line in numbered]
    first = next((k for k, line in enumerate(lines[:_LONGEST_HEAD]) if _is_row(line)), None)
    if first is None:
        raise DatasetError(
            f"{where} holds no line of numbers; write a point a line, x y z first or with a line "
            "of names before them, and decimals with a point"
        )
    mark = _mark(lines[first])
    kept = [(n, line) for n, line in numbered[first:] if not line.startswith(_COMMENTS)]
    rows = [_words(line, mark) for _, line in kept]
    for (n, line), row in zip(kept, rows, strict=True):
        if len(row) != len(rows[0]):
            raise DatasetError(
                f"{where}, line {n}, has {len(row)} values in the line {_shown(line)}, and "
                f"{len(rows[0])} in the first; copy the sweep again"
            )
    words = np.array(rows)
    words[words == b""] = b"nan"
    try:
        table = parse_numbers(words, "f8")
    except ArrayError as error:
        raise DatasetError(f"{where} holds a value that is no number ({error})") from None
    names, scales = _names(lines[first - 1]) if first else ([], [])
    if len(scales) == table.shape[1]:
        table *= scales
    used = ~np.isnan(table).all(axis=0)
    used[: len(names)] = True  # a mark at the end of each line makes an empty column
    table = table[:, used]
    return (names if len(names) == table.shape[1] else None), table


def _mark(line: bytes) -> bytes | None:
    """What divides the values of a line; None for blanks."""
    return next((mark for mark in (b";", b",", b"\t") if mark in line), None)


def _words(line: bytes, mark: bytes | None) -> list[bytes]:
    if mark == b";":
        line = line.replace(b",", b".")  # decimals of many countries
    return [word.strip(b' \t"') for word in line.split(mark)]


def _is_row(line: bytes) -> bool:
    words = [word for word in _words(line, _mark(line)) if word]
    try:
        return len(parse_numbers(np.array(words), "f8")) >= 3
    except ArrayError:
        return False


def _names(line: bytes) -> tuple[list[str], list[float]]:
    """Names of the columns, and what makes metres of their values."""
    for comment in _COMMENTS:
        line = line.removeprefix(comment)
    mark = (_mark(line) or b"").decode()
    text = re.sub(r" +(?=[\[(])", "", line.strip().decode("utf-8", "replace").lower())
    words = [word.strip(" \"'") for word in text.rstrip(mark).split(mark or None)]
    units = [_UNIT.search(word) for word in words]
    scales = [_METRES.get(unit[1] if unit else "m", 1.0) for unit in units]
    named = {word for word in words if word in ("x", "y", "z")}
    for k, word in enumerate(words):
        word = _UNIT.sub("", word).strip()
        if (axis := _OF_PARAVIEW.fullmatch(word)) and "xyz"[int(axis[1])] not in named:
            word = "xyz"[int(axis[1])]
        words[k] = word or "_"
    return words, scales


def _shown(line: bytes) -> str:
    return repr(line[:60].decode("utf-8", "replace"))
