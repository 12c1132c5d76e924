"""``sensors.npz`` of a run folder: where the LiDARs or their lasers sit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from docdepth.errors import DamagedFileError
from docdepth.geometry.sensor_rig import SensorRig
from docdepth.io.atomic import npz_bytes
from docdepth.io.npy import ArrayError, read_arrays

_NAMES = ("T_lidar_sensor", "lateral_offset", "lidar_id")


def sensors_bytes(sensor_rig: SensorRig) -> bytes:
    """The content of the file."""
    return npz_bytes(**{name: getattr(sensor_rig, name) for name in _NAMES})


def read_sensors(path: Path) -> dict[str, NDArray[Any]]:
    """Arguments of :class:`SensorRig` that all frames share.

    Raises
    ------
    DamagedFileError
        The file is missing or damaged.
    """
    try:
        arrays = read_arrays(path)
        return {name: arrays[name] for name in _NAMES}
    except FileNotFoundError:
        raise DamagedFileError(path, "") from None
    except (OSError, ArrayError, KeyError) as error:
        raise DamagedFileError(path, str(error)) from None
