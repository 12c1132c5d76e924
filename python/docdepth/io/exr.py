"""Depth maps as OpenEXR images: one channel of floats."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import DatasetError, MissingExtraError, RunError


def import_exr() -> Any:
    """The module OpenEXR.

    Raises
    ------
    MissingExtraError
        It is not installed.
    """
    # OpenCV's wheels read EXR only if a variable is set before the import, or not at all.
    try:
        import OpenEXR
    except ImportError:
        raise MissingExtraError('EXR needs a package: pip install "docdepth[exr]"') from None
    return OpenEXR


def encode_exr(depth: NDArray[np.float32], dtype: np.dtype[Any]) -> bytes:
    """A depth map, (h, w) metres, as an EXR file with a channel Y of this type.

    Raises
    ------
    MissingExtraError
        OpenEXR is not installed.
    RunError
        The folder for temporary files cannot be written.
    """
    OpenEXR = import_exr()
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    # OpenCV writes one channel Y and reads no other.
    try:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "depth.exr"
            OpenEXR.File(header, {"Y": depth.astype(dtype)}).write(str(path))
            return path.read_bytes()
    except (OSError, RuntimeError) as error:  # OpenEXR writes to files only
        raise RunError(
            f"cannot write an EXR to {tempfile.gettempdir()}: {error}; make room there or set "
            "TMPDIR"
        ) from None


def read_exr(path: Path) -> NDArray[Any]:
    """The channel Y or Z of an EXR file, or its only one.

    Raises
    ------
    MissingExtraError
        OpenEXR is not installed.
    DatasetError
        The file is damaged or has no such channel.
    """
    OpenEXR = import_exr()
    try:
        with OpenEXR.File(str(path)) as image:
            channels = {name: c.pixels.copy() for name, c in image.channels().items()}
    except (RuntimeError, ValueError) as error:
        raise DatasetError(f"{path} is damaged: {error}; delete it and render again") from None
    for name in ("Y", "Z", *(channels if len(channels) == 1 else ())):
        if name in channels:
            return np.asarray(channels[name])
    raise DatasetError(f"{path} has the channels {', '.join(channels)}; depth is one, Y or Z")
