"""The inputs of a run, and what was found in them when it began."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, field_validator

from docdepth._text import shown
from docdepth.errors import ConfigError
from docdepth.geometry.turn import Turn

OWN_POSES = "dataset"
"""``poses`` that means those of the recording."""

Point = tuple[float, float, float]
Interval = tuple[float, float]
Box = tuple[Interval, Interval, Interval]
"""Least and greatest x, y and z, metres in the LiDAR frame."""

MOST_BOXES = 1000  # around a vehicle; each is looked for in each sweep


class Checked(BaseModel):
    """A frozen model whose mistakes are errors of docdepth."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    def __init__(self, **values: Any) -> None:
        try:
            super().__init__(**values)
        except ValidationError as error:
            raise ConfigError(explain(error)) from None


def explain(error: ValidationError) -> str:
    """What is wrong with the values of a model."""
    sentences = {}
    for problem in error.errors():
        name, value = str((*problem["loc"], "")[0]), problem["input"]
        text = problem["msg"].removeprefix("Value error, ")
        if problem["type"] == "extra_forbidden":
            text = f"unknown option {name!r}"
        elif problem["type"] == "literal_error":
            expected = problem["ctx"]["expected"].replace("'", "")
            text = f"{name} is {shown(value)}; it must be {expected}"
        elif problem["type"] != "value_error":
            text = f"{name} is {shown(value)}: {text}"
        sentences[name] = text
    return "; ".join(sentences.values())


def _absolute(path: Any) -> Any:
    return None if path is None else Path(_as_path(path)).resolve()


def _as_path(path: Any) -> str:
    if not isinstance(path, str | os.PathLike):
        raise ValueError(f"a {type(path).__name__} is not a path; give that of its folder or file")
    return os.fspath(path)


_Path = Annotated[Path, BeforeValidator(_absolute)]


def _field(description: str, metavar: str = "") -> Any:
    """An input that may be left out; the description is the help of its option, too."""
    return Field(None, description=description, json_schema_extra={"metavar": metavar})


class RunInputs(Checked):
    """What a run is made of: a recording, and what is taken in place of its own data.

    The command line, Python, ``--config`` and run.yaml share these fields: each but ``recording``
    is an option of ``docdepth run``. Paths are made absolute.
    """

    recording: _Path = Field(description="A recording: its folder, or its file.")
    dataset: str | None = _field("Format of the recording; guessed if absent.")
    camera: tuple[str, ...] | None = _field(
        "Cameras to draw, by the recording's names (image_02), all, or none; the left colour "
        "camera if absent. With none, a run ends with poses and labels.",
        "NAME,...",
    )
    frames: str | None = _field("Take sweeps A to B-1 only, counted from 0; all if absent.", "A:B")
    poses: str | None = _field(
        "Poses of the LiDAR from your own SLAM, one per sweep: TUM, KITTI, PLY or NPY. "
        "CAMERA:FILE for those of a camera, dataset for the recording's own; estimated if absent.",
        "FILE",
    )
    poses_as_given: bool = Field(
        False,
        description="Keep the given poses however badly sweeps fit each other by them. Else a run "
        "refines poses that are off by more than some centimetres over ten sweeps.",
    )
    camera_times: _Path | None = _field(
        "Times of the images in seconds, one per line; those of the recording if absent.", "FILE"
    )
    calibration: _Path | None = _field(
        "calib.json of docdepth calibrate, or a text file with the 4x4 matrix T_camera_lidar: "
        "taken in place of the recording's own calibration.",
        "FILE",
    )
    camera_fit: Literal["apply", "report", "off"] = Field(
        "apply",
        description="Whether depth edges that lie beside those of the images change the camera's "
        "calibration and times. apply: where all parts of a drive of 60 m agree, maps are drawn "
        "again. report: only say it.",
    )
    keep_ego: bool = Field(
        False,
        description="Keep what the LiDAR sees of its own vehicle. Else a run finds it, where "
        "ego_boxes in docdepth.yaml does not say where it is, and leaves it out.",
    )
    labels: _Path | None = _field(
        "Draw with the classes of another method: a folder of NAME.label (SemanticKITTI), "
        "NAME.npy (classid) or NAME.pcd for each sweep, or a run. Nothing is classified then.",
        "DIR",
    )
    mask: tuple[str, ...] | None = _field(
        "Image of a camera's size that is black where it shows no world, such as the own bonnet: "
        "these pixels get no depth. Repeat it for more cameras.",
        "CAMERA:FILE",
    )
    image_size: str | None = _field(
        "Size of the images in pixels, for a recording without images that does not tell it, for "
        "example 1242x375.",
        "WxH",
    )
    on_error: Literal["stop", "skip"] | None = _field(
        "Broken sweeps and images. stop: report them and end. skip: read the whole recording first "
        "and leave them out. Default: as the run was started; stop for a new run."
    )
    hash_inputs: bool = Field(
        False,
        description="Detect changed sweeps and images by a hash of their content instead of size "
        "and time; reads the whole recording once.",
    )

    @field_validator("camera", mode="before")
    @classmethod
    def _names(cls, names: Any) -> Any:
        """One name, several with commas, or a list of either."""
        if not isinstance(names, str | list | tuple) or not all(isinstance(n, str) for n in names):
            return names
        return names_in(names)

    @field_validator("mask", mode="before")
    @classmethod
    def _masks(cls, masks: Any) -> Any:
        """``CAMERA:FILE``, or several."""
        if masks is None:
            return None
        named = []
        for text in [masks] if isinstance(masks, str) else masks:
            camera, colon, file = str(text).partition(":")
            if not camera or not colon or not file:
                raise ValueError(f"`mask` is {shown(text)}; write CAMERA:FILE")
            named.append(f"{camera}:{_absolute(file)}")
        return tuple(named) or None

    @field_validator("poses", mode="before")
    @classmethod
    def _poses(cls, poses: Any) -> Any:
        """``CAMERA:FILE``, where no file has this name, means poses of that camera."""
        if poses is None or _as_path(poses) == OWN_POSES:
            return poses
        camera, file = camera_and_file(_as_path(poses))
        return f"{camera}:{_absolute(file)}" if camera else str(_absolute(file))

    def but(self, **changes: Any) -> RunInputs:
        """The inputs with other values."""
        return RunInputs(**self.model_dump() | changes)


def names_in(texts: str | Sequence[str] | None) -> tuple[str, ...] | None:
    """Names of cameras from a text, or several, of one or more with commas; None if none."""
    every = [texts] if isinstance(texts, str) else list(texts or ())
    every = [name.strip() for text in every for name in text.split(",")]
    if "" in every:
        raise ConfigError("`camera` holds an empty name; write NAME or NAME,NAME")
    return tuple(dict.fromkeys(every)) or None


def camera_and_file(poses: str) -> tuple[str, str]:
    """Camera and file of ``poses``; an empty name for poses of the LiDAR."""
    camera, colon, file = poses.partition(":")
    return (camera, file) if colon and not Path(poses).exists() else ("", poses)


class SkippedFrames(Checked):
    """Broken frames that a run leaves out, each with what is wrong."""

    checked: str  # hash of the files that were read to find them
    sweeps: dict[int, str] = {}  # by number in the recording
    images: dict[str, dict[str, str]] = {}  # by camera and name

    def sentences(self) -> list[str]:
        """A sentence for each frame."""
        found = [f"sweep {k}: {why}" for k, why in self.sweeps.items()]
        for camera, images in self.images.items():
            found += [f"image {name} of {camera}: {why}" for name, why in images.items()]
        return found


class DerivedInputs(Checked):
    """What was found in the inputs when a run began; it holds for good.

    Attributes
    ----------
    up : (float, float, float), optional
        Unit vector in the LiDAR frame of the recording; None if its z is up.
    sensor_origin : (float, float, float), or one for each LiDAR, optional
        Where the rays begin, metres in the LiDAR frame; None if at the origin.
    turn : Turn, optional
        How the LiDAR turns, which gives times to points that have none.
    ego_boxes : tuple of ((x, x), (y, y), (z, z)), optional
        Around what the LiDAR sees of its own vehicle, metres in the LiDAR frame of the recording;
        None if it was not found.
    skipped : SkippedFrames, optional
        None if broken frames stop the run.
    """

    up: Point | None = None
    ego_boxes: Annotated[tuple[Box, ...], Field(max_length=MOST_BOXES)] | None = None
    sensor_origin: Point | tuple[Point, ...] | None = None
    turn: Turn | None = None
    skipped: SkippedFrames | None = None
