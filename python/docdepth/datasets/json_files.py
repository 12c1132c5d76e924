"""JSON of data sets: tables and poses, with errors that name the file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.files import read_bytes
from docdepth.errors import DatasetError, InputError
from docdepth.geometry.se3 import poses_from, quaternion_to_matrix
from docdepth.io.yaml_json import parse_json


def read_json(file: Path, remedy: str) -> Any:
    """The content of a JSON file.

    Raises
    ------
    DatasetError
        The file cannot be read, or is not JSON.
    """
    try:
        return parse_json(read_bytes(file, remedy))
    except ValueError as error:
        raise DatasetError(f"{file} is not whole JSON ({error}); {remedy}") from None


def pose_of(
    quaternion: Sequence[float], translation: Sequence[float], where: str
) -> NDArray[np.float64]:
    """A pose (4, 4) of a quaternion w x y z and a translation in metres.

    Raises
    ------
    DatasetError
        They are no pose.
    """
    try:
        w, x, y, z = (float(value) for value in quaternion)
        position = [float(value) for value in translation]
        if not np.isfinite(position).all():
            raise ValueError(f"its translation is {position}")
        return poses_from([quaternion_to_matrix([x, y, z, w])], [position])[0]
    except (InputError, ValueError, TypeError) as error:
        raise DatasetError(f"{where} is no pose ({error}); restore the file") from None
