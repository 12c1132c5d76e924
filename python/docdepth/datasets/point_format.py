"""Which format the rows of a sweep file have, told from its numbers alone.

docdepth reads ``x y z reflectance`` as 4 float32. Read so, a file of another format is a cloud of
garbage. Columns of a table have values of their own: heights spread less than distances,
reflectances are not negative. Cut into rows of a wrong length, every column holds a mixture of all
and they look alike. That holds for any sensor and any order of the rows.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_FEWEST_POINTS = 200  # fewer tell nothing
_MOST_VALUES = 400_000  # of a file; more take time and tell no more
_ALIKE = 0.1  # of columns in rows of a wrong length; recorded sweeps stay below 0.04
_DISTINCT = 0.25  # of columns in rows of the right length; recorded sweeps have 0.37 and more
_PLAUSIBLE = (1e-7, 1e5)  # magnitude of a number that is a coordinate or a reflectance
_DOUBLES = 0.99  # share of plausible numbers in a file of float64, read as such
_NO_FLOATS = 0.9  # and read as float32: the low halves of doubles are random bits

_NAMES = {
    3: "3 float32 a point (x y z)",
    5: "5 float32 a point (nuScenes)",
    6: "6 float32 a point",
    7: "7 float32 a point",
}


def foreign_format(content: bytes) -> str | None:
    """The format of the content of a sweep file that is not ``x y z reflectance`` as 4 float32.

    For example ``5 float32 a point (nuScenes)``; None for the right format, and where no other
    format clearly fits better.
    """
    floats = np.frombuffer(content, "<f4", len(content) // 4)
    if len(floats) < 4 * _FEWEST_POINTS:
        return None
    doubles = np.frombuffer(content, "<f8", len(content) // 8)
    if len(content) % 8 == 0 and _plausible(doubles) > _DOUBLES and _plausible(floats) < _NO_FLOATS:
        for columns, names in ((4, "x y z reflectance"), (3, "x y z")):
            if len(doubles) % columns == 0 and _distinction(doubles, columns) > _DISTINCT:
                return f"{columns} float64 a point ({names})"
        return "float64"
    if not np.isfinite(floats).all() or _distinction(floats, 4) > _ALIKE:
        return None
    fits = {c: _distinction(floats, c) for c in _NAMES if len(floats) % c == 0}
    if fits.get(6, 0) > _DISTINCT:
        fits.pop(3, None)  # rows of six are distinct in threes, but not the other way round
    best = max(fits, key=lambda columns: fits[columns], default=0)
    return _NAMES[best] if best and fits[best] > _DISTINCT else None


def _plausible(values: NDArray[np.floating]) -> float:
    """Share of numbers that may be coordinates or reflectances."""
    magnitude = np.abs(values)
    good = (values == 0) | ((magnitude > _PLAUSIBLE[0]) & (magnitude < _PLAUSIBLE[1]))
    return float(good.mean())


def _distinction(values: NDArray[np.floating], columns: int) -> float:
    """How much columns differ when the values are cut into rows: 0 alike, 1 without overlap.

    Of an even number of columns those half a row apart are compared, as these are alike also where
    the true number shares a factor with it. Otherwise x and y are compared with z.
    """
    rows = min(len(values), _MOST_VALUES) // columns
    table = values[: rows * columns].reshape(rows, columns)
    half = columns // 2
    pairs = [(0, 2), (1, 2)] if columns % 2 else [(j, j + half) for j in range(half)]
    return max(_distance(table[:, a], table[:, b]) for a, b in pairs)


def _distance(a: NDArray[np.floating], b: NDArray[np.floating]) -> float:
    """Largest difference of the two distributions (Kolmogorov and Smirnov)."""
    a, b = np.sort(a), np.sort(b)
    values = np.concatenate([a, b])
    share_a = np.searchsorted(a, values, "right") / len(a)
    share_b = np.searchsorted(b, values, "right") / len(b)
    return float(np.abs(share_a - share_b).max())
