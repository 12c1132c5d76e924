"""What the render stage of a run has to do: which images of which cameras, into which folders."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.base import CameraStream
from docdepth.errors import DatasetError
from docdepth.geometry.track import Tracks
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.depth import check_format
from docdepth.io.run_folder import RunFolder
from docdepth.io.tracks import tracks_in
from docdepth.pipeline.depth_files import DepthFiles
from docdepth.pipeline.plan import render_stage
from docdepth.pipeline.run_inputs import RunCamera
from docdepth.pipeline.stage import Stage
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
    stages : list of Stage
        The stage of each camera.
    images : list of ImageToRender
        Images within the trajectory, by time: cameras share the sweeps of one time.
    left : list of ImageToRender
        Those that are not done.
    left_out : dict of str to list of str
        By camera: images outside the trajectory.
    trajectory : Trajectory
    """

    files: list[DepthFiles]
    stages: list[Stage]
    images: list[ImageToRender]
    left: list[ImageToRender]
    left_out: dict[str, list[str]]
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


def plan_render(
    run: RunFolder, cameras: Sequence[RunCamera], stages: Mapping[str, Stage] | None = None
) -> RenderPlan:
    """Check the parameters and list the images of cameras that are drawn alike.

    ``stages`` are those of :func:`~.plan.render_stage` by name, as far as they are known.

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
    found = RenderPlan([], [], [], [], {}, run.trajectory())
    for camera in cameras:
        stream = camera.stream
        inside = _inside(found.trajectory, stream)
        stage = (stages or {}).get(f"render {stream.name}")
        stage = stage or render_stage(run, camera, found.trajectory.times)
        indices = np.flatnonzero(inside).tolist()
        identities = [outputs.made_of["image"] for outputs in stage.frames]
        files = DepthFiles(
            run,
            stream,
            camera.folder,
            camera.parameters,
            stage.key,
            dict(zip(indices, identities, strict=True)),
        )
        images = [ImageToRender(int(stream.times[k]), files, k) for k in indices]
        left = set(stage.left())
        found.images.extend(images)
        found.left.extend(
            image
            for n, image in enumerate(images)
            if n in left or not files.find_coverage(image.index)
        )
        found.left_out[stream.name] = [stream.names[k] for k in np.flatnonzero(~inside)]
        found.files.append(files)
        found.stages.append(stage)
    for some in found.images, found.left:
        some.sort(key=lambda image: image.time)
    return found


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
