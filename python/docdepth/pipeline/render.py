"""The last stage of a run: depth maps of all images (paper V-A, V-B), layers and pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.concurrency import Progress, null_progress
from docdepth.datasets.base import CameraStream
from docdepth.diagnostics.calibration import RunEdges, check_camera_calibration, edges_of_images
from docdepth.errors import DatasetError
from docdepth.geometry.camera import View
from docdepth.geometry.track import Tracks
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.depth import as_stored, check_format
from docdepth.io.run_folder import RunFolder
from docdepth.io.tracks import tracks_in
from docdepth.pipeline.cameras import RunCamera, add_cameras, camera_parameters
from docdepth.pipeline.depth_files import DepthFiles, DepthImage, find_empty_maps
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
class _CameraToRender:
    """A camera and what there is to do for it."""

    stream: CameraStream
    files: DepthFiles
    stage: Stage
    images: list[DepthImage]  # within the trajectory, by time
    shares: dict[DepthImage, float]  # share of pixels with depth of each image that is done
    left_out: list[str]  # images outside the trajectory


def _plan_camera(
    run: RunFolder, camera: RunCamera, trajectory: Trajectory, stage: Stage | None
) -> _CameraToRender:
    """Check the parameters and list the images of a camera; read maps that are done."""
    stream, parameters = camera.stream, camera.parameters
    for format in parameters.output.format:
        check_format(format, parameters.output.scale, parameters.render.max_depth)
    check_layers(parameters.output.layers, parameters.render)
    stage = stage or render_stage(run, camera, trajectory.times)
    if not stage.frames:
        raise DatasetError(
            f"none of the {len(stream.names)} images of {stream.name} lies between the first "
            "and the last sweep; are camera and LiDAR on one clock?",
            "give other times by `camera_times`",
            code="image-times",
        )
    alone = replace(stream, times=stream.times[:0], names=[], images=[])
    files = DepthFiles(alone, camera.folder, parameters, stage.key)
    images, shares, left = [], {}, set(stage.left())
    for n, outputs in enumerate(stage.frames):
        k = outputs.index
        source = stream.images[k] if stream.images else None
        time, identity = int(stream.times[k]), outputs.made_of["image"]
        images.append(DepthImage(files, k, time, stream.names[k], source, identity))
        if n not in left:
            with suppress(DatasetError):  # of a map that cannot be read after all
                shares[images[n]] = _share_with_depth(images[n].depth(run))
    images.sort(key=lambda image: image.time)
    inside = {image.index for image in images}
    left_out = [name for k, name in enumerate(stream.names) if k not in inside]
    return _CameraToRender(stream, files, stage, images, shares, left_out)


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
        trajectory = run.trajectory()
        for alike in drawn_alike.values():
            plans = [
                _plan_camera(run, c, trajectory, (stages or {}).get(f"render {c.stream.name}"))
                for c in alike
            ]
            _render_cameras(run, plans, trajectory, workers, progress, renderer)
            left_out += [
                f"{plan.stream.name}/{image}" if len(run.cameras) > 1 else image
                for plan in plans
                for image in plan.left_out
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
    run: RunFolder,
    plans: Sequence[_CameraToRender],
    trajectory: Trajectory,
    workers: WorkerPool,
    progress: Progress,
    renderer: Renderer,
) -> None:
    """Render the images of cameras that are drawn alike, by time: they share sweeps."""
    total = sum(len(plan.images) for plan in plans)
    images = [image for plan in plans for image in plan.images if image not in plan.shares]
    images.sort(key=lambda image: image.time)
    if not images and all(plan.stage.is_made_once() for plan in plans):
        return
    tracks = tracks_in(run.path)
    with ExitStack() as working:
        profiles: list[Profile] = []
        for plan in plans:
            profile = working.enter_context(plan.stage.working())
            profile.more["left_out"] = plan.left_out
            profile.more["renderer"] = f"{renderer.name}: {renderer.description}"
            profile.frames = len(plan.images) - len(plan.shares)
            profile.timer = profiles[0].timer if profiles else profile.timer
            profile.share = len(plan.images) / total
            profiles.append(profile)
            plan.stage.remove_outdated()
            plan.files.describe(run, plan.shares, complete=False)
        for plan in plans:
            plan.files.write_camera(run, plan.images, trajectory, tracks.values())
        kept = total - len(images)
        progress("render", kept, total)
        chunks = [
            _RenderChunk(some, _tracks_for(some, trajectory, tracks))
            for some in workers.cut(images, trajectory.arc_length_at([i.time for i in images]))
        ]
        rendered = workers.map_frames(
            run,
            partial(_render_images, renderer),
            chunks,
            profiles[0].timer,
            lambda done: progress("render", kept + done, total),
            lambda chunk: len(chunk.images),
        )
        shares: dict[DepthImage, float] = {}
        for number, found in rendered:
            shares.update(zip(chunks[number].images, found, strict=True))
        for plan, profile in zip(plans, profiles, strict=True):
            plan.shares.update((i, shares[i]) for i in plan.images if i in shares)
            plan.files.describe(run, plan.shares, complete=True)
            done = sorted(plan.shares, key=lambda image: image.index)
            density = [plan.shares[image] for image in done]
            profile.more["density"] = float(np.mean(density))
            profile.add(find_empty_maps(density, plan.stream.name))
            profile.more["calibration"] = None
            # Splats reach over edges.
            if plan.stream.images and plan.files.parameters.render.primitive != "splats":
                edges = _edges_of(run, plan.stream, done, trajectory, tracks)
                profile.more["calibration"], findings = check_camera_calibration(edges)
                profile.add(findings)


def _edges_of(
    run: RunFolder,
    stream: CameraStream,
    images: Sequence[DepthImage],
    trajectory: Trajectory,
    tracks: Tracks,
) -> RunEdges:
    maps = {image.index: image for image in images}

    def depth(index: int) -> NDArray[np.float32]:
        return maps[index].depth(run)

    return edges_of_images(run.path, stream, list(maps), depth, trajectory, tracks)


@dataclass(frozen=True)
class _RenderChunk:
    """Images that are rendered one after the other, and the tracks with which they are drawn."""

    images: list[DepthImage]
    tracks: Tracks


def _tracks_for(images: Sequence[DepthImage], trajectory: Trajectory, tracks: Tracks) -> Tracks:
    """The tracks with which some images, in order of time, are drawn."""
    first, last, drawing = images[0].time, images[-1].time, images[0].of.parameters.render
    low, high = times_needed(trajectory, first, last, drawing, tracks)
    low, high = min(low, first - EXTRAPOLATION_NS), max(high, last + EXTRAPOLATION_NS)
    return Tracks(tracks.between(low, high))


def _render_images(renderer: Renderer, context: ChunkContext, chunk: _RenderChunk) -> list[float]:
    """Render images in order; meanwhile the next is prepared and the last is written.

    Returns
    -------
    list of float
        Share of pixels with depth of each.
    """
    run, timer, images, tracks = context.run, context.timer, chunk.images, chunk.tracks
    trajectory, p = run.trajectory(), images[0].of.parameters.render
    cameras = [image.of.camera for image in images]
    views = [
        View.at(camera.camera, camera.T_camera_lidar, trajectory, image.time)
        for camera, image in zip(cameras, images, strict=True)
    ]
    is_drawn = TracksInView(tracks, trajectory, views).draws

    def load(index: int, whole: bool) -> RenderSweep:
        with timer("read"):
            frame, _ = run.classified_frame(index)
        with timer("frames"):
            return prepare_sweep(frame, index, trajectory, p, tracks, whole, is_drawn)

    def write(image: DepthImage, depth: NDArray[np.float32], layers: dict[str, Any]) -> float:
        with timer("write"):
            image.write(run, depth, layers)
        return _share_with_depth(depth)

    cache = SweepCache(load)
    writing: list[Future[float]] = []
    with ThreadPoolExecutor(2) as pool:
        needed: list[dict[int, bool]] = []
        for done, image in enumerate(images):
            needed = needed[1:]
            for coming in images[done + len(needed) : done + 2]:
                needed.append(needed_sweeps(trajectory, coming.time, p, tracks))
            requested = cache.request({one for some in needed for one in some.items()}, pool)
            with timer("wait for frames"):
                sweeps = {i: requested[i, whole].result() for i, whole in needed[0].items()}
            output, left, layers = image.of.parameters.output, image.left(run), {}
            with timer("draw"):
                drawn = render_list(views[done], trajectory, sweeps.__getitem__, p, tracks)
                if [*left] == ["layers"]:
                    depth = image.depth(run)
                else:
                    depth = compose_depth(drawn, context.threads, renderer)
            if "layers" in left:
                stored = as_stored(depth, image.exact, output.scale)
                with timer("layers"):
                    layers = compose_layers(output.layers, stored, drawn, context.threads)
            if writing:
                writing[-1].result()  # one map at a time waits to be written
            writing.append(pool.submit(write, image, depth, layers))
            context.progress(done + 1)
        return [one.result() for one in writing]


def _share_with_depth(depth: NDArray[np.float32]) -> float:
    return float(np.isfinite(depth).mean())
