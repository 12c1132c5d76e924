"""LiDARs whose sweeps are files of rows of fixed fields, named by their stamps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.base import LidarStream
from docdepth.datasets.cloud import Cloud, SweepFiles, cloud_from_fields
from docdepth.datasets.files import unreadable
from docdepth.datasets.kitti_files import in_order
from docdepth.datasets.times import times_of_names
from docdepth.errors import DatasetError

NANOSECOND, MICROSECOND = 1, 1000

_COPY = "copy the sweep again"


def packed(**fields: str) -> np.dtype[Any]:
    """Rows of these fields without gaps, little endian: ``packed(x="f4", ring="u2")``."""
    return np.dtype([(name, f"<{kind}") for name, kind in fields.items()])


@dataclass(frozen=True)
class StampedLidar(SweepFiles):
    """Sweeps of rows of fixed fields.

    Attributes
    ----------
    rows : dtype
        Of a row, see :func:`packed`.
    cloud : callable
        ``cloud(rows, where)`` makes a cloud of them; a function of a module, so that datasets can
        be sent to other processes.
    """

    rows: np.dtype[Any]
    cloud: Callable[[NDArray[Any], str], Cloud] = cloud_from_fields

    def read(self, index: int) -> Cloud:
        """Own sweep ``index``."""
        file = self.sweeps[index]
        where = f"{file} (frame {index})"
        try:
            content = file.read_bytes()
        except OSError as error:
            reason = str(unreadable(file, _COPY, error))
            raise DatasetError(reason.replace(str(file), where, 1)) from None
        if not content or len(content) % self.rows.itemsize:
            raise DatasetError(
                f"{where} has {len(content)} bytes, which is not a multiple of "
                f"{self.rows.itemsize} ({' '.join(self.rows.names or ())}): it is truncated or of "
                f"another LiDAR; {_COPY}"
            )
        return self.cloud(np.frombuffer(content, self.rows), where)


def stamped_lidar(
    name: str,
    folder: Path,
    unit: int,
    rows: np.dtype[Any],
    cloud: Callable[[NDArray[Any], str], Cloud] = cloud_from_fields,
) -> StampedLidar:
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
    return StampedLidar(LidarStream(name, times, [s.stem for s in sweeps]), sweeps, rows, cloud)
