"""KITTI's LiDAR, a Velodyne HDL-64E S2: the places and directions of its 64 lasers.

KITTI's point origin lies 12 to 21 cm below the lasers, so rays do not begin at the origin. In every
recorded sweep the points of one laser lie on a cone, z = height + slope * distance from the axis,
to a quarter of a millimetre. The slopes and heights here are fitted to recorded sweeps.
"""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np
from numpy.typing import NDArray

from docdepth.geometry.lidar_frame import SensorRig

# fmt: off
SLOPES = np.array([  # tangent of the elevation; the first 32 lasers are the upper block
    0.03381, 0.02748, 0.02278, 0.01521, 0.01010, 0.00315, -0.00155, -0.00789,
    -0.01402, -0.02097, -0.02608, -0.03201, -0.03855, -0.04448, -0.05020, -0.05654,
    -0.06185, -0.06880, -0.07371, -0.08025, -0.08597, -0.09190, -0.09824, -0.10437,
    -0.11091, -0.11704, -0.12277, -0.12788, -0.13483, -0.14158, -0.14607, -0.15322,
    -0.15885, -0.16866, -0.17745, -0.18481, -0.19360, -0.20525, -0.21465, -0.22283,
    -0.23162, -0.23980, -0.25023, -0.26044, -0.27149, -0.28027, -0.29009, -0.29724,
    -0.30931, -0.31973, -0.33117, -0.34037, -0.35059, -0.35877, -0.36838, -0.37962,
    -0.39023, -0.40272, -0.41294, -0.42152, -0.43113, -0.44460, -0.45586, -0.46628,
])
# fmt: on
# The lasers of a block meet in one point each: its height and its distance behind the axis, metres.
_UPPER_HEIGHT, _UPPER_BEHIND = 0.2065, 0.0603
_LOWER_HEIGHT, _LOWER_BEHIND = 0.1303, 0.0316
HEIGHTS = np.where(
    np.arange(64) < 32,
    _UPPER_HEIGHT + _UPPER_BEHIND * SLOPES,
    _LOWER_HEIGHT + _LOWER_BEHIND * SLOPES,
)
"""Height of each laser above the origin on the axis, metres."""
LATERAL_OFFSETS = np.where(np.arange(64) % 2, 0.026, -0.026)
"""Distance of each laser to the left of the axis, seen in the direction of its ray, metres."""
BEAM_WIDTH_DEG = 0.2
"""Things are measured 1.5 mrad too wide on each side, against the edges of images (drive 0013)."""
ELEVATION_ERROR = np.radians(0.205)
"""By how much the lasers point higher than KITTI's calibration says [rad].

KISS-ICP and CT-ICP correct it, too (IMLS-SLAM: 0.22 degrees). By the data sheet the upper block is
0.22 degrees higher than these slopes. Flat road looks like a bowl of 0.21 (drive 0013) and 0.20
degrees (9001): where it is seen from 30 m, it lies 11 cm too low. Surfaces that were seen twenty
sweeps apart agree best with 0.15 (0013, 0001)."""

_TURN = 1e8  # nanoseconds
_T_LIDAR_LASER = np.repeat(np.eye(4)[None], 64, axis=0)
_T_LIDAR_LASER[:, 2, 3] = HEIGHTS
_TOLERANCE = 3e-4  # of a slope; neighbouring lasers differ by twenty times that
_FEWEST_POINTS = 100  # straight ahead, to tell the LiDAR by
_SHARE = 0.6  # of these points that have to lie on a cone; of other LiDARs' few do
_LEAST_AHEAD = 2.0  # metres; nearer points may be of the vehicle
_AHEAD = 0.1  # |y| / x of points straight ahead


def is_kitti_lidar(sweeps: Iterable[NDArray[np.float32]]) -> bool:
    """Whether a drive was recorded by KITTI's LiDAR: its points lie on these 64 cones.

    The test takes points straight ahead, which motion compensation does not move, of the first
    sweep with enough of them.
    """
    for points in sweeps:
        with np.errstate(all="ignore"):  # what is not finite lies nowhere
            beside = np.abs(points[:, 1]) < _AHEAD * points[:, 0]
        ahead = points[(points[:, 0] > _LEAST_AHEAD) & beside]
        if len(ahead) >= _FEWEST_POINTS:
            laser, slope = _lasers(ahead, SLOPES)
            return float((np.abs(slope - SLOPES[laser]) < _TOLERANCE).mean()) > _SHARE
    return False


def raised(points: NDArray[np.float32], angle: float) -> NDArray[np.float32]:
    """Points (N, 3) whose elevation is higher by an angle [rad], at the range they have."""
    x, y, z = points.T
    cos, sin = np.float32(np.cos(angle)), np.float32(np.sin(angle))
    distance = np.sqrt(x * x + y * y)
    nearer = cos - sin * z / np.maximum(distance, np.float32(1e-6))
    return np.stack([x * nearer, y * nearer, cos * z + sin * distance], axis=1)


def seen_raised(T_camera_lidar: NDArray[np.float64], angle: float) -> NDArray[np.float64]:
    """``T_camera_lidar`` (4, 4) that shows raised points where the camera showed them before.

    Exact in the direction in which the camera looks. A calibration that was made with points as
    they were recorded contains their error.
    """
    forward = T_camera_lidar[2, :3]
    axis = np.array([-forward[1], forward[0], 0.0])
    axis *= angle / max(float(np.linalg.norm(axis)), 1e-9)
    T = np.eye(4)
    T[:3, :3] = cv2.Rodrigues(axis)[0]
    return T_camera_lidar @ T


def sensor_rig(points: NDArray[np.float32], raised_by: float = 0.0) -> SensorRig:
    """The laser of each point (N, 3) of a sweep of KITTI's LiDAR, and the places of all lasers.

    Points may be :func:`raised` by an angle [rad].
    """
    lasers = _lasers(points, np.tan(np.arctan(SLOPES) + raised_by))[0]
    return SensorRig(lasers, _T_LIDAR_LASER, LATERAL_OFFSETS, np.zeros(64, np.uint8))


def azimuth_relative_time(
    points: NDArray[np.float32], period: int | None = None
) -> NDArray[np.float32]:
    """When each point was measured by a LiDAR that turns clockwise and faces forward at its stamp.

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)
    period : int, optional
        Nanoseconds from stamp to stamp. KITTI's LiDAR turns ten times a second: where sweeps were
        left out, it turned several times between two.

    Returns
    -------
    ndarray of float32, shape (N,)
        Shares of the period after the stamp: -0.5 to 0.5, or less if it is of several turns.
    """
    turns = max(round((period or 0) / _TURN), 1)
    return np.arctan2(points[:, 1], points[:, 0]) * np.float32(-0.5 / np.pi / turns)


def _lasers(
    points: NDArray[np.float32], slopes: NDArray[np.float64]
) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """The laser whose cone is nearest to each point, and the slope of the ray to the point."""
    between = (slopes[1:] + slopes[:-1]) / 2
    distance, z = np.hypot(points[:, 0], points[:, 1]), points[:, 2]
    with np.errstate(invalid="ignore", divide="ignore"):
        upper = (z - _UPPER_HEIGHT) / (distance + _UPPER_BEHIND)
        lower = (z - _LOWER_HEIGHT) / (distance + _LOWER_BEHIND)
    slope = np.where(upper > between[31], upper, lower).astype(np.float32)
    return np.searchsorted(-between.astype("f4"), -slope).astype(np.uint8), slope
