"""The last stage of a run: depth maps of all images (paper V-A, V-B), layers and pictures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from docdepth.config import Parameters
from docdepth.datasets.base import CameraStream
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.frames import write_trajectory
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline.depth_files import FOLDERS
from docdepth.pipeline.render_plan import ImageToRender, RenderPlan, plan_render
from docdepth.pipeline.stage import (
    Progress,
    Stopwatch,
    finish_stage,
    progress_callback,
    stage_is_done,
)
from docdepth.render.backends import Renderer
from docdepth.render.depth_map import compose_depth
from docdepth.render.frame import Frame
from docdepth.render.frame_cache import FrameCache
from docdepth.render.layers import compose_layers
from docdepth.render.selection import needed_frames
from docdepth.visualization.report import write_index


def run_render(
    run: RunFolder,
    streams: CameraStream | Sequence[CameraStream],
    threads: int = 0,
    progress: Progress | None = None,
    renderer: Renderer | None = None,
    stage: str = "render",
    parameters: Parameters | None = None,
) -> list[str]:
    """Render a depth map of every image into ``depth/``; layers and pictures beside it.

    Images whose files are there are kept.

    Parameters
    ----------
    run : RunFolder
        With classified frames.
    streams : CameraStream or sequence of CameraStream
        The cameras. Each of several has its own folder, named after it.
    threads : int
        0 takes all cores. The result does not depend on it.
    progress : callable, optional
        Called with the stage, the number of images done and of all images.
    renderer : Renderer, optional
        From :func:`docdepth.render.backends.choose`; the CPU if absent.
    stage : str
        Name in run.yaml. The cameras of any other stage than ``render`` are added to those of the
        run, each in its own folder.
    parameters : Parameters, optional
        Those of the run if absent.

    Returns
    -------
    list of str
        Images before the first or after the last sweep, which get no depth map.

    Raises
    ------
    ConfigError, InputError
        The output format cannot hold the depth, or a layer does not exist.
    DatasetError
        No image of a camera lies between the first and the last sweep, or an image is damaged.
    RunError
        A frame has no classes.
    """
    streams = [streams] if isinstance(streams, CameraStream) else list(streams)
    plan = plan_render(run, streams, stage, parameters or run.parameters)
    if stage_is_done(run, stage, plan.key):
        return plan.left_out
    renderer, watch = renderer or Renderer(), Stopwatch()
    _remove_outdated(run, stage, plan)
    run.set_stage(
        stage,
        state="running",
        key=plan.key,
        cameras=[s.name for s in streams],
        folders=plan.folders,
        left_out=plan.left_out,
        renderer=f"{renderer.name}: {renderer.description}",
    )
    _write_cameras(run, plan)
    images = [image for image in plan.images if not image.files.find_done(image.index)]
    for files in plan.files:
        files.describe()
    kept, report = len(plan.images) - len(images), progress_callback(progress, stage)
    job = _Job(run, plan, threads, renderer, watch)
    _render_images(job, images, lambda done: report(kept + done, len(plan.images)))
    for files in plan.files:
        files.describe()
    coverage = [share for files in plan.files for share in files.coverage.values()]
    finish_stage(run, stage, watch, len(images), density=float(np.mean(coverage)))
    write_index(run)
    return plan.left_out


def _remove_outdated(run: RunFolder, stage: str, plan: RenderPlan) -> None:
    """Delete the files that were made with other parameters or of other cameras."""
    before = run.stage(stage)
    if before.get("key") == plan.key:
        return
    old = set(before.get("folders", [""] if stage == "render" else []))
    for folder in old | set(plan.folders):
        for kind in FOLDERS:
            run.clear(f"{kind}/{folder}")
    for folder in old - set(plan.folders):
        run.forget_calibration(folder)


def _write_cameras(run: RunFolder, plan: RenderPlan) -> None:
    """Write calibration and interpolated poses (paper V-A) of each camera."""
    for files in plan.files:
        stream, folder = files.stream, files.folder
        run.write_calibration(
            stream.camera, stream.T_camera_lidar, stream.distortion_coefficients, folder
        )
        indices = np.array([image.index for image in plan.images if image.files is files])
        times = stream.times[indices]
        poses = Trajectory(times, plan.trajectory.interpolate(times))
        write_trajectory(run.calibration_folder(folder) / "traj_camera.ply", poses, indices)


class _Job(NamedTuple):
    """What all images of the stage share."""

    run: RunFolder
    plan: RenderPlan
    threads: int
    renderer: Renderer
    watch: Stopwatch


def _render_images(job: _Job, images: list[ImageToRender], progress: Callable[[int], None]) -> None:
    """Render images in order; meanwhile the next is prepared and the last is written."""
    run, plan, watch = job.run, job.plan, job.watch
    trajectory, parameters = plan.trajectory, plan.parameters
    cache = FrameCache(lambda i: load_frame(run, trajectory, i, parameters, watch))
    progress(0)
    with ThreadPoolExecutor(2) as pool:
        writing: Future[None] | None = None
        for done, image in enumerate(images):
            now_and_next = images[done : done + 2]
            needed = [needed_frames(trajectory, i.time, parameters.render) for i in now_and_next]
            requested = cache.request(set().union(*needed), pool)
            with watch("wait for frames"):
                frames = {i: requested[i].result() for i in needed[0]}
            depth, layers = _render_image(job, image, frames)
            if writing:
                writing.result()
            writing = pool.submit(_write, image, depth, layers, watch)
            progress(done + 1)
        if writing:
            writing.result()


def _render_image(
    job: _Job, image: ImageToRender, frames: dict[int, Frame]
) -> tuple[NDArray[np.float32], dict[str, NDArray[Any]]]:
    parameters, stream = job.plan.parameters, image.files.stream
    scene = (
        stream.camera,
        stream.T_camera_lidar,
        job.plan.trajectory,
        image.time,
        frames.__getitem__,
        parameters.render,
        job.threads,
    )
    with job.watch("draw"):
        depth = compose_depth(*scene, job.renderer)
    if not parameters.output.layers:
        return depth, {}
    with job.watch("layers"):
        return depth, compose_layers(parameters.output.layers, depth, *scene)


def _write(
    image: ImageToRender,
    depth: NDArray[np.float32],
    layers: dict[str, NDArray[Any]],
    watch: Stopwatch,
) -> None:
    with watch("write"):
        image.files.write(image.index, depth, layers)


def load_frame(
    run: RunFolder,
    trajectory: Trajectory,
    index: int,
    parameters: Parameters,
    watch: Stopwatch | None = None,
) -> Frame:
    """Read a classified sweep of a run and prepare it for rendering.

    Raises
    ------
    RunError
        It has no classes.
    """
    watch = watch or Stopwatch()
    with watch("read"):
        record, classid = run.classified_frame(index)
    with watch("frames"):
        return Frame(
            record.points,
            classid,
            parameters.render,
            record.time_offset,
            run.sensor_rig(record),
            trajectory.velocity(index),
        )
