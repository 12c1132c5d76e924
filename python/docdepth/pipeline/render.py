"""The last stage of a run: depth maps of all images (paper V-A, V-B), layers and pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.concurrency import Progress, Timer, null_progress
from docdepth.datasets.base import CameraStream
from docdepth.diagnostics.calibration import check_camera_calibration, edges_of_images
from docdepth.errors import DatasetError
from docdepth.geometry.camera import View
from docdepth.geometry.track import Tracks
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.depth import check_format
from docdepth.io.run_folder import RunFolder
from docdepth.io.tracks import tracks_in
from docdepth.pipeline.cameras import RunCamera, add_cameras, camera_parameters
from docdepth.pipeline.depth_files import DepthFiles, find_empty_maps
from docdepth.pipeline.parallel import ChunkContext, WorkerPool
from docdepth.pipeline.plan import render_stage, require
from docdepth.pipeline.run_inputs import cameras_at_hand
from docdepth.pipeline.stage import Profile, Stage
from docdepth.render.backends import Renderer
from docdepth.render.depth_map import compose_depth, render_list
from docdepth.render.layers import check_layers, compose_layers
from docdepth.render.object_views import EXTRAPOLATION_NS, TracksInView
from docdepth.render.render_sweep import RenderSweep, SweepCache, prepare_sweep
from docdepth.render.selection import needed_sweeps, times_needed
from docdepth.visualization.report import index_is_whole, write_report


@dataclass(frozen=True)
class ImageToRender:
    """One image: its time [ns], the files of its camera, and its index in that camera."""

    time: int
    files: DepthFiles
    index: int


@dataclass(frozen=True)
class RenderPlan:
    """What the stage has to do."""

    files: list[DepthFiles]  # one for each camera
    stages: list[Stage]  # the stage of each camera
    # images within the trajectory, by time: cameras share the sweeps of one time
    images: list[ImageToRender]
    left: list[ImageToRender]  # those that are not done
    left_out: dict[str, list[str]]  # by camera: images outside the trajectory
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
    """
    for camera in cameras:
        drawing, output = camera.parameters.render, camera.parameters.output
        for format in output.format:
            check_format(format, output.scale, drawing.max_depth)
        check_layers(output.layers, drawing)
    found = RenderPlan([], [], [], [], {}, run.trajectory())
    for camera in cameras:
        stream = camera.stream
        stage = (stages or {}).get(f"render {stream.name}")
        stage = stage or render_stage(run, camera, found.trajectory.times)
        identities = {outputs.index: outputs.made_of["image"] for outputs in stage.frames}
        if not identities:
            raise DatasetError(
                f"none of the {len(stream.names)} images of {stream.name} lies between the first "
                "and the last sweep; are camera and LiDAR on one clock?",
                "give other times by `camera_times`",
                code="image-times",
            )
        folder, parameters = camera.folder, camera.parameters
        files = DepthFiles(run, stream, folder, parameters, stage.key, identities)
        images = [ImageToRender(int(stream.times[k]), files, k) for k in identities]
        left = set(stage.left())
        found.images.extend(images)
        found.left.extend(
            image
            for n, image in enumerate(images)
            if n in left or not files.find_coverage(image.index)
        )
        found.left_out[stream.name] = [
            name for k, name in enumerate(stream.names) if k not in identities
        ]
        found.files.append(files)
        found.stages.append(stage)
    for some in found.images, found.left:
        some.sort(key=lambda image: image.time)
    return found


def run_render(
    run: RunFolder,
    streams: CameraStream | Sequence[CameraStream],
    threads: int = 0,
    progress: Progress = null_progress,
    renderer: Renderer | None = None,
    workers: WorkerPool | None = None,
    stages: Mapping[str, Stage] | None = None,
) -> list[str]:
    """Render a depth map of every image into ``depth/``; layers and pictures beside it.

    Images whose files are whole and up to date are kept.

    Parameters
    ----------
    run : RunFolder
        With classified frames.
    streams : CameraStream or sequence of CameraStream
        The cameras. The run's first camera has ``depth/`` itself, any other a folder in it.
    stages : dict of str to Stage, optional
        :func:`~.plan.render_stage` of the cameras, by name.

    Returns
    -------
    list of str
        Images before the first or after the last sweep, which get no depth map.
    """
    streams = [streams] if isinstance(streams, CameraStream) else list(streams)
    renderer, workers = renderer or Renderer(), workers or WorkerPool(threads)
    with run.lock("render"):
        add_cameras(run, streams)
        drawn_alike: dict[str, list[RunCamera]] = {}  # share sweeps; others are drawn one by one
        for s in streams:
            parameters = camera_parameters(run, s.name)
            camera = RunCamera(s, run.cameras[s.name].folder, parameters)
            drawn_alike.setdefault(parameters.render.model_dump_json(), []).append(camera)
        left_out: list[str] = []
        before = dict(run.manifest.stages)
        for alike in drawn_alike.values():
            plan = plan_render(run, alike, stages)
            _render_cameras(plan, workers, progress, renderer)
            left_out += [
                f"{name}/{image}" if len(run.cameras) > 1 else image
                for name, images in plan.left_out.items()
                for image in images
            ]
        if before != run.manifest.stages or not index_is_whole(run):
            opened = {stream.name: stream for stream in streams}
            others = {} if run.cameras.keys() <= opened.keys() else cameras_at_hand(run)
            write_report(run, others | opened)
    return left_out


def report(run: RunFolder) -> Path:
    """Write the report of a run, ``report/index.html``, anew.

    Parameters
    ----------
    run : RunFolder
        With classified frames. Where its recording is away, the report has no camera images.
    """
    require(run, "classify")
    for name in run.cameras:
        require(run, f"render {name}")
    with run.lock("report"):
        return write_report(run, cameras_at_hand(run))


def _render_cameras(
    plan: RenderPlan, workers: WorkerPool, progress: Progress, renderer: Renderer
) -> None:
    images, run = plan.left, plan.stages[0].run
    if not images and all(stage.is_made_once() for stage in plan.stages):
        return
    with ExitStack() as working:
        profiles: list[Profile] = []
        for files, stage in zip(plan.files, plan.stages, strict=True):
            profile = working.enter_context(stage.working())
            profile.more["left_out"] = plan.left_out[files.stream.name]
            profile.more["renderer"] = f"{renderer.name}: {renderer.description}"
            profile.frames = sum(image.files is files for image in images)
            profile.timer = profiles[0].timer if profiles else profile.timer
            profile.share = len(stage.frames) / len(plan.images)
            profiles.append(profile)
            stage.remove_outdated()
            files.describe(complete=False)
        for files in plan.files:
            files.write_camera(plan.trajectory, plan.tracks.values())
        kept, total = len(plan.images) - len(images), len(plan.images)
        progress("render", kept, total)
        work = partial(_render_images, renderer)
        chunks = workers.cut(images, plan.trajectory.arc_length_at([i.time for i in images]))
        parts = [_RenderChunk(_split_by_camera(some), plan.tracks_for(some)) for some in chunks]
        rendered = workers.map_frames(
            run,
            work,
            parts,
            profiles[0].timer,
            lambda done: progress("render", kept + done, total),
            lambda part: len(part.images),
        )
        for number, shares in rendered:
            for image, share in zip(chunks[number], shares, strict=True):
                image.files.coverage[image.index] = share
        for files, profile in zip(plan.files, profiles, strict=True):
            files.describe()
            profile.more["density"] = float(np.mean(files.shares()))
            profile.add(find_empty_maps(files.shares(), files.stream.name))
            profile.more["calibration"] = None
            # Splats reach over edges.
            if files.stream.images and files.parameters.render.primitive != "splats":
                done, poses, tracks = sorted(files.coverage), plan.trajectory, plan.tracks
                edges = edges_of_images(run.path, files.stream, done, files.depth, poses, tracks)
                profile.more["calibration"], found = check_camera_calibration(edges)
                profile.add(found)


@dataclass(frozen=True)
class _RenderChunk:
    """Images that are rendered one after the other, and the tracks with which they are drawn."""

    images: list[ImageToRender]
    tracks: Tracks


def _render_images(renderer: Renderer, context: ChunkContext, chunk: _RenderChunk) -> list[float]:
    """Render images in order; meanwhile the next is prepared and the last is written.

    Returns
    -------
    list of float
        Share of pixels with depth of each.
    """
    run, timer, images, tracks = context.run, context.timer, chunk.images, chunk.tracks
    trajectory, p = run.trajectory(), images[0].files.parameters.render
    streams = [image.files.stream for image in images]
    views = [
        View.at(stream.camera, stream.T_camera_lidar, trajectory, image.time)
        for stream, image in zip(streams, images, strict=True)
    ]
    is_drawn = TracksInView(tracks, trajectory, views).draws

    def load(index: int, whole: bool) -> RenderSweep:
        with timer("read"):
            frame, _ = run.classified_frame(index)
        with timer("frames"):
            return prepare_sweep(frame, index, trajectory, p, tracks, whole, is_drawn)

    cache = SweepCache(load)
    shares: list[float] = []
    with ThreadPoolExecutor(2) as pool:
        writing: Future[float] | None = None
        needed: list[dict[int, bool]] = []
        for done, image in enumerate(images):
            needed = needed[1:]
            for coming in images[done + len(needed) : done + 2]:
                needed.append(needed_sweeps(trajectory, coming.time, p, tracks))
            files, index = image.files, image.index
            requested = cache.request({one for some in needed for one in some.items()}, pool)
            with timer("wait for frames"):
                sweeps = {i: requested[i, whole].result() for i, whole in needed[0].items()}
            left, layers = files.left(index), dict[str, NDArray[Any]]()
            with timer("draw"):
                drawn = render_list(views[done], trajectory, sweeps.__getitem__, p, tracks)
                if left == ["layers"]:
                    depth = files.depth(index)
                else:
                    depth = compose_depth(drawn, context.threads, renderer)
            if "layers" in left:
                names, stored = files.parameters.output.layers, files.as_stored(depth)
                with timer("layers"):
                    layers = compose_layers(names, stored, drawn, context.threads)
            if writing:
                shares.append(writing.result())
            writing = pool.submit(_write, image, depth, layers, timer)
            context.progress(done + 1)
        if writing:
            shares.append(writing.result())
    return shares


def _split_by_camera(images: list[ImageToRender]) -> list[ImageToRender]:
    """Some images, each with the files of its camera for these images alone."""
    found = list(images)
    for files in {id(image.files): image.files for image in images}.values():
        numbers = [n for n, image in enumerate(images) if image.files is files]
        part = files.of([images[n].index for n in numbers])
        for k, n in enumerate(numbers):
            found[n] = ImageToRender(images[n].time, part, k)
    return found


def _write(
    image: ImageToRender,
    depth: NDArray[np.float32],
    layers: dict[str, NDArray[Any]],
    timer: Timer,
) -> float:
    with timer("write"):
        return image.files.write(image.index, depth, layers)
