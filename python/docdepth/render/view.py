"""What a depth map shows: a camera, where it is, and when."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import InputError
from docdepth.geometry.camera import Camera
from docdepth.geometry.se3 import inverse
from docdepth.geometry.trajectory import Trajectory


class View(NamedTuple):
    """A camera at the time of an image.

    Attributes
    ----------
    camera : Camera
    T_camera_world : ndarray of float64, shape (4, 4)
    time : int
        Nanoseconds.
    """

    camera: Camera
    T_camera_world: NDArray[np.float64]
    time: int

    @classmethod
    def at(
        cls, camera: Camera, T_camera_lidar: NDArray[np.float64], trajectory: Trajectory, time: int
    ) -> View:
        """The view of a camera that is mounted with the LiDAR, at ``time`` [ns] (paper V-A).

        Raises
        ------
        InputError
            ``time`` lies outside the trajectory.
        """
        if not trajectory.covers(time):
            first, last = trajectory.times[[0, -1]]
            raise InputError(
                f"{time} ns lies outside the trajectory, which goes from {first} to {last} ns; "
                "poses are not extrapolated, so leave this image out"
            )
        return cls(camera, T_camera_lidar @ inverse(trajectory.interpolate(time)[0]), int(time))
