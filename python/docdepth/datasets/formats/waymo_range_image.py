"""Waymo's range images: a row for each laser, a column for each azimuth in the vehicle's frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from docdepth.geometry.se3 import inverse, transform_points


@dataclass(frozen=True)
class Beams:
    """The rays of a LiDAR."""

    T_vehicle_sensor: NDArray[np.float64]  # (4, 4)
    # (k,): Radians of each laser, from the lowest; or the least and the greatest, between which
    # lasers are spread evenly
    inclinations: NDArray[np.float64]
    even: bool  # lasers are spread evenly

    def rows(self, height: int) -> NDArray[np.float64]:
        """Radians of each row of an image, from the highest."""
        if self.even:
            low, high = self.inclinations
            return np.asarray(low + (high - low) * (np.arange(height) + 0.5) / height)[::-1]
        if len(self.inclinations) != height:
            raise ValueError(
                f"{height} rows for {len(self.inclinations)} lasers in lidar_calibration; both "
                "must be of this segment"
            )
        return self.inclinations[::-1]


def points_in_vehicle(ranges: NDArray[np.float32], beams: Beams) -> NDArray[np.float64]:
    """Points (H, W, 3) in the frame of the vehicle when each pixel was measured; NaN without one.

    Columns run clockwise from behind the vehicle, whatever way the LiDAR is turned on it. Ranges
    (H, W) are metres; not positive where nothing returned.
    """
    height, width = ranges.shape
    T = beams.T_vehicle_sensor
    yaw = np.arctan2(T[1, 0], T[0, 0])
    azimuth = np.pi * (1 - 2 * (np.arange(width) + 0.5) / width) - yaw
    inclination = beams.rows(height)[:, None]
    distance = np.where(ranges > 0, ranges, np.nan).astype(np.float64)
    level = distance * np.cos(inclination)
    own = np.stack(
        [level * np.cos(azimuth), level * np.sin(azimuth), distance * np.sin(inclination)], axis=-1
    )
    return transform_points(T, own)


def compensated(
    points: NDArray[np.float64],
    pixel_poses: NDArray[np.float32],
    T_world_vehicle: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Points (H, W, 3) in the frame of the vehicle at the pose of the frame, ``T_world_vehicle``.

    They come in the frame of the vehicle at its pose when the pixel was measured. That is
    ``pixel_poses`` (H, W, 6): roll, pitch and yaw in radians, x, y and z in metres. All zeros are
    no pose: such points become NaN.
    """
    poses = pixel_poses.astype(np.float64)
    (sr, sp, sy), (cr, cp, cy) = (np.moveaxis(f(poses[..., :3]), -1, 0) for f in (np.sin, np.cos))
    x, y, z = np.moveaxis(points, -1, 0)
    # Rz(yaw) Ry(pitch) Rx(roll)
    y, z = cr * y - sr * z, sr * y + cr * z
    x, z = cp * x + sp * z, cp * z - sp * x
    x, y = cy * x - sy * y, sy * x + cy * y
    world = np.stack([x, y, z], axis=-1) + poses[..., 3:]
    world[(pixel_poses == 0).all(axis=-1)] = np.nan
    T = inverse(T_world_vehicle)
    return transform_points(T, world)
