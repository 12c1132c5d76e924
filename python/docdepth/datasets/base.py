"""The interface of a recording: :class:`Dataset` with its LiDARs, sweeps and cameras.

Sweeps are read one at a time and not kept. They hold all rows of the file, unusable points too;
:func:`usable_points` tells these.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, Protocol, TypeVar, overload, runtime_checkable

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from docdepth.datasets.files import ImageSource, read_image_of
from docdepth.errors import CalibrationError, DatasetError, InputError
from docdepth.geometry.camera import Camera, checked_mount, checked_place
from docdepth.geometry.lidar_frame import SensorRig
from docdepth.geometry.points import ShortRepr, as_integer, check_points, float_array, nanoseconds

LensModel = Literal["pinhole", "fisheye"]

_Item = TypeVar("_Item")

_LONGEST_NAME = 100  # characters of a camera's name; file systems allow 255 bytes


@dataclass(frozen=True, eq=False, repr=False)
class Sweep(ShortRepr):
    """One sweep of the LiDAR: a revolution, or the frame of a sensor that does not turn.

    Attributes
    ----------
    points : ndarray of float32, shape (N, 3)
        LiDAR frame (x forward, y left, z up), metres, every row of the input. Not copied.
    name : str
        Stem of the input file; labels are written under it.
    time : int
        Nanoseconds; the pose of the sweep holds at this time.
    intensity : ndarray of float32, shape (N,), optional
    relative_time : ndarray of float32, shape (N,), optional
        When each point was measured, as a share of the sweep's duration after ``time`` (negative:
        before it). None if unknown.
    sensor_rig : SensorRig, optional
        Which LiDAR or laser measured each point, and where it sits. None if all rays begin at the
        origin.
    motion_compensated : bool
        Points are in the LiDAR frame at ``time``. Otherwise each point is in the LiDAR frame at
        its own time. Moving objects are where they were when they were measured either way.
    ring : ndarray of uint16, shape (N,), optional
        The laser of each point, as the recording numbers it.
    compensated_to : ndarray of float32, shape (N,), optional
        Of a motion compensated sweep of several LiDARs with stamps of their own: the stamp of each
        point, as a share of the sweep's duration after ``time``. None if all are ``time``.

    Raises
    ------
    InputError
        Points are not float32 of shape (N, 3), or another array is not of N points.
    """

    points: NDArray[np.float32]
    name: str
    time: int
    intensity: NDArray[np.float32] | None = None
    relative_time: NDArray[np.float32] | None = None
    sensor_rig: SensorRig | None = None
    motion_compensated: bool = False
    ring: NDArray[np.uint16] | None = None
    compensated_to: NDArray[np.float32] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", check_points(self.points))
        time = as_integer(self.time, "the time of a sweep is an integer, nanoseconds")
        object.__setattr__(self, "time", time)
        rig = self.sensor_rig
        if rig is not None and not isinstance(rig, SensorRig):
            raise InputError(f"sensor_rig must be a SensorRig, not {type(rig).__name__}")
        of_points = {"sensor_rig.index": None if rig is None else rig.index}
        for name in ("intensity", "relative_time", "ring", "compensated_to"):
            of_points[name] = getattr(self, name)
        for name, values in of_points.items():
            if values is not None and np.shape(values) != self.points.shape[:1]:
                raise InputError(
                    f"{name} {np.shape(values)} must have shape ({len(self.points)},), one a point"
                )
        if self.relative_time is not None:
            object.__setattr__(self, "relative_time", np.asarray(self.relative_time, np.float32))


@dataclass(frozen=True, eq=False, repr=False)
class LidarStream(ShortRepr):
    """One LiDAR of the vehicle: when it measured, and where it sits.

    Attributes
    ----------
    name : str
    times : ndarray of int64, shape (m,)
        Nanoseconds of each of its own sweeps, strictly increasing.
    names : list of str
        Of its own sweeps.
    T_lidar_sensor : ndarray of float64, shape (4, 4)
        Takes its points to the LiDAR frame of the recording; identity for the first LiDAR.
    """

    name: str
    times: NDArray[np.int64]
    names: list[str]
    T_lidar_sensor: NDArray[np.float64] = field(default_factory=lambda: np.eye(4))

    def __post_init__(self) -> None:
        times = _times_of(f"LiDAR {self.name}", self.times, self.names)
        object.__setattr__(self, "times", times)
        T = checked_mount(f"LiDAR {self.name}: T_lidar_sensor", self.T_lidar_sensor)
        object.__setattr__(self, "T_lidar_sensor", T)


def _times_of(whose: str, times: ArrayLike, names: Sequence[str]) -> NDArray[np.int64]:
    stamps = nanoseconds(f"{whose}: times", times)
    if stamps.shape != (len(names),):
        raise InputError(f"{whose}: {len(names)} names need as many times, got {stamps.shape}")
    return stamps


def check_name(name: str) -> None:
    """Refuse a name of a camera that cannot be that of a folder, or leads out of it."""
    is_name = name.isprintable() and 0 < len(name) <= _LONGEST_NAME and not set(name) & set("/\\")
    if not is_name or name in (".", "..", "all", "none"):
        raise CalibrationError(
            f"a camera cannot be called {name[:_LONGEST_NAME]!r}: results lie in folders of this "
            "name; use letters and digits"
        )


def check_distortion(name: str, d: NDArray[np.float64] | None, model: LensModel) -> None:
    """Refuse the distortion of a camera ``name`` that no lens has."""
    if model == "fisheye" and (d is None or d.shape != (4,)):
        raise CalibrationError(f"{name}: the distortion of a fisheye is k1 k2 k3 k4, four numbers")
    if d is not None and (
        d.shape not in [(n,) for n in (4, 5, 8, 12, 14)] or not np.isfinite(d).all()
    ):
        raise CalibrationError(
            f"{name}: distortion must be 4, 5, 8, 12 or 14 numbers k1 k2 p1 p2 [k3 ...], "
            f"got {d.tolist()}"
        )


@dataclass(frozen=True, eq=False, repr=False)
class CameraStream(ShortRepr):
    """One camera of the vehicle: calibration, time of each image, and the images if available.

    Attributes
    ----------
    name : str
    camera : Camera
        The rectified camera.
    T_camera_lidar : ndarray of float64, shape (4, 4)
        Transforms LiDAR points to the camera.
    times : ndarray of int64, shape (m,)
        Time of each image in nanoseconds, on the clock of the sweeps.
    names : list of str
        File names of the images without suffix; depth maps get the same names.
    images : sequence of Path, str or StoredImage, optional
        Files, or images within files. Empty when the images are not on disk.
    distortion : ndarray of float64, shape (4,), (5,), (8,), (12,) or (14,), optional
        Lens distortion of the images in OpenCV's order: k1 k2 p1 p2 [k3 ...], of a fisheye
        k1 k2 k3 k4. Depth maps belong to the rectified camera with the same K.
    model : {"pinhole", "fisheye"}
        Model of the lens distortion: Brown's as in ``cv2.undistort``, or that of ``cv2.fisheye``.

    Raises
    ------
    CalibrationError
        ``camera`` is no Camera, ``T_camera_lidar`` is not rigid, or no lens has the distortion.
    InputError
        Times, names and images differ in number, or times are no integers.
    """

    name: str
    camera: Camera
    T_camera_lidar: NDArray[np.float64]
    times: NDArray[np.int64]
    names: list[str]
    images: Sequence[ImageSource] = field(default_factory=list)
    distortion: NDArray[np.float64] | None = None
    model: LensModel = "pinhole"

    def __post_init__(self) -> None:
        check_name(self.name)
        whose = f"camera {self.name}"
        if not isinstance(self.camera, Camera):
            raise CalibrationError(
                f"{whose}: camera must be a docdepth.Camera(K, width, height), "
                f"not {type(self.camera).__name__}"
            )
        T = checked_place(f"{whose}: T_camera_lidar", self.T_camera_lidar)
        object.__setattr__(self, "T_camera_lidar", T)
        object.__setattr__(self, "times", _times_of(whose, self.times, self.names))
        if len(self.images) not in (0, len(self.names)):
            raise InputError(f"{whose}: {len(self.names)} names and {len(self.images)} images")
        if self.distortion is not None:
            distortion = float_array(f"{whose}: distortion", self.distortion)
            object.__setattr__(self, "distortion", distortion)
        check_distortion(self.name, self.distortion, self.model)

    @property
    def distortion_coefficients(self) -> list[float]:
        """``distortion`` as numbers; five zeros where there is none."""
        return [0.0] * 5 if self.distortion is None else self.distortion.tolist()

    def image(self, index: int) -> NDArray[np.uint8] | None:
        """Read an image as it was taken: BGR of shape (height, width, 3); None if not on disk.

        Raises
        ------
        DatasetError
            The file cannot be read, or its size differs from that of the camera.
        """
        if not self.images:
            return None
        path, camera = self.images[index], self.camera
        image = read_image_of(path)
        if image.shape[:2] != (camera.height, camera.width):
            raise DatasetError(
                f"{path} is {image.shape[1]}x{image.shape[0]} pixels, the others are "
                f"{camera.width}x{camera.height}; replace or remove it"
            )
        return image

    def rectified_image(self, index: int) -> NDArray[np.uint8] | None:
        """:meth:`image` without its lens distortion, as depth maps see it."""
        image, camera = self.image(index), self.camera
        if image is None:
            return None
        if self.distortion is None:
            return image
        if self.model == "fisheye":
            image = cv2.fisheye.undistortImage(image, camera.K, self.distortion, Knew=camera.K)
        else:
            image = cv2.undistort(image, camera.K, self.distortion)
        return np.asarray(image, np.uint8)


@dataclass(frozen=True)
class ImageStream:
    """The images of one camera, which may not be calibrated yet, and what is known of it.

    Attributes
    ----------
    times : ndarray of int64, shape (m,)
        Time of each image in nanoseconds, on the clock of the sweeps.
    camera : Camera, optional
        None if K is not known.
    distortion, model
        As :class:`CameraStream` has them.
    """

    name: str
    times: NDArray[np.int64]
    names: list[str]
    images: Sequence[ImageSource]
    camera: Camera | None = None
    distortion: NDArray[np.float64] | None = None
    model: LensModel = "pinhole"

    def __post_init__(self) -> None:
        check_name(self.name)
        if self.camera is not None:
            check_distortion(self.name, self.distortion, self.model)


class ReadSequence(Sequence[_Item]):
    """A sequence whose items are read when they are asked for and not kept; a slice is a list."""

    what = "sweeps"  # what its items are, for errors

    @abstractmethod
    def read(self, index: int) -> _Item:
        """Read one item; the index is not negative."""

    @overload
    def __getitem__(self, index: int) -> _Item: ...
    @overload
    def __getitem__(self, index: slice) -> list[_Item]: ...
    def __getitem__(self, index: int | slice) -> _Item | list[_Item]:
        if isinstance(index, slice):
            return [self.read(k) for k in range(len(self))[index]]
        return self.read(checked_index(index, len(self), self.what))


def checked_index(index: int, count: int, what: str) -> int:
    """Number from 0 of one of ``count`` things; negative ones count from the end."""
    index = as_integer(index, f"{what} are numbered by integers")
    if not -count <= index < count:
        raise IndexError(f"there are {count} {what}, and none has the number {index}")
    return index % count


class DatasetRepr:
    """A dataset in one line."""

    def __repr__(self: Any) -> str:
        cameras = ", ".join(self.cameras) or "none"
        return f"<{type(self).__name__} {self.path}: {len(self)} sweeps, cameras: {cameras}>"


@runtime_checkable
class Dataset(Protocol):
    """A recorded drive. Sweeps are read when they are asked for."""

    name: str
    """As reports call it."""
    path: Path
    """The folder or file that was opened."""
    times: NDArray[np.int64]
    """Nanoseconds of each sweep, shape (n,), strictly increasing."""
    cameras: dict[str, CameraStream]
    """The cameras by name."""

    @property
    def poses(self) -> NDArray[np.float64] | None:
        """``T_world_lidar`` (n, 4, 4) from the recording, or None."""
        ...

    @property
    def lidars(self) -> dict[str, LidarStream]:
        """The LiDARs by name.

        A sweep has the points of all of them, in the frame of the first, whose times and names are
        those of the sweeps.
        """
        ...

    def __len__(self) -> int: ...

    def sweep(self, index: int) -> Sweep:
        """Read one sweep from disk."""
        ...

    def sweep_files(self, index: int) -> list[Path]:
        """All files that ``sweep(index)`` reads: sweeps of every LiDAR, and the times of points.

        They tell whether an input has changed. Empty where sweeps come from no file.
        """
        ...

    def labels(self, index: int) -> NDArray[np.uint32] | None:
        """SemanticKITTI labels of every input point (low 16 bits class, high instance), or None."""
        ...
