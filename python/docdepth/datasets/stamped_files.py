"""LiDARs whose sweeps are files of rows of fixed fields, named by their stamps."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.base import LidarStream
from docdepth.datasets.cloud import Cloud, FileLidar, cloud_from_fields, read_rows
from docdepth.datasets.kitti_files import in_order
from docdepth.datasets.times import times_of_names
from docdepth.errors import DatasetError

NANOSECOND, MICROSECOND = 1, 1000


def stamped_lidar(
    name: str,
    folder: Path,
    unit: int,
    rows: np.dtype[Any],
    cloud: Callable[[NDArray[Any], str], Cloud] = cloud_from_fields,
) -> FileLidar:
    """The LiDAR of a folder of ``STAMP.bin``, whose stamps count ``unit`` nanoseconds.

    Raises
    ------
    DatasetError
        There is no sweep, or a name is no stamp.
    """
    sweeps = in_order(folder.glob("*.bin"))
    if not sweeps:
        raise DatasetError(f"{folder} holds no sweeps (*.bin); unpack them there")
    times = times_of_names(sweeps, unit, "names of sweeps are stamps; remove what is none")
    stream = LidarStream(name, times, [sweep.stem for sweep in sweeps])
    return FileLidar(stream, sweeps, partial(read_stamped, rows=rows, cloud=cloud))


def read_stamped(
    file: Path,
    where: str,
    rows: np.dtype[Any],
    cloud: Callable[[NDArray[Any], str], Cloud],
) -> Cloud:
    """A cloud of the rows of a file."""
    return cloud(read_rows(file, where, rows, "copy the sweep again"), where)
