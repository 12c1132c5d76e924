"""What the render stage of a run has to do: which images of which cameras, into which folders."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.base import CameraStream
from docdepth.errors import DatasetError
from docdepth.geometry.track import Tracks
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.depth import check_format
from docdepth.io.run_folder import RunFolder, stage_key
from docdepth.io.tracks import tracks_in
from docdepth.pipeline.depth_files import DepthFiles
from docdepth.pipeline.graph import Parts, render_parts
from docdepth.pipeline.input_files import InputFiles
from docdepth.pipeline.run_inputs import RunCamera
from docdepth.render.layers import check_layers
from docdepth.render.object_views import EXTRAPOLATION_NS
from docdepth.render.selection import times_needed
from docdepth.render.view import View


@dataclass(frozen=True)
class ImageToRender:
    """One image: its time [ns], the files of its camera, and its index in that camera."""

    time: int
    files: DepthFiles
    index: int

    def view(self, trajectory: Trajectory) -> View:
        """What the image shows, and from where."""
        stream = self.files.stream
        return View.at(stream.camera, stream.T_camera_lidar, trajectory, self.time)


@dataclass(frozen=True)
class RenderPlan:
    """What the stage has to do.

    Attributes
    ----------
    files : list of DepthFiles
        One for each camera.
    images : list of ImageToRender
        Images within the trajectory, by time: cameras share the sweeps of one time.
    left_out : dict of str to list of str
        By camera: images outside the trajectory.
    parts : dict of str to dict
        By camera: what its depth maps are made of.
    trajectory : Trajectory
    """

    files: list[DepthFiles]
    images: list[ImageToRender]
    left_out: dict[str, list[str]]
    parts: dict[str, Parts]
    trajectory: Trajectory

    @cached_property
    def tracks(self) -> Tracks:
        """All tracks of the run."""
        return tracks_in(self.files[0].run.path)

    def tracks_for(self, images: Sequence[ImageToRender]) -> Tracks:
        """The tracks with which some images, in order of time, are drawn."""
        first, last, drawing = images[0].time, images[-1].time, images[0].files.parameters.render
        low, high = times_needed(self.trajectory, first, last, drawing, self.tracks)
        return Tracks(
            self.tracks.between(
                min(low, first - EXTRAPOLATION_NS), max(high, last + EXTRAPOLATION_NS)
            )
        )


def plan_render(run: RunFolder, cameras: Sequence[RunCamera]) -> RenderPlan:
    """Check the parameters and list the images of cameras that are drawn alike.

    Raises
    ------
    ConfigError, InputError
        The output format cannot hold the depth, or a layer does not exist.
    DatasetError
        No image of a camera lies between the first and the last sweep.
    """
    for camera in cameras:
        drawing, output = camera.parameters.render, camera.parameters.output
        for format in output.format:
            check_format(format, output.scale, drawing.max_depth)
        check_layers(output.layers, drawing)
    trajectory, inputs = run.trajectory(), InputFiles(run)
    files, images, left_out, parts = [], [], {}, {}
    for camera in cameras:
        stream = camera.stream
        made_of = render_parts(run.stage("classify").key, camera)
        of_camera = DepthFiles(
            run,
            stream,
            camera.folder,
            camera.parameters,
            stage_key(made_of),
            inputs.images(stream),
        )
        inside = _inside(trajectory, stream)
        images += [
            ImageToRender(int(stream.times[k]), of_camera, int(k)) for k in np.flatnonzero(inside)
        ]
        left_out[stream.name] = [stream.names[k] for k in np.flatnonzero(~inside)]
        parts[stream.name] = made_of
        files.append(of_camera)
    inputs.save()
    images.sort(key=lambda image: image.time)
    return RenderPlan(files, images, left_out, parts, trajectory)


def _inside(trajectory: Trajectory, stream: CameraStream) -> NDArray[np.bool_]:
    """Which images were taken between the first and the last sweep."""
    inside = trajectory.covers(stream.times)
    if not inside.any():
        raise DatasetError(
            f"none of the {len(stream.names)} images of {stream.name} lies between the first and "
            "the last sweep; are camera and LiDAR on one clock?",
            "give other times by `camera_times`",
            code="image-times",
        )
    return inside
