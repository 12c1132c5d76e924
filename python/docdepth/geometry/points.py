"""Points of a sweep: class ids, labels, usable returns; checks of them and of other arrays."""

from __future__ import annotations

import logging
from dataclasses import fields
from operator import index
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from docdepth.errors import NOTE, InputError

log = logging.getLogger(__name__)

GROUND, STATIC, DYNAMIC = 0, 50, 100
"""Values of ``classid`` as ``frames/*.ply`` stores it; below 50 is ground, from 100 on dynamic."""

OUTLIER_LABEL, STATIC_LABEL, MOVING_LABEL = 1, 9, 251
"""Values of ``labels/*.label``, of SemanticKITTI's moving object segmentation."""

MOVING_LABELS = tuple(range(251, 260))
"""SemanticKITTI's classes of what moves; 251 stands for all of them."""

GROUND_LABELS = (40, 44, 48, 49, 60, 72)
"""SemanticKITTI's road, parking, sidewalk, other ground, lane marking and terrain."""


FARTHEST = 1e5
"""No LiDAR sees so far [m]: where nothing returned, some drivers write such numbers."""


def usable_points(points: NDArray[np.float32], min_range: float = 0.5) -> NDArray[np.bool_]:
    """Which rows are returns: not NaN, not at the origin, and not beyond :data:`FARTHEST`.

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)
        Metres.
    min_range : float
        Nearer rows count as at the origin [m].

    Returns
    -------
    ndarray of bool, shape (N,)
    """
    x, y, z = points[:, 0], points[:, 1], points[:, 2]
    with np.errstate(invalid="ignore", over="ignore"):
        squared = x * x + y * y + z * z
        usable: NDArray[np.bool_] = squared >= min_range * min_range
        usable &= squared < FARTHEST * FARTHEST
    return usable


def elevation_of(points: NDArray[np.floating[Any]]) -> NDArray[np.floating[Any]]:
    """Angle of points (..., 3) above the plane z = 0 as seen from the origin [rad]."""
    return np.arctan2(points[..., 2], np.hypot(points[..., 0], points[..., 1]))


def evenly(count: int, most: int) -> list[int]:
    """At most ``most`` of ``count`` indices, with the first and the last; fractions are cut."""
    return np.linspace(0, count - 1, min(count, most)).astype(int).tolist()


def spread(values: NDArray[Any], rows: NDArray[Any], count: int, fill: Any = 0) -> NDArray[Any]:
    """Values of some rows, numbers or a mask, as values of all ``count`` rows."""
    if len(values) == count:
        return values
    every = np.full(count, fill, values.dtype)
    every[rows] = values
    return every


def check_points(points: Any) -> NDArray[np.float32]:
    """Points as a contiguous array of float32, shape (N, 3).

    Other floats are converted, and a fourth column, such as KITTI's intensity, is left out; this is
    logged once.

    Parameters
    ----------
    points : ndarray of float, shape (N, 3) or (N, 4), or an array of another library
        Metres.
    """
    array = as_array(points)
    if array.ndim != 2 or array.shape[1] not in (3, 4) or array.dtype.kind != "f":
        raise InputError(
            f"points must be float32 of shape (N, 3), got {array.dtype} {array.shape}; "
            + _remedy(array)
        )
    if array.shape[1] != 3 or array.dtype != np.float32:
        _tell_conversion(str(array.dtype), array.shape[1])
    return np.ascontiguousarray(array[:, :3], np.float32)


def _remedy(array: NDArray[Any]) -> str:
    numbers = array.dtype.kind in "iuf" and array.ndim == 2
    if numbers and array.shape[0] in (3, 4) and array.shape[1] not in (3, 4):
        return "give a row for each point: points.T"
    if numbers and array.shape[1] >= 3:
        return "convert them once where they are read: np.asarray(points, np.float32)[:, :3]"
    return "give a row of x, y, z in metres for each point"


_told: set[tuple[str, int]] = set()  # of a drive's thousands of sweeps it is said once
_telling = Lock()  # sweeps are read by several threads


def _tell_conversion(dtype: str, columns: int) -> None:
    with _telling:
        if (dtype, columns) in _told:
            return
        _told.add((dtype, columns))
    text = "points of %s (N, %d) are taken as float32 (N, 3): metres x, y, z"
    log.log(NOTE, text, dtype, columns)


def as_array(values: Any) -> NDArray[Any]:
    """An array of NumPy, or of a library that has ``__array__`` or DLPack."""
    values = unmasked(values)
    try:
        if hasattr(values, "__dlpack__") and not hasattr(values, "__array__"):
            return np.from_dlpack(values)
        return np.asarray(values)
    except Exception as error:  # each library has errors of its own
        raise InputError(f"{type(values).__name__} cannot be read as an array: {error}") from None


def unmasked(values: Any) -> Any:
    """The same values; floats that a masked array hides are NaN."""
    if not isinstance(values, np.ma.MaskedArray):
        return values
    if values.dtype.names is None and not np.ma.is_masked(values):
        return values
    if values.dtype.kind != "f":
        raise InputError(
            f"values of {values.dtype} are masked; say what they are: values.filled(...)"
        )
    return values.filled(np.nan)


def check_classes(classid: Any) -> NDArray[np.uint16]:
    """Classes as uint16; of bool, true is what moves."""
    array = as_array(classid)
    if array.dtype == np.bool_:
        return np.where(array, np.uint16(DYNAMIC), np.uint16(STATIC))
    if array.dtype.kind not in "iu" or (
        array.size and (array.min() < 0 or array.max() > np.iinfo(np.uint16).max)
    ):
        raise InputError(f"classes must be uint16, got {array.dtype}")
    return array.astype(np.uint16, copy=False)


def check_sweep(
    points: NDArray[np.float32], ground: NDArray[np.bool_]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Points and their ground flags as contiguous arrays."""
    points, ground = check_points(points), np.asarray(ground)
    if ground.dtype != np.bool_ or ground.shape != points.shape[:1]:
        raise InputError(
            f"ground must be bool of shape ({len(points)},), one flag a point, "
            f"got {ground.dtype} {ground.shape}"
        )
    return points, np.ascontiguousarray(ground)


_SHOWN_NUMBERS = 9  # of an array: those of K
_SHOWN_ITEMS = 3


class ShortRepr:
    """A dataclass in one line: of large arrays dtype and shape, of long lists the length."""

    def __repr__(self) -> str:
        shown = ((f.name, getattr(self, f.name)) for f in fields(self))  # type: ignore[arg-type]
        given = ", ".join(f"{name}={_short(value)}" for name, value in shown if value is not None)
        return f"{type(self).__name__}({given})"


def _short(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return (
            str(value.tolist()) if value.size <= _SHOWN_NUMBERS else f"{value.dtype} {value.shape}"
        )
    if isinstance(value, list | tuple | dict) and len(value) > _SHOWN_ITEMS:
        return f"{type(value).__name__} of {len(value)}"
    return repr(value)


def as_integer(value: Any, what: str) -> int:
    """An integer of Python's, NumPy's or another library's; an error begins with ``what``."""
    try:
        if isinstance(value, bool):
            raise TypeError
        return index(value)
    except TypeError:
        raise InputError(f"{what}, not {value!r}") from None


def float_array(name: str, values: ArrayLike) -> NDArray[np.float64]:
    """A copy of ``values`` as float64."""
    values = unmasked(values)
    try:
        if np.iscomplexobj(values):  # NumPy would leave out the imaginary part
            raise ValueError
        return np.array(values, np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{name} must be an array of real numbers") from None


def nanoseconds(name: str, values: ArrayLike) -> NDArray[np.int64]:
    """A copy of times as int64 nanoseconds; NumPy's ``datetime64`` is converted.

    Floats are refused: they hold nanoseconds of today to 256 ns, and are probably seconds.
    """
    values = unmasked(values)
    try:
        array = np.asarray(values)
    except ValueError:
        raise InputError(f"{name} must be an array of integers, nanoseconds") from None
    if array.dtype.kind == "M":
        if np.isnat(array).any():
            raise InputError(f"{name}: one of them is NaT, no time")
        array = array.astype("datetime64[ns]").view(np.int64)
    if array.size and array.dtype.kind not in "iu":
        raise InputError(
            f"{name} must be integers, nanoseconds; got {array.dtype}. "
            "Of seconds: np.round(seconds * 1e9).astype(np.int64)"
        )
    if array.dtype == np.uint64 and array.size and array.max() > np.iinfo(np.int64).max:
        raise InputError(f"{name}: {array.max()} is too large for int64 nanoseconds")
    return array.astype(np.int64)
