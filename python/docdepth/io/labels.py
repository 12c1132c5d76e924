"""Files of labels, one for each sweep: SemanticKITTI's ``.label``, ``.npy`` of classes, PCD."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import DatasetError
from docdepth.geometry.lidar_frame import LidarFrame
from docdepth.geometry.points import (
    DYNAMIC,
    GROUND,
    GROUND_LABELS,
    MOVING_LABEL,
    MOVING_LABELS,
    OUTLIER_LABEL,
    STATIC,
    STATIC_LABEL,
)
from docdepth.io.atomic import WriteFile, write_atomically
from docdepth.io.pcd import PcdError, read_pcd
from docdepth.io.untrusted import ArrayError, read_array, read_file

LABEL_FORMATS = ("label", "classid", "pcd")
"""What labels are converted to: SemanticKITTI's, NPY, and PCD with the class as intensity."""

SUFFIXES = (".label", ".npy", ".pcd")

# Of SemanticKITTI.
CLASS_NAMES = {
    0: "unlabelled", 1: "outlier",
    10: "car", 11: "bicycle", 13: "bus", 15: "motorcycle", 16: "on rails", 18: "truck",
    20: "other vehicle", 30: "person", 31: "bicyclist", 32: "motorcyclist",
    40: "road", 44: "parking", 48: "sidewalk", 49: "other ground", 50: "building", 51: "fence",
    52: "other structure", 60: "lane marking", 70: "vegetation", 71: "trunk", 72: "terrain",
    80: "pole", 81: "traffic sign", 99: "other object",
    251: "moving", 252: "moving car", 253: "moving bicyclist", 254: "moving person",
    255: "moving motorcyclist", 256: "moving on rails", 257: "moving bus", 258: "moving truck",
    259: "moving other vehicle",
}  # fmt: skip
_KNOWN = (*CLASS_NAMES, STATIC_LABEL)
"""Classes of SemanticKITTI and of its benchmark of moving objects."""

_Classes = NDArray[np.uint16]

_ONE_AS_FLOAT = 0x3F800000  # bits of 1.0; as a label, instance 16256 of class 0
_OF_FLOATS = 0x7FFF  # bits that are 0 in all whole float32 up to 511


def label_file(folder: Path, name: str, frame: int) -> Path:
    """The file of a sweep, ``NAME.label``, ``NAME.npy`` or ``NAME.pcd``.

    PCD files may be counted instead, as DynamicMap_Benchmark counts them: ``000000.pcd`` is frame 0
    where names of sweeps are no such numbers themselves.
    """
    for suffix in SUFFIXES:
        if (folder / f"{name}{suffix}").is_file():
            return folder / f"{name}{suffix}"
    counted = folder / f"{frame:06d}.pcd"
    alike = len(name) == len(counted.stem) and name.isdigit()
    if not alike and counted.is_file():
        return counted
    raise DatasetError(
        f"{folder} has no labels of sweep {name} (frame {frame}): neither {name}.label nor "
        f"{name}.npy nor {name if alike else counted.stem}.pcd; label files have the names of the "
        "sweeps"
    )


def read_classes(
    file: Path,
    points: int,
    frame: int,
    returns: Callable[[], NDArray[np.integer[Any]]] | None = None,
) -> tuple[_Classes, _Classes | None]:
    """Classes and instances of every row of a sweep.

    Parameters
    ----------
    file : Path
        ``.label``: one uint32 per row, SemanticKITTI's class in the lower 16 bits and the instance
        in the upper ones. Classes 251 to 259 are dynamic; roads, pavements and terrain are ground.
        ``.npy``: one integer per row, below 50 ground, 50 to 99 static, 100 and above dynamic; or
        one bool per row, True for what moves. ``.pcd``: a field ``label`` as in ``.label``, or else
        an intensity that is 1 for what moves and 0 for the rest; a point for each row, or for each
        usable return.
    points : int
        Rows of the sweep.
    frame : int
        Number of the sweep, for messages.
    returns : callable, optional
        Gives the rows of the sweep that are usable returns, for PCD files that hold these alone.

    Returns
    -------
    classid : ndarray of uint16, shape (points,)
        0 ground, 50 static, 100 dynamic.
    instance : ndarray of uint16, shape (points,), or None
    """
    where = f"{file} (frame {frame})"
    if file.suffix == ".npy":
        return _classes_of(_read_npy(file, where), where, points), None
    if file.suffix == ".pcd":
        labels = _whole(_read_pcd(file, where), where, points, returns)
        classid, instance = classes_of_labels(labels)
        return classid, instance if instance.any() else None
    return classes_of_labels(read_labels(file, points, frame))


def read_labels(file: Path, points: int, frame: int) -> NDArray[np.uint32]:
    """SemanticKITTI's label of every row of a sweep, shape (points,), from a ``.label`` file."""
    where = f"{file} (frame {frame})"
    try:
        content = read_file(file)
    except FileNotFoundError:
        raise DatasetError(
            f"{where} cannot be read: it is missing; labels lie in files called as "
            "their sweeps, NAME.label"
        ) from None
    except OSError as error:
        raise DatasetError(f"{where} cannot be read: {error.strerror}") from None
    if len(content) % 4:
        raise DatasetError(
            f"{where} has {len(content)} bytes; labels are one uint32 for each point; copy it again"
        )
    labels: NDArray[np.uint32] = np.frombuffer(content, "<u4")
    _check_count(len(labels), where, points)
    told = labels[labels > 0]
    if len(told) and told.min() >= _ONE_AS_FLOAT and not (told & _OF_FLOATS).any():
        raise DatasetError(f"{where} holds float32 numbers; write labels as uint32")
    return labels


def read_truth(file: Path, points: int, frame: int) -> NDArray[np.uint32]:
    """:func:`read_labels` of true labels, whose classes are SemanticKITTI's alone."""
    labels = read_labels(file, points, frame)
    other = np.setdiff1d(labels & 0xFFFF, _KNOWN)
    if len(other):
        raise DatasetError(
            f"{file} (frame {frame}) has the class {other[0]}, which SemanticKITTI does not have: "
            "labels are of another numbering, such as ids for training; map them to SemanticKITTI's"
        )
    return labels


def classes_of_labels(labels: NDArray[np.uint32]) -> tuple[_Classes, _Classes]:
    """Classes and instances of SemanticKITTI's labels, each uint16 of shape (N,)."""
    kind = labels & 0xFFFF
    classid = np.full(len(labels), STATIC, np.uint16)
    classid[np.isin(kind, GROUND_LABELS)] = GROUND
    classid[np.isin(kind, MOVING_LABELS)] = DYNAMIC
    return classid, (labels >> 16).astype(np.uint16)


def write_labels(path: Path, frame: LidarFrame, write_file: WriteFile = write_atomically) -> None:
    """Write classes and instances of a frame as SemanticKITTI's labels, for all rows of the sweep.

    9 is static or ground, 251 dynamic, 1 a row that is no usable return.
    """
    assert frame.classid is not None
    rows = np.full(frame.input_points, OUTLIER_LABEL, np.uint32)
    labels = np.where(frame.classid >= DYNAMIC, MOVING_LABEL, STATIC_LABEL).astype(np.uint32)
    if frame.instance is not None:
        labels |= frame.instance.astype(np.uint32) << 16
    rows[frame.index] = labels
    write_file(path, rows.tobytes())


def _read_pcd(file: Path, where: str) -> NDArray[np.uint32]:
    """Labels as SemanticKITTI's of every point of a PCD file."""
    try:
        rows, _ = read_pcd(file)
    except (OSError, PcdError) as error:
        raise DatasetError(f"{where}: {error}; write it again") from None
    name = next((n for n in ("label", "intensity") if n in (rows.dtype.names or ())), None)
    if name is None:
        raise DatasetError(f"{where} has neither a field label nor intensity, which tell classes")
    values = rows[name]
    if values.ndim != 1:
        raise DatasetError(f"{where}: {name} has {values.shape[1]} values a point; a class is one")
    if name == "label":
        if not (np.isfinite(values) & (values >= 0) & (values == np.floor(values))).all():
            raise DatasetError(f"{where}: label must be whole numbers, as SemanticKITTI's classes")
        return np.asarray(values).astype(np.uint32)
    if not np.isin(values, (0, 1)).all():
        raise DatasetError(
            f"{where}: intensity is no class; labels have 1 for what moves and 0 for the rest, or "
            "a field label"
        )
    return np.where(values == 1, MOVING_LABEL, STATIC_LABEL).astype(np.uint32)


def _whole(
    labels: NDArray[np.uint32],
    where: str,
    points: int,
    returns: Callable[[], NDArray[np.integer[Any]]] | None,
) -> NDArray[np.uint32]:
    """Labels of all rows of a sweep from those of all or of its usable returns."""
    if len(labels) == points or returns is None:
        _check_count(len(labels), where, points)
        return labels
    rows = returns()
    if len(rows) != len(labels):
        raise DatasetError(
            f"{where} has {len(labels)} points for a sweep of {points} points, of "
            f"which {len(rows)} are usable returns; it holds one or the other, in their order"
        )
    whole = np.full(points, OUTLIER_LABEL, np.uint32)
    whole[rows] = labels
    return whole


def _read_npy(file: Path, where: str) -> NDArray[Any]:
    try:
        values = read_array(file)
    except (OSError, ArrayError) as error:
        raise DatasetError(f"{where} cannot be read as NPY ({error}); write it again") from None
    if values.ndim != 1 or values.dtype.kind not in "uib":
        raise DatasetError(
            f"{where} must be integers or bool of shape (N,), one for each point; "
            f"got {values.dtype} {values.shape}"
        )
    return values


def _classes_of(values: NDArray[Any], where: str, points: int) -> _Classes:
    _check_count(len(values), where, points)
    if values.dtype.kind == "b":
        return np.where(values, DYNAMIC, STATIC).astype(np.uint16)
    if len(values) and values.min() < 0:
        raise DatasetError(
            f"{where} has the class {values.min()}; below 50 is ground, "
            "50 to 99 for static, 100 and above for dynamic"
        )
    told = np.setdiff1d(values, (GROUND, STATIC, DYNAMIC))
    if len(np.setdiff1d(told, 1)) and np.isin(told, _KNOWN).all():
        raise DatasetError(
            f"{where} has classes as SemanticKITTI's ({told[-1]}); write "
            "0 for ground, 50 for static and 100 for dynamic, or bool, or uint32 as .label"
        )
    return np.where(values >= DYNAMIC, DYNAMIC, np.where(values < STATIC, GROUND, STATIC)).astype(
        np.uint16
    )


def _check_count(labels: int, where: str, points: int) -> None:
    if labels != points:
        raise DatasetError(
            f"{where} has {labels} labels for a sweep of {points} points; there is "
            "one for each row of the sweep, unusable rows too, in its order"
        )
