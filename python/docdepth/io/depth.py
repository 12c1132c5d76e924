"""Depth maps on disk: PNG as KITTI writes it; NPY, NPZ, TIFF and EXR as floats.

In memory a depth map is float32 metres along the optical axis, NaN = none.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from docdepth.errors import DamagedFileError, DatasetError, InputError
from docdepth.geometry.points import unmasked
from docdepth.io.atomic import npz_bytes, write_atomically
from docdepth.io.images import (
    decode_image,
    encode_exr,
    encode_image,
    encode_png,
    import_exr,
    read_exr,
)
from docdepth.io.untrusted import (
    ArrayError,
    parse_json,
    read_array,
    read_arrays,
    read_file,
    read_text,
)

FORMATS = {  # from the least to the most exact
    "png": ".png",  # uint16, metres times a scale, 0 = none
    "exr-half": ".exr",  # float16 metres, NaN = none; steps of 31 mm at 50 m, 62 mm at 100 m
    "exr": ".exr",  # float32, channel Y, ZIP compressed
    "tiff": ".tiff",  # float32, compressed
    "npz": ".npz",  # float32, compressed, array "depth"
    "npy": ".npy",  # float32
}
"""Suffix of each format."""

PNG_SCALE = 256.0
"""Default scale of a PNG, steps a metre (KITTI's)."""

DESCRIPTION = "depth.json"
"""File that describes the depth maps of its folder: their scale and more."""

_PNG_MOST = 65535  # steps; the largest uint16
_READ = (*dict.fromkeys(FORMATS.values()), ".tif")


def png_range(scale: float = PNG_SCALE) -> float:
    """Largest depth that a PNG can hold, metres; ``scale`` in steps a metre."""
    return _PNG_MOST / scale


def encode_depth(
    depth: NDArray[np.float32], format: str = "png", scale: float = PNG_SCALE
) -> bytes:
    """A depth map as the content of a file. What the format cannot hold is refused, never clipped.

    Parameters
    ----------
    depth : ndarray of float32, shape (h, w)
        Metres, NaN = none.
    format : str
        One of :data:`FORMATS`.
    scale : float
        Steps of a PNG a metre; other formats ignore it.
    """
    depth = _checked(depth)
    _check_scale(scale)
    if format == "png":
        return _encode_png(depth, scale)
    if format in ("exr", "exr-half"):
        return encode_exr(depth, np.dtype(np.float16 if format == "exr-half" else np.float32))
    if format == "tiff":
        return encode_image(depth, ".tiff")
    if format == "npz":
        return npz_bytes(compressed=True, depth=depth)
    if format != "npy":
        raise InputError(f"unknown depth format {format!r}; there are {', '.join(FORMATS)}")
    stream = io.BytesIO()
    np.save(stream, depth)
    return stream.getvalue()


def write_depth(
    path: Path | str,
    depth: NDArray[np.float32],
    format: str | None = None,
    scale: float = PNG_SCALE,
) -> None:
    """Write a depth map.

    Parameters
    ----------
    path : Path or str
    depth : ndarray of float32, shape (h, w)
        Metres, NaN = none.
    format : str, optional
        One of :data:`FORMATS`; by default that of the suffix.
    scale : float
        Steps of a PNG a metre.

    Raises
    ------
    InputError
        The format is unknown or cannot hold the depth.
    MissingExtraError
        The format needs a package that is not installed.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    named = {".tif": "tiff", **{s: f for f, s in FORMATS.items()}}
    format = format or named.get(suffix)
    if format is None:
        raise InputError(f"{path}: depth is written as {', '.join(_READ)}, not {suffix!r}")
    content = encode_depth(depth, format, scale)
    write_atomically(path, content)


def check_format(format: str, scale: float, max_depth: float) -> None:
    """Check before rendering whether depth maps can be written."""
    if format == "png" and max_depth > png_range(scale):
        most = 2.0 ** np.floor(np.log2(_PNG_MOST / max_depth))
        remedy = f"take `scale={most:g}`, "
        raise InputError(
            f"render.max_depth is {max_depth:g} m, a PNG of metres x {scale:g} holds no more than "
            f"{png_range(scale):.2f} m; {remedy}another `format` (exr, tiff, npy) or a smaller "
            "render.max_depth"
        )
    if format in ("exr", "exr-half"):
        import_exr()


def read_depth(path: Path | str, scale: float | None = None) -> NDArray[np.float32]:
    """Read a depth map of docdepth or of other software.

    Parameters
    ----------
    path : Path or str
        A PNG of uint16 (0 = none), or NPY, NPZ, TIFF or EXR of float metres (NaN or 0 = none).
    scale : float, optional
        Steps of a PNG a metre; by default as :data:`DESCRIPTION` beside it says, else 256.

    Returns
    -------
    ndarray of float32, shape (h, w)
        Metres, NaN = none.

    Raises
    ------
    DatasetError
        The file is missing, damaged or of another kind.
    MissingExtraError
        The format needs a package that is not installed.
    """
    path = Path(path)
    if not path.is_file():
        raise DatasetError(f"{path} is a folder" if path.is_dir() else f"{path} is missing")
    if scale is not None:
        _check_scale(scale)
    suffix = path.suffix.lower()
    if suffix == ".png":
        pixels = _decoded(path)
        if pixels.dtype != np.uint16 or pixels.ndim != 2:
            raise DatasetError(
                f"{path} holds {pixels.dtype} {pixels.shape}; depth is one channel of uint16, "
                "metres times a scale"
            )
        return _metres(pixels, scale or _scale_beside(path))
    if suffix not in _READ:
        raise DatasetError(f"{path}: depth is read from {', '.join(_READ)}, not {suffix!r}")
    if suffix == ".exr":
        depth = read_exr(path)
    else:
        depth = _decoded(path) if suffix in (".tiff", ".tif") else _load(path)
    if depth.ndim != 2 or depth.dtype.kind != "f":
        raise DatasetError(
            f"{path} holds {depth.dtype} {depth.shape}, not float metres of shape (h, w)"
        )
    return np.where(depth == 0, np.float32(np.nan), depth).astype(np.float32)


def maps_in(folder: Path) -> dict[str, Path]:
    """Depth maps of a folder by name; if a map has several formats, the most exact one."""
    found: dict[str, Path] = {}
    for suffix in _READ:
        found |= {path.stem: path for path in folder.glob(f"*{suffix}")}
    return dict(sorted(found.items()))


def described_maps(folder: Path) -> dict[str, tuple[int, float]]:
    """Time [ns] and coverage of each depth map of a folder of a run, by name."""
    path = folder / DESCRIPTION
    try:
        maps = parse_json(read_text(path))["maps"]
        return {name: (int(m["time_ns"]), float(m["coverage"])) for name, m in maps.items()}
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise DamagedFileError(path, repr(error)) from None


def _check_scale(scale: float) -> None:
    if not isinstance(scale, int | float | np.number) or not 0 < scale < np.inf:
        raise InputError(f"scale must be a positive number of steps a metre, got {scale!r}")


def _scale_beside(path: Path) -> float:
    beside = path.with_name(DESCRIPTION)
    if not beside.is_file():
        return PNG_SCALE
    try:
        return float(parse_json(read_text(beside))["scale"]["png"])
    except (KeyError, TypeError, ValueError) as error:
        raise DatasetError(
            f"{beside} does not tell the scale of {path.name} ({error!r}); render again"
        ) from None


def _encode_png(depth: NDArray[np.float32], scale: float) -> bytes:
    with np.errstate(invalid="ignore"):
        deep = depth * scale >= _PNG_MOST + 0.5
    if deep.any():
        row, column = np.argwhere(deep)[0]
        raise InputError(
            f"{np.count_nonzero(deep)} pixels are deeper than the {png_range(scale):.2f} m that a "
            f"PNG of metres x {scale:g} can hold, the first is {depth[row, column]:.2f} m in row "
            f"{row}, column {column}; take another format, a smaller scale or render.max_depth"
        )
    return encode_png(_steps(depth, scale))


def _steps(depth: NDArray[np.float32], scale: float) -> NDArray[np.uint16]:
    # A depth that rounds to 0 would mean none; one step is the nearest that the format has.
    steps = np.maximum(np.rint(depth * scale), 1)
    return np.where(np.isnan(depth), 0, steps).astype(np.uint16)


def as_stored(depth: NDArray[np.float32], format: str, scale: float) -> NDArray[np.float32]:
    """A depth map as it is read again when it was written in a format."""
    if format == "png":
        return _metres(_steps(depth, scale), scale)
    return depth.astype(np.float16).astype(np.float32) if format == "exr-half" else depth


def _decoded(path: Path) -> NDArray[Any]:
    # Decoded from memory: of a missing file OpenCV would complain on stderr.
    pixels = decode_image(read_file(path), cv2.IMREAD_UNCHANGED)
    if pixels is None:
        raise DatasetError(f"{path} is not a readable image; delete it and render again")
    return pixels


def _metres(steps: NDArray[Any], scale: float) -> NDArray[np.float32]:
    depth = steps.astype(np.float32) / np.float32(scale)
    depth[steps == 0] = np.nan
    return np.asarray(depth, np.float32)


def _load(path: Path) -> NDArray[Any]:
    try:
        return read_arrays(path)["depth"] if path.suffix.lower() == ".npz" else read_array(path)
    except KeyError:
        raise DatasetError(f"{path} has no array named 'depth'") from None
    except (ArrayError, OSError) as error:
        raise DatasetError(f"{path} is damaged: {error}") from None


def _checked(depth: NDArray[np.float32]) -> NDArray[np.float32]:
    """The same depths in rows that follow each other, as encoders take them."""
    depth = np.ascontiguousarray(unmasked(depth))
    if depth.dtype.kind == "f":
        with np.errstate(over="ignore"):
            depth = depth.astype(np.float32, copy=False)
    if depth.ndim != 2 or depth.dtype != np.float32 or not depth.size:
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
