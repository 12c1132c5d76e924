"""Verbs that show a run: its report, a video, and a view in three dimensions."""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path
from tempfile import gettempdir
from typing import Annotated

import typer

from docdepth.cli.names import COLORINGS, one_of
from docdepth.cli.options import OneCamera, RunPath
from docdepth.cli.progress import progress_bars
from docdepth.cli.terminal import app, out, verb, volume


@verb(app)
def report(run: RunPath) -> None:
    """Write report/index.html anew: the whole run on one page, for any browser.

    The drive from above with what moves, images with depth, classes and layers, density, held-out
    errors, time, warnings and parameters. Every run ends with it.
    """
    from docdepth.io.run_folder import RunFolder
    from docdepth.pipeline.render import report as write

    out.print(f"{write(RunFolder.open(run))}", soft_wrap=True, markup=False)


@verb(app, name="map")
def write_map(
    run: RunPath,
    voxel: Annotated[
        float,
        typer.Option(
            min=0.01, max=10, metavar="M", help="One point for each cube with sides of M metres."
        ),
    ] = 0.1,
) -> None:
    """Write map/map.ply, the static cloud of the drive, and map/objects, what moves.

    Each object is gathered along its track, in the frame of its box.
    """
    from docdepth.io.run_folder import RunFolder
    from docdepth.pipeline.cloud_map import write_map as write

    with progress_bars() as progress:
        path = write(RunFolder.open(run), voxel, progress)
    out.print(f"{path}", soft_wrap=True, markup=False)


@verb(app)
def video(
    run: RunPath,
    camera: OneCamera = None,
    fps: Annotated[
        float | None,
        typer.Option(
            min=1,
            max=1000,
            metavar="N",
            help="Images per second, 1 to 1000; the recorded rate if absent.",
        ),
    ] = None,
    above: Annotated[
        bool,
        typer.Option(
            "--above",
            help="Write report/above.webm: each sweep from above, with classes and tracks.",
        ),
    ] = False,
) -> None:
    """Write report/video.webm: each image above its depth map; or the sweeps from above."""
    from docdepth.errors import ConfigError
    from docdepth.io.run_folder import RunFolder
    from docdepth.pipeline.plan import require
    from docdepth.pipeline.run_cameras import recorded_camera
    from docdepth.visualization.video import write_video, write_video_from_above

    folder = RunFolder.open(run)
    if above:
        if camera is not None:
            raise ConfigError("from above every camera sees the same; leave --camera out")
        require(folder, "classify")
        with progress_bars() as progress:
            path = write_video_from_above(folder, fps, progress)
        return out.print(f"{path}", soft_wrap=True, markup=False)
    name = folder.depth_folder(camera)
    require(folder, f"render {folder.camera_in(name)}")
    with progress_bars() as progress:
        path = write_video(folder, name, recorded_camera(folder, name), fps, progress)
    out.print(f"{path}", soft_wrap=True, markup=False)


@verb(app)
def view(
    run: RunPath,
    frame: Annotated[
        int | None,
        typer.Option(
            min=0, metavar="N", help="Sweep to show, counted from 0; the middle one if absent."
        ),
    ] = None,
    camera: OneCamera = None,
    around: Annotated[
        int,
        typer.Option(
            min=0, metavar="N", help="Show the static points of N sweeps before and after as well."
        ),
    ] = 0,
    image: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.png", help="Write the view to this file instead of opening a window."
        ),
    ] = None,
    color: Annotated[
        str,
        typer.Option(
            help=f"What the colours of points say: {', '.join(COLORINGS)}.", **one_of(COLORINGS)
        ),
    ] = "class",
    rerun: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.rrd",
            help="Write every sweep, track, image and depth map to this file for the viewer rerun.",
        ),
    ] = None,
) -> None:
    """Look at a sweep, tracks, the trajectory, an image and its depth in 3-D (Open3D).

    Keys: right and left go to the next sweep and back, page down and page up by ten, C colours by
    class, votes or instance, D hides the depth map; H lists those of Open3D.
    """
    from docdepth.errors import ConfigError
    from docdepth.io.run_folder import RunFolder
    from docdepth.pipeline.plan import require
    from docdepth.pipeline.run_cameras import cameras_at_hand
    from docdepth.visualization.rerun_recording import write_rerun
    from docdepth.visualization.viewer import RunView

    folder = RunFolder.open(run)
    require(folder, "classify")
    streams = cameras_at_hand(folder)
    stream = streams.get(folder.camera_in(folder.depth_folder(camera))) if streams else None
    if rerun is not None:
        if frame is not None or around or image is not None:
            raise ConfigError("--rerun writes every sweep; leave --frame, --around and --image out")
        with progress_bars() as progress:
            write_rerun(folder, rerun, camera, color, stream, progress)  # type: ignore[arg-type]
        return out.print(f"{rerun}", soft_wrap=True, markup=False)
    tell = None
    if image is not None:  # libwayland prints an "error" without it, and draws all the same
        os.environ.setdefault("XDG_RUNTIME_DIR", gettempdir())
    elif not volume.quiet:
        out.print("keys: right, left, page down, page up: sweep; C: colours; D: depth map; Q: end")
        tell = partial(out.print, soft_wrap=True, markup=False)
    RunView(folder, frame, camera, around, True, color, stream, tell).show(image)  # type: ignore[arg-type]
    if image is not None:
        out.print(f"{image}", soft_wrap=True, markup=False)
