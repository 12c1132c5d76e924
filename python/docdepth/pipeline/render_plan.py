"""What the render stage of a run has to do: which images of which cameras, into which folders."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.config import Parameters
from docdepth.datasets.base import CameraStream
from docdepth.errors import DatasetError
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.depth import check_format
from docdepth.io.run_folder import RunFolder, stage_key
from docdepth.pipeline.depth_files import DepthFiles
from docdepth.render.layers import check_layers


@dataclass(frozen=True)
class ImageToRender:
    """One image: its time [ns], the files of its camera, and its index in that camera."""

    time: int
    files: DepthFiles
    index: int


@dataclass(frozen=True)
class RenderPlan:
    """What the stage has to do.

    Attributes
    ----------
    files : list of DepthFiles
        One for each camera.
    images : list of ImageToRender
        Images within the trajectory, by time: cameras share the sweeps of one time.
    left_out : list of str
        Images outside the trajectory.
    key : str
        Hash of all that the depth maps depend on.
    trajectory : Trajectory
    parameters : Parameters
    """

    files: list[DepthFiles]
    images: list[ImageToRender]
    left_out: list[str]
    key: str
    trajectory: Trajectory
    parameters: Parameters

    @property
    def folders(self) -> list[str]:
        """Folders of the cameras in ``depth/``."""
        return [files.folder for files in self.files]


def plan_render(
    run: RunFolder, streams: list[CameraStream], stage: str, parameters: Parameters
) -> RenderPlan:
    """Check the parameters and list the images of all cameras.

    Raises
    ------
    ConfigError, InputError
        The output format cannot hold the depth, or a layer does not exist.
    DatasetError
        No image of a camera lies between the first and the last sweep.
    """
    drawing, output = parameters.render, parameters.output
    for format in output.format:
        check_format(format, output.scale, drawing.max_depth)
    check_layers(output.layers, drawing)
    trajectory = run.trajectory()
    key = stage_key(
        run.stage("classify").get("key"),
        drawing.model_dump(),
        output.model_dump(),
        [_identity(stream) for stream in streams],
    )
    separate = len(streams) > 1 or stage != "render"
    files, images, left_out = [], [], []
    for stream in streams:
        camera = DepthFiles(run, stream, stream.name if separate else "", parameters)
        inside = _inside(trajectory, stream)
        images += [
            ImageToRender(int(stream.times[k]), camera, int(k)) for k in np.flatnonzero(inside)
        ]
        names = [stream.names[k] for k in np.flatnonzero(~inside)]
        left_out += [f"{camera.folder}/{name}" if separate else name for name in names]
        files.append(camera)
    images.sort(key=lambda image: image.time)
    return RenderPlan(files, images, left_out, key, trajectory, parameters)


def _inside(trajectory: Trajectory, stream: CameraStream) -> NDArray[np.bool_]:
    """Which images were taken between the first and the last sweep."""
    inside = trajectory.covers(stream.times)
    if not inside.any():
        raise DatasetError(
            f"none of the {len(stream.names)} images of {stream.name} lies between the first and "
            "the last sweep; are camera and LiDAR on one clock? See --camera-times"
        )
    return inside


def _identity(stream: CameraStream) -> list[Any]:
    """All of a camera that its depth maps depend on."""
    camera = stream.camera
    return [
        stream.name,
        camera.K.tolist(),
        [camera.width, camera.height],
        stream.distortion_coefficients,
        stream.T_camera_lidar.tolist(),
        stream.names,
        stream.times.tolist(),
    ]
