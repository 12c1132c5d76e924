"""The pinhole camera of a depth map, and what it shows from where."""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import blake2b
from operator import index
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from docdepth.errors import CalibrationError, InputError
from docdepth.geometry.points import ShortRepr, as_array, float_array
from docdepth.geometry.se3 import check_rigid, if_mirrored, inverse
from docdepth.geometry.trajectory import Trajectory

NEAREST = 0.1
"""Points nearer to the plane of a camera are not in front of it [m]."""

MOST_METRES = 100.0
"""A sensor is no farther from the origin of its frame; more is a mistake of units."""

_WIDEST = 1 << 20  # pixels of a row or column; OpenCV reads no larger image
_FOCAL = 1e-6, 1e6
"""Between which focal lengths lie [pixel]."""


@dataclass(frozen=True, eq=False, repr=False)
class Camera(ShortRepr):
    """A rectified pinhole camera (OpenCV: x right, y down, z forward).

    Attributes
    ----------
    K : ndarray of float64, shape (3, 3)
        Intrinsic matrix in pixels; integer pixel coordinates are pixel centres. Read-only.
    width : int
        Width of the image in pixels.
    height : int
        Height of the image in pixels.
    mask : ndarray of bool, shape (height, width), optional
        True where the image shows the world; of numbers, such as those of an image, all but 0. The
        other pixels, such as those of the own bonnet, get no depth.

    Raises
    ------
    CalibrationError
        K is not a pinhole matrix without skew, or K or the mask does not fit the size.
    """

    K: NDArray[np.float64]
    width: int
    height: int
    mask: NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        try:
            K, width, height = float_array("K", self.K), index(self.width), index(self.height)
        except InputError as error:
            raise CalibrationError(f"{error}, 3x3") from None
        except TypeError:
            raise CalibrationError(
                f"width and height must be integers, got {self.width!r} and {self.height!r}"
            ) from None
        if K.shape != (3, 3) or not np.isfinite(K).all():
            raise CalibrationError(f"K must be a 3x3 pinhole matrix, got {K.tolist()}")
        if K[0, 0] <= 0 or K[1, 1] <= 0:
            raise CalibrationError(
                f"the focal lengths in K must be above 0, got {K[0, 0]:g} and {K[1, 1]:g}; where "
                "images are mirrored, flip them"
            )
        if not (_FOCAL[0] < K[[0, 1], [0, 1]]).all() or not (K[[0, 1], [0, 1]] < _FOCAL[1]).all():
            raise CalibrationError(
                f"the focal lengths {K[0, 0]:g} and {K[1, 1]:g} are none in pixels, which lie "
                f"between {_FOCAL[0]:g} and {_FOCAL[1]:g}"
            )
        if (K.T[2] == (0, 0, 1)).all() and K[2, 0] > 0:
            raise CalibrationError(
                f"K is transposed: {K.tolist()}; write fx 0 cx / 0 fy cy / 0 0 1"
            )
        if K[0, 1] or K[1, 0] or (K[2] != (0, 0, 1)).any():
            raise CalibrationError(
                f"K must be fx 0 cx / 0 fy cy / 0 0 1, got {K.tolist()}; rectify images with skew"
            )
        if width < 1 or height < 1:
            raise CalibrationError(f"image size {width} x {height} is empty")
        if max(width, height) > _WIDEST:
            raise CalibrationError(f"image size {width} x {height} is that of no image")
        if not (0 <= K[0, 2] < width and 0 <= K[1, 2] < height):
            raise CalibrationError(
                f"the principal point ({K[0, 2]:.1f}, {K[1, 2]:.1f}) lies outside the "
                f"{width} x {height} image: the size does not fit K"
            )
        mask = None if self.mask is None else as_array(self.mask) != 0
        if mask is not None and mask.shape != (height, width):
            raise CalibrationError(
                f"the mask has {' x '.join(map(str, mask.shape[::-1]))} pixels, the image "
                f"{width} x {height}"
            )
        K.setflags(write=False)  # all images of a run have the same one
        for name, value in {"K": K, "width": width, "height": height, "mask": mask}.items():
            object.__setattr__(self, name, value)

    def as_dict(self) -> dict[str, object]:
        """Plain values that tell this camera from others; of a mask a hash."""
        described: dict[str, object] = {"K": self.K.tolist(), "size": [self.width, self.height]}
        if self.mask is not None:
            described["mask"] = blake2b(np.packbits(self.mask).tobytes(), digest_size=8).hexdigest()
        return described


def camera_of(K: ArrayLike, size: tuple[int, int], where: str) -> Camera:
    """The camera that ``where`` tells of, which errors name."""
    try:
        return Camera(np.asarray(K, np.float64), *size)
    except CalibrationError as error:
        raise CalibrationError(f"{where}: {error}") from None


def checked_place(where: str, T: ArrayLike, remedy: str = "") -> NDArray[np.float64]:
    """The place of a camera or LiDAR, a rigid transform (4, 4) that ``where`` tells of."""
    matrix = float_array(where, T)
    if matrix.shape != (4, 4):
        raise CalibrationError(f"{where} must be a 4x4 matrix; its shape is {matrix.shape}")
    try:
        check_rigid(matrix[None])
    except InputError:
        raise CalibrationError(
            f"{where} must be a 4x4 rotation and translation in metres{if_mirrored(matrix)}; "
            f"{remedy or f'got {matrix.tolist()}'}"
        ) from None
    return matrix


def checked_mount(where: str, T: ArrayLike) -> NDArray[np.float64]:
    """As :func:`checked_place`, of a sensor on a vehicle: a virtual camera may be anywhere."""
    matrix = checked_place(where, T)
    if np.linalg.norm(matrix[:3, 3]) > MOST_METRES:
        raise CalibrationError(f"{where} moves by more than {MOST_METRES:g} m; is it in metres?")
    return matrix


def pixels_in_image(
    points: NDArray[np.floating[Any]], camera: Camera
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Rows of the points (N, 3) in the camera's frame that its image shows, and their u and v."""
    with np.errstate(invalid="ignore"):
        rows = np.flatnonzero(points[:, 2] > NEAREST)
    pixels = np.rint((points[rows] @ camera.K.T)[:, :2] / points[rows, 2:]).astype(np.int64)
    inside = ((pixels >= 0) & (pixels < (camera.width, camera.height))).all(axis=1)
    u, v = pixels[inside].T
    return rows[inside], u, v


def points_of(
    K: NDArray[np.float64], depth: NDArray[np.float32], pixels: NDArray[np.int64]
) -> NDArray[np.float64]:
    """The points that depth gives some pixels, (k, 3) in the frame of the camera [m].

    Parameters
    ----------
    K : ndarray of float64, shape (3, 3)
    depth : ndarray of float32, shape (h, w)
        Along the optical axis [m].
    pixels : ndarray of int64, shape (k,)
        Of the flattened image.
    """
    v, u = np.divmod(pixels, depth.shape[1])
    z = depth.ravel()[pixels].astype(np.float64)
    y = (v - K[1, 2]) / K[1, 1]
    x = (u - K[0, 2] - K[0, 1] * y) / K[0, 0]
    return np.column_stack([x * z, y * z, z])


def below_horizon(camera: Camera, T_camera_lidar: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Pixels whose ray leads down in the frame of the LiDAR, whose z is up, (h, w).

    The share of these with depth tells more than that of all: no LiDAR measures the sky.
    """
    v, u = np.mgrid[: camera.height, : camera.width]
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(camera.K).T
    return np.asarray(rays @ T_camera_lidar[:3, 2] < 0)


class View(NamedTuple):
    """A camera at the time of an image."""

    camera: Camera
    T_camera_world: NDArray[np.float64]  # (4, 4)
    time: int  # nanoseconds

    @classmethod
    def at(
        cls, camera: Camera, T_camera_lidar: NDArray[np.float64], trajectory: Trajectory, time: int
    ) -> View:
        """The view of a camera that is mounted with the LiDAR, at ``time`` [ns] (paper V-A)."""
        if not trajectory.covers(time):
            first, last = trajectory.times[[0, -1]]
            raise InputError(
                f"{time} ns lies outside the trajectory, which goes from {first} to {last} ns; "
                "poses are not extrapolated, so leave this image out"
            )
        return cls(camera, T_camera_lidar @ inverse(trajectory.interpolate(time)[0]), int(time))
