"""``docdepth.yaml``: what the files of a recording do not tell.

It lies in the folder of a recording, or beside a recording that is a single file. Unknown entries
are errors, so that no word in it is ignored.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PrivateAttr,
    ValidationError,
    field_validator,
)

from docdepth.datasets.base import check_distortion
from docdepth.datasets.files import FILE, is_there, read_image, read_lines, settings_file
from docdepth.datasets.point_times import Instant, Unit
from docdepth.datasets.pose_tables import read_poses_at
from docdepth.errors import CalibrationError, DatasetError
from docdepth.geometry.camera import MOST_METRES, Camera, camera_of, checked_mount
from docdepth.geometry.se3 import nearest_rigid
from docdepth.io.inputs import MOST_BOXES
from docdepth.io.untrusted import parse_yaml

_WHOLE = 1e-9  # of a rotation's numbers; larger errors come of missing digits
_WORDS = {
    "Input should be": "it must be",
    "a valid boolean": "true or false",
    "a valid integer": "a whole number",
    "a valid tuple": "a list",
    "a valid": "a",
}
_MOST_PIXELS = 1e6  # of a corner of a mask, which may lie beside the image


def _flat(value: Any) -> Any:
    """Matrices may be written row by row or as one list."""
    if isinstance(value, list) and value and all(isinstance(row, list) for row in value):
        return [number for row in value for number in row]
    return value


Numbers = Annotated[list[float], BeforeValidator(_flat)]
Mask = Path | list[tuple[float, float]]


def _boxes(value: Any) -> Any:
    """One box may be written without the brackets around all of them."""
    if isinstance(value, list) and len(value) == 3 and all(np.shape(row) == (2,) for row in value):
        return [value]
    return value


def _three(value: Any) -> NDArray[np.float64]:
    """Three numbers; NaN of what is none."""
    try:
        numbers = np.array(value, np.float64)
    except (TypeError, ValueError):
        return np.full(3, np.nan)
    return numbers if numbers.shape == (3,) else np.full(3, np.nan)


class Strict(BaseModel):
    """Unknown entries are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class CameraSettings(Strict):
    """A camera, or what is missing of it."""

    K: Numbers | None = None  # fx 0 cx 0 fy cy 0 0 1, or fx fy cx cy, pixels
    size: tuple[int, int] | None = None  # width and height in pixels
    distortion: Numbers | None = None  # as :attr:`~docdepth.datasets.CameraStream.distortion`
    model: Literal["pinhole", "fisheye"] = "pinhole"
    T_camera_lidar: Numbers | None = None  # matrix of 4 x 4 or 3 x 4, row by row

    def camera(self, size: tuple[int, int] | None, where: str) -> Camera:
        """The pinhole camera."""
        if self.K is None or len(self.K) not in (4, 9):
            raise CalibrationError(f"{where}: K must be 4 numbers fx fy cx cy, or 9; got {self.K}")
        if size is None:
            raise CalibrationError(f"{where} has neither images nor size: [width, height]")
        if len(self.K) == 4:
            fx, fy, cx, cy = self.K
            return camera_of(np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), size, where)
        return camera_of(np.reshape(self.K, (3, 3)), size, where)

    def lens(self, where: str) -> NDArray[np.float64] | None:
        """The distortion; None without one. Zeros are none for a pinhole, not for a fisheye."""
        numbers = self.distortion or ()
        lens = np.array(numbers) if self.model == "fisheye" or any(numbers) else None
        check_distortion(where, lens, self.model)
        return lens


class RecordingSettings(Strict):
    """What every recording takes.

    Attributes
    ----------
    ego_boxes : list of [[x, x], [y, y], [z, z]], optional
        Least and greatest coordinates of boxes, metres in the LiDAR frame, whose points are of the
        vehicle itself and are left out. None: not said, so a run finds them.
    masks : dict of str to (str or list of (float, float))
        Pixels of a camera that get no depth, such as those of the own bonnet: see
        :func:`camera_mask`.
    motion_compensated : bool, optional
        Whether the sweeps are deskewed already. None: not said, taken as False.
    sensor_origin : (float, float, float), optional
        Where the rays of a single LiDAR begin, metres in the frame of its points.
    up : (float, float, float), optional
        Direction that points up, in the frame of the points.
    stamp : {"start", "middle", "end"}, optional
        Which instant of a sweep its time is.
    point_time_unit : {"s", "ms", "us", "ns"}, optional
    beam_width_deg : float, optional
        Full angle of a beam of the LiDAR. None: that of KITTI's LiDAR, and 0 of others.
    sweep_duration : float, optional
        Seconds. Sweeps of the recording are joined or cut to it by the times of their points.
    poses : str, optional
        File of LiDAR poses; or ``viewpoint``, those in the headers of PCD files; or a topic of
        a bag: odometry, poses, a path, or transforms.
    """

    ego_boxes: Annotated[
        list[Numbers] | None, Field(max_length=MOST_BOXES), BeforeValidator(_boxes)
    ] = None
    masks: dict[str, str | list[tuple[float, float]]] = Field(default_factory=dict)
    motion_compensated: bool | None = None
    sensor_origin: tuple[float, float, float] | None = None
    up: tuple[float, float, float] | None = None
    stamp: Instant | None = None
    point_time_unit: Unit | None = None
    beam_width_deg: float | None = Field(None, ge=0, le=2)
    sweep_duration: float | None = Field(None, ge=0.01, le=10)
    poses: str | None = None
    _file: Path = PrivateAttr(Path(FILE))

    @property
    def file(self) -> Path:
        """Where the settings stand, or would stand."""
        return self._file

    @field_validator("ego_boxes")
    @classmethod
    def _are_boxes(cls, boxes: list[list[float]] | None) -> list[list[float]] | None:
        for box in boxes or ():
            low, high = np.array(box).reshape(3, 2).T if len(box) == 6 else (np.zeros(3),) * 2
            if not ((low < high) & (np.abs([low, high]) < MOST_METRES).all(axis=0)).all():
                raise ValueError(
                    "ego_boxes must be boxes [[x, x], [y, y], [z, z]], least and greatest "
                    f"coordinates in metres; got {box}"
                )
        return boxes

    @field_validator("sensor_origin", mode="before")
    @classmethod
    def _is_place(cls, place: Any) -> Any:
        if place is not None and not np.linalg.norm(_three(place), np.inf) < MOST_METRES:
            raise ValueError(f"sensor_origin must be [x, y, z] in metres, got {place}")
        return place

    @field_validator("up", mode="before")
    @classmethod
    def _is_direction(cls, up: Any) -> Any:
        if up is not None and not 1e-3 < np.linalg.norm(_three(up)) < 1e3:
            raise ValueError(
                "up must be [x, y, z], the direction that points up in the frame of the points, as "
                f"in [0, -1, 0]; got {up}"
            )
        return up

    def poses_at(self, times: NDArray[np.int64]) -> NDArray[np.float64] | None:
        """``T_world_lidar`` at the times of the sweeps, of the file ``poses``; None without it."""
        return read_poses_at(self.file.parent / self.poses, times) if self.poses else None

    def camera_masks(self) -> dict[str, Mask]:
        """``masks``, files relative to the folder of the settings."""
        return {
            camera: self.file.parent / mask if isinstance(mask, str) else mask
            for camera, mask in self.masks.items()
        }


_Settings = TypeVar("_Settings", bound=RecordingSettings)


def read_settings(
    recording: Path,
    model: type[_Settings],
    usual: Mapping[str, object] | None = None,
    taken: Collection[str] | None = None,
) -> _Settings:
    """The settings of a recording.

    Parameters
    ----------
    recording : Path
        Folder, or file beside which ``docdepth.yaml`` lies.
    model : type
        What the format takes.
    usual : dict, optional
        What entries are that are left out, where the format knows better than ``model``.
    taken : collection of str, optional
        Entries that the format takes, if not all of ``model``.
    """
    file = settings_file(recording)
    given: Any = None
    if is_there(file):
        try:
            given = parse_yaml("\n".join(read_lines(file, "write it again or remove it")))
        except ValueError as error:
            raise DatasetError(f"{file} is not YAML: {error}") from None
    elif is_there(other := file.with_suffix(".yml")):
        raise DatasetError(f"{other} is not read; call it {file.name}")
    if not isinstance(given, dict | None):
        raise DatasetError(f"{file}: write NAME: VALUE")
    names = list(model.model_fields) if taken is None else list(taken)
    unknown = [name for name in given or {} if name not in names]
    entries = {name: value for name, value in (given or {}).items() if name in names}
    reasons = []
    try:
        settings = model.model_validate({**(usual or {}), **entries})
    except ValidationError as error:
        reasons = _reasons(error)
    if unknown:
        reasons.append(
            f"{', '.join(map(str, unknown))} {'is' if len(unknown) == 1 else 'are'} unknown; "
            f"there are {', '.join(names)}"
        )
    if reasons:
        raise DatasetError(f"{file}: {'; '.join(reasons)}")
    settings._file = file
    return settings


def camera_mask(camera: Camera, mask: Mask) -> NDArray[np.bool_]:
    """Pixels of a rectified camera that show the world, (height, width).

    The mask is an image of the camera's size that is black where nothing of the world is seen, as
    COLMAP and nerfstudio take it; or the corners of a polygon around such pixels.
    """
    if isinstance(mask, Path):
        seen = read_image(mask).any(axis=2)
        if seen.shape != (camera.height, camera.width) or not seen.any():
            raise CalibrationError(
                f"{mask} has {seen.shape[1]}x{seen.shape[0]} pixels, {int(seen.sum())} of them not "
                f"black; a mask has the {camera.width}x{camera.height} pixels of its camera, black "
                "where nothing of the world is seen"
            )
        return seen
    corners = np.array(mask, np.float64).reshape(-1, 2)
    if len(corners) < 3 or not (np.abs(corners) < _MOST_PIXELS).all():
        raise CalibrationError(
            f"a mask is a polygon of [x, y] corners, at least three, in pixels; got {mask}"
        )
    hidden = np.zeros((camera.height, camera.width), np.uint8)
    cv2.fillPoly(hidden, [np.rint(corners).astype(np.int32)], 1)
    if hidden.all() or not hidden.any():
        raise CalibrationError(
            f"the polygon {mask} of a mask covers {'all' if hidden.all() else 'none'} of the "
            f"{camera.width}x{camera.height} pixels of its camera; give the corners around what "
            "shows nothing of the world"
        )
    return hidden == 0


def transform(numbers: list[float] | None, where: str) -> NDArray[np.float64]:
    """A rigid transform (4, 4) of 12 or 16 numbers, row by row."""
    if numbers is None or len(numbers) not in (12, 16):
        raise CalibrationError(f"{where} must be 16 numbers, row by row; got {numbers}")
    T = np.eye(4)
    T[: len(numbers) // 4] = np.array(numbers).reshape(-1, 4)
    checked_mount(where, T)
    # A matrix printed with few digits is a rotation only nearly; a whole one is kept to the bit.
    nearest = nearest_rigid(T)
    return nearest if np.abs(nearest - T).max() > _WHOLE else T


def _reasons(error: ValidationError) -> list[str]:
    """What is wrong with entries of a model."""
    reasons = []
    for one in error.errors():
        entry = ".".join(str(part) for part in one["loc"])
        if one["type"] == "value_error":
            reasons.append(str(one["ctx"]["error"]))
        elif one["type"] == "extra_forbidden":
            reasons.append(f"{entry} is unknown")
        else:
            wanted = one["msg"].removesuffix(", unable to interpret input")
            wanted = wanted.partition(" or instance of")[0]
            for theirs, ours in _WORDS.items():
                wanted = wanted.replace(theirs, ours)
            reasons.append(f"{entry} is {one['input']!r}: {wanted}")
    return reasons
