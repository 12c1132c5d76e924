"""Depth maps on disk: PNG as KITTI writes it, NPY and NPZ with every bit.

In memory a depth map is float32 metres along the optical axis, NaN = none.
"""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from docdepth.errors import DatasetError, InputError
from docdepth.io.atomic import write_atomically

PNG_SCALE = 256.0
"""Steps of a PNG a metre (KITTI)."""

PNG_MAX_DEPTH = 65535 / PNG_SCALE
"""The deepest that a PNG can hold [m]."""

SUFFIXES = (".png", ".npy", ".npz")


def encode_png(depth: NDArray[np.float32]) -> bytes:
    """A depth map as a PNG of uint16: metres x 256, rounded, 0 = none.

    Parameters
    ----------
    depth : ndarray of float32, shape (h, w)
        Metres, NaN = none.

    Raises
    ------
    InputError
        A depth is not positive, or too large for the format: nothing is wrapped or cut.
    """
    depth = _checked(depth)
    with np.errstate(invalid="ignore"):
        deep = depth * PNG_SCALE >= 65535.5
    if deep.any():
        row, column = np.argwhere(deep)[0]
        raise InputError(
            f"{np.count_nonzero(deep)} pixels are deeper than the {PNG_MAX_DEPTH:.2f} m that a PNG "
            f"of metres x 256 can hold, the first is {depth[row, column]:.2f} m in row {row}, "
            f"column {column}; write NPY, or leave out points beyond with render.crop"
        )
    # A depth that would round to 0 would be lost; one step is as near as the format gets.
    steps = np.maximum(np.rint(depth * PNG_SCALE), 1)
    pixels = np.where(np.isnan(depth), 0, steps).astype(np.uint16)
    _, encoded = cv2.imencode(".png", pixels)
    return bytes(encoded.tobytes())


def write_depth(path: Path, depth: NDArray[np.float32]) -> None:
    """Write a depth map in the format that the name ends in: .png, .npy or .npz.

    Parameters
    ----------
    path : Path
    depth : ndarray of float32, shape (h, w)
        Metres, NaN = none.

    Raises
    ------
    InputError
        The format is unknown or cannot hold the depth.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix == ".png":
        content = encode_png(depth)
    elif suffix in SUFFIXES:
        stream = io.BytesIO()
        if suffix == ".npy":
            np.save(stream, _checked(depth))
        else:
            np.savez_compressed(stream, depth=_checked(depth))
        content = stream.getvalue()
    else:
        raise InputError(f"{path}: depth is written as {', '.join(SUFFIXES)}, not {suffix!r}")
    write_atomically(path, lambda out: out.write(content))


def read_depth(path: Path) -> NDArray[np.float32]:
    """Read a depth map written by :func:`write_depth` or by others in these formats.

    Parameters
    ----------
    path : Path
        A PNG of uint16 (metres x 256, 0 = none), or NPY or NPZ of float metres (NaN or 0 = none).

    Returns
    -------
    ndarray of float32, shape (h, w)
        Metres, NaN = none.

    Raises
    ------
    DatasetError
        The file is missing, damaged or of another kind.
    """
    path = Path(path)
    if not path.is_file():
        raise DatasetError(f"{path} is missing")
    suffix = path.suffix.lower()
    if suffix == ".png":
        return _read_png(path)
    if suffix not in SUFFIXES:
        raise DatasetError(f"{path}: depth is read from {', '.join(SUFFIXES)}, not {suffix!r}")
    depth = _load(path)
    if depth.ndim != 2 or depth.dtype.kind != "f":
        raise DatasetError(
            f"{path} holds {depth.dtype} {depth.shape}, not float metres of shape (h, w)"
        )
    return np.where(depth == 0, np.float32(np.nan), depth).astype(np.float32)


def _read_png(path: Path) -> NDArray[np.float32]:
    # Read in Python and decoded from memory: OpenCV complains on its own channels otherwise.
    content = np.frombuffer(path.read_bytes(), np.uint8)
    pixels = cv2.imdecode(content, cv2.IMREAD_UNCHANGED) if len(content) else None
    if pixels is None:
        raise DatasetError(f"{path} is not a readable PNG; delete it and render again")
    if pixels.dtype != np.uint16 or pixels.ndim != 2:
        raise DatasetError(
            f"{path} holds {pixels.dtype} {pixels.shape}; depth is one channel of uint16, "
            "metres x 256"
        )
    depth = pixels.astype(np.float32) / np.float32(PNG_SCALE)
    depth[pixels == 0] = np.nan
    return np.asarray(depth, np.float32)


def _load(path: Path) -> NDArray[Any]:
    try:
        with path.open("rb") as stream:
            loaded = np.load(stream, allow_pickle=False)
            if not isinstance(loaded, np.ndarray):
                loaded = loaded["depth"]
    except KeyError:
        raise DatasetError(f"{path} has no array named 'depth'") from None
    except (ValueError, EOFError, OSError, zipfile.BadZipFile) as error:
        raise DatasetError(f"{path} is damaged: {error}") from None
    return np.asarray(loaded)


def _checked(depth: NDArray[np.float32]) -> NDArray[np.float32]:
    depth = np.asarray(depth)
    if depth.ndim != 2 or depth.dtype != np.float32:
        raise InputError(
            f"a depth map is float32 metres of shape (h, w); got {depth.dtype} {depth.shape}"
        )
    with np.errstate(invalid="ignore"):
        wrong = (depth <= 0) | np.isinf(depth)
    if wrong.any():
        row, column = np.argwhere(wrong)[0]
        raise InputError(
            f"{np.count_nonzero(wrong)} depths are not positive and finite, the first is "
            f"{depth[row, column]} in row {row}, column {column}; NaN means no depth"
        )
    return depth
