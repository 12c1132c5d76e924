"""A whole run: every stage, from a recording to depth maps."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from docdepth.config import Parameters
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline.classify import run_classify
from docdepth.pipeline.odometry import run_odometry
from docdepth.pipeline.render import run_render
from docdepth.pipeline.run_inputs import known_poses, open_inputs
from docdepth.pipeline.stage import Progress
from docdepth.render.backends import Renderer


def run(
    dataset: Path | str,
    output: Path | str,
    parameters: Parameters | None = None,
    *,
    layout: str | None = None,
    camera: str | Sequence[str] | None = None,
    poses: Path | str | None = None,
    camera_times: Path | str | None = None,
    image_size: str | None = None,
    frames: str | None = None,
    threads: int = 0,
    renderer: Renderer | None = None,
    progress: Progress | None = None,
) -> RunFolder:
    """Turn a recording into depth maps: odometry, ground, dynamics, rendering.

    The same call continues a run that was interrupted.

    Parameters
    ----------
    dataset : Path
        Folder of the recording.
    output : Path
        Run folder; it is created, or continued if it holds the same run.
    parameters : Parameters, optional
        Of all stages, from :func:`docdepth.parameters`.
    layout : str, optional
        Layout of the recording; guessed if absent.
    camera : str or sequence of str, optional
        Cameras to render, or ``all``; the left colour camera if absent.
    poses : Path, optional
        LiDAR poses ``T_world_lidar`` in TUM or KITTI format; estimated if absent.
    camera_times : Path, optional
        Image times in seconds, one a line; those of the recording if absent.
    image_size : str, optional
        ``WIDTHxHEIGHT`` in pixels, for recordings that do not tell it.
    frames : str, optional
        ``A:B``: sweeps A to B-1 only.
    threads : int
        0 takes every core. The result does not depend on it.
    renderer : Renderer, optional
        Draws the depth maps; the CPU if absent. All draw the same.
    progress : callable, optional
        ``progress(stage, done, total)``.

    Returns
    -------
    RunFolder

    Raises
    ------
    DocDepthError
        An input is missing or damaged, or the folder holds another run.
    """
    inputs: dict[str, Any] = {
        "dataset": _absolute(dataset),
        "name": layout,
        "camera": camera if camera is None or isinstance(camera, str) else list(camera),
        "poses": _absolute(poses),
        "camera_times": _absolute(camera_times),
        "image_size": image_size,
    }
    recording, cameras = open_inputs(inputs)
    folder = RunFolder.create(Path(output), inputs, parameters or Parameters())
    run_odometry(folder, recording, known_poses(inputs, recording), progress, threads)
    run_classify(folder, threads, progress)
    run_render(folder, cameras, threads, progress, renderer)
    return folder


def _absolute(path: Path | str | None) -> str | None:
    return None if path is None else str(Path(path).resolve())
