"""Verbs that show a run: a map, a video, and a view in three dimensions."""

from __future__ import annotations

import os
from pathlib import Path
from tempfile import gettempdir
from typing import Annotated, get_args

from docdepth.cli.options import OneCamera, RunPath, one_of, option, verb
from docdepth.cli.progress import progress_bars
from docdepth.cli.terminal import say, volume
from docdepth.errors import ConfigError
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline import cloud_map
from docdepth.pipeline.plan import require
from docdepth.pipeline.run_inputs import cameras_at_hand, recorded_camera
from docdepth.visualization.drive_scene import Coloring
from docdepth.visualization.rerun_recording import write_rerun
from docdepth.visualization.video import write_video, write_video_from_above
from docdepth.visualization.viewer import RunView

COLORINGS: tuple[str, ...] = get_args(Coloring)


@verb(name="map")
def write_map(
    run: RunPath,
    voxel: Annotated[
        float,
        option("One point for each cube with sides of M metres.", "M", min=0.01, max=10),
    ] = 0.1,
) -> None:
    """Write map/map.ply, the static cloud of the drive, and map/objects, what moves.

    Each object is gathered along its track, in the frame of its box.
    """
    with progress_bars() as progress:
        path = cloud_map.write_map(RunFolder.open(run), voxel, progress)
    say(str(path))


@verb()
def video(
    run: RunPath,
    camera: OneCamera = None,
    fps: Annotated[
        float | None,
        option("Images per second, 1 to 1000; the recorded rate if absent.", "N", min=1, max=1000),
    ] = None,
    above: Annotated[
        bool,
        option(
            "Write report/above.webm: each sweep from above, with classes and tracks.",
            flags="--above",
        ),
    ] = False,
    mp4: Annotated[
        bool,
        option("H.264 in an .mp4, which phones and PowerPoint play.", flags="--mp4"),
    ] = False,
) -> None:
    """Write report/video.webm: each image above its depth map; or the sweeps from above."""
    folder = RunFolder.open(run)
    if above and camera is not None:
        raise ConfigError("from above every camera sees the same; leave --camera out")
    name = "" if above else folder.depth_folder(camera)
    require(folder, "classify" if above else f"render {folder.camera_in(name)}")
    with progress_bars() as progress:
        if above:
            path = write_video_from_above(folder, fps, mp4, progress)
        else:
            stream = recorded_camera(folder, name)
            path = write_video(folder, name, stream, fps, mp4, progress)
    say(str(path))


@verb()
def view(
    run: RunPath,
    frame: Annotated[
        int | None,
        option("Sweep to show, counted from 0; the middle one if absent.", "N", min=0),
    ] = None,
    camera: OneCamera = None,
    around: Annotated[
        int, option("Show the static points of N sweeps before and after as well.", "N", min=0)
    ] = 0,
    image: Annotated[
        Path | None,
        option("Write the view to this file instead of opening a window.", "FILE.png"),
    ] = None,
    color: Annotated[
        str,
        option(f"What the colours of points say: {', '.join(COLORINGS)}.", **one_of(COLORINGS)),
    ] = "class",
    rerun: Annotated[
        Path | None,
        option(
            "Write every sweep, track, image and depth map to this file for the viewer rerun.",
            "FILE.rrd",
        ),
    ] = None,
) -> None:
    """Look at a sweep, tracks, the trajectory, an image and its depth in 3-D (Open3D).

    Keys: right and left go to the next sweep and back, page down and page up by ten, C colours by
    class, votes or instance, D hides the depth map; H lists those of Open3D.
    """
    folder = RunFolder.open(run)
    require(folder, "classify")
    streams = cameras_at_hand(folder)
    stream = streams.get(folder.camera_in(folder.depth_folder(camera))) if streams else None
    if rerun is not None:
        if frame is not None or around or image is not None:
            raise ConfigError("--rerun writes every sweep; leave --frame, --around and --image out")
        with progress_bars() as progress:
            write_rerun(folder, rerun, camera, color, stream, progress)  # type: ignore[arg-type]
        return say(str(rerun))
    tell = None
    if image is not None:  # libwayland prints an "error" without it, and draws all the same
        os.environ.setdefault("XDG_RUNTIME_DIR", gettempdir())
    elif not volume.quiet:
        say("keys: right, left, page down, page up: sweep; C: colours; D: depth map; Q: end")
        tell = say
    RunView(folder, frame, camera, around, True, color, stream, tell).show(image)  # type: ignore[arg-type]
    if image is not None:
        say(str(image))
