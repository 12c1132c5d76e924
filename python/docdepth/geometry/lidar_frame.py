"""A deskewed sweep: what odometry hands on to ground, dynamics and rendering."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import InputError
from docdepth.geometry.checks import ShortRepr
from docdepth.geometry.points import GROUND, STATIC
from docdepth.geometry.sensor_rig import SensorRig


@dataclass(frozen=True, eq=False, repr=False)
class LidarFrame(ShortRepr):
    """One sweep, deskewed to its stamp.

    Attributes
    ----------
    points : ndarray of float32, shape (N, 3)
        LiDAR frame at the sweep's stamp, metres. Those of a run folder are usable returns only.
    index : ndarray of uint32, shape (N,)
        Row of each point in the input sweep.
    name : str
        Stem of the input file.
    input_points : int
        Rows of the input sweep.
    time_offset : ndarray of float32, shape (N,), optional
        When each point was measured, seconds after the sweep's stamp.
    sensor_rig : SensorRig, optional
        Where each point was measured from; the origin if absent.
    classid : ndarray of uint16, shape (N,), optional
        Below 50 ground, 50 to 99 static, 100 and above dynamic.
    instance : ndarray of uint16, shape (N,), optional
        Track of each dynamic point, 0 if it is of none.
    votes_static, votes_dynamic : ndarray of uint16, shape (N,), optional
    """

    points: NDArray[np.float32]
    index: NDArray[np.uint32]
    name: str
    input_points: int
    time_offset: NDArray[np.float32] | None = None
    sensor_rig: SensorRig | None = None
    classid: NDArray[np.uint16] | None = None
    instance: NDArray[np.uint16] | None = None
    votes_static: NDArray[np.uint16] | None = None
    votes_dynamic: NDArray[np.uint16] | None = None

    def __len__(self) -> int:
        return len(self.points)

    @property
    def classes(self) -> NDArray[np.uint16]:
        """``classid``, which must be there.

        Raises
        ------
        InputError
            There are no classes.
        """
        if self.classid is None:
            raise InputError(f"sweep {self.name} has no classes")
        return self.classid

    @property
    def ground(self) -> NDArray[np.bool_]:
        """Which points are ground, by :attr:`classes`, (N,)."""
        return np.asarray(self.classes < STATIC)

    def with_ground(self, ground: NDArray[np.bool_]) -> LidarFrame:
        """The frame with the classes ground and static alone."""
        classid = np.where(ground, np.uint16(GROUND), np.uint16(STATIC))
        return replace(self, classid=classid, instance=None)

    def select(self, rows: NDArray[np.bool_]) -> LidarFrame:
        """The frame with some of its points."""
        names = [name for name, values in vars(self).items() if isinstance(values, np.ndarray)]
        columns = {name: getattr(self, name)[rows] for name in names}
        rig = self.sensor_rig
        return replace(self, **columns, sensor_rig=None if rig is None else rig.select(rows))
