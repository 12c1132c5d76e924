"""The stages of the paper as verbs, and the video of their result."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from docdepth.cli.options import (
    CameraNames,
    Formats,
    LayerNames,
    RendererName,
    RunPath,
    Scale,
    Settings,
    Threads,
    app,
    changes_of,
    listed,
    out,
    output_of,
    progress_bars,
    reopen,
    replaced,
    show_summary,
)

if TYPE_CHECKING:
    from docdepth.datasets.base import CameraStream, Dataset
    from docdepth.io.run_folder import RunFolder
    from docdepth.render.backends import Renderer


@app.command()
def run(
    dataset: Annotated[Path, typer.Argument(help="A drive: KITTI raw or odometry, or a run.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="RUN", help="Run folder.")],
    name: Annotated[
        str | None, typer.Option("--dataset", help="Layout; guessed if absent.")
    ] = None,
    camera: CameraNames = None,
    poses: Annotated[Path | None, typer.Option(help="LiDAR poses, TUM or KITTI format.")] = None,
    camera_times: Annotated[Path | None, typer.Option(help="Seconds, one image a line.")] = None,
    image_size: Annotated[str | None, typer.Option(metavar="WxH", help="Pixels.")] = None,
    preset: Annotated[str, typer.Option(help="default (measured best) or paper.")] = "default",
    settings: Settings = None,
    format: Formats = None,
    scale: Scale = None,
    layers: LayerNames = None,
    threads: Threads = 0,
    renderer: RendererName = None,
) -> None:
    """From a recorded drive to a depth map for every camera image: all stages.

    The same command goes on where an interrupted run stopped.

      docdepth run 2011_09_26_drive_0005_sync -o run --camera image_02
    """
    from docdepth.config import parameters, parse_settings
    from docdepth.io.run_folder import RunFolder
    from docdepth.pipeline.run_inputs import open_source
    from docdepth.render.backends import choose

    drawn_by = choose(renderer)
    changes = parse_settings(settings or []) | output_of(format, scale, layers)
    values = parameters(preset, changes)  # type: ignore[arg-type]
    source = {
        "dataset": str(dataset.resolve()),
        "name": name,
        "camera": listed(camera),
        "poses": str(poses.resolve()) if poses else None,
        "camera_times": str(camera_times.resolve()) if camera_times else None,
        "image_size": image_size,
    }
    recording, streams = open_source(source)
    folder = RunFolder.create(output, source, values)
    with progress_bars() as progress:
        _run_all(folder, recording, streams, threads, progress, drawn_by)
    show_summary(folder)


@app.command()
def odometry(run: RunPath, settings: Settings = None, threads: Threads = 0) -> None:
    """Poses and deskewed sweeps again, with other parameters."""
    from docdepth.pipeline import run_odometry
    from docdepth.pipeline.run_inputs import open_source, poses_of

    folder = reopen(run, changes_of(settings), "odometry")
    source = folder.manifest["source"]
    recording, _ = open_source(source)
    with progress_bars() as progress:
        run_odometry(folder, recording, poses_of(source, recording), progress, threads)
    show_summary(folder)


@app.command()
def classify(run: RunPath, settings: Settings = None, threads: Threads = 0) -> None:
    """Ground, votes and classes again, with other parameters."""
    from docdepth.pipeline import run_classify

    folder = reopen(run, changes_of(settings), "ground", "dynamics")
    with progress_bars() as progress:
        run_classify(folder, threads, progress)
    show_summary(folder)


@app.command()
def render(
    run: RunPath,
    settings: Settings = None,
    camera: CameraNames = None,
    format: Formats = None,
    scale: Scale = None,
    layers: LayerNames = None,
    pose: Annotated[
        str | None,
        typer.Option(help="Of a virtual camera on the LiDAR: x,y,z[,qx,qy,qz,qw], or a 4x4 file."),
    ] = None,
    K: Annotated[str | None, typer.Option("--K", metavar="FX,FY,CX,CY", help="Its pixels.")] = None,
    size: Annotated[str | None, typer.Option(metavar="WxH", help="Its image.")] = None,
    name: Annotated[str, typer.Option(help="Its folder in depth/.")] = "virtual",
    camera_times: Annotated[
        Path | None, typer.Option(help="When it looks; at each sweep if absent.")
    ] = None,
    threads: Threads = 0,
    renderer: RendererName = None,
) -> None:
    """Depth maps again, with other parameters, formats or cameras; or of a virtual camera.

    docdepth render RUN --pose 0,0,0.5 --K 700,700,640,360 --size 1280x720
    """
    from docdepth.datasets.run import RunDataset
    from docdepth.errors import ConfigError
    from docdepth.pipeline import run_render
    from docdepth.pipeline.run_inputs import open_source
    from docdepth.render.backends import choose

    drawn_by = choose(renderer)
    changes = changes_of(settings) | output_of(format, scale, layers)
    if pose or K or size:
        from docdepth.io.run_folder import RunFolder
        from docdepth.pipeline.virtual_camera import virtual_camera

        if not (pose and K and size) or camera:
            raise ConfigError("a virtual camera needs --pose, --K and --size, and no --camera")
        folder = RunFolder.open(run)
        values = replaced(folder, changes, "render", "output")  # the run itself keeps its own
        stream = virtual_camera(folder, name, pose, K, size, camera_times)
        with progress_bars() as progress:
            run_render(folder, stream, threads, progress, drawn_by, f"render {name}", values)
        return show_summary(folder)
    folder = reopen(run, changes, "render", "output")
    source = folder.manifest["source"]
    if source:
        if camera:
            source["camera"] = listed(camera)
        _, streams = open_source(source)
        folder.save()
    else:
        streams = list(RunDataset(run).cameras.values())
    with progress_bars() as progress:
        run_render(folder, streams, threads, progress, drawn_by)
    show_summary(folder)


@app.command()
def video(
    run: RunPath,
    camera: Annotated[str | None, typer.Option(help="Which, where there are several.")] = None,
    fps: Annotated[
        float | None, typer.Option(min=0.1, help="Images a second; as recorded if absent.")
    ] = None,
) -> None:
    """The images of a run above their depth, as report/video.webm."""
    from docdepth.io.run_folder import RunFolder
    from docdepth.pipeline.run_inputs import stream_of
    from docdepth.visualization.video import write_video

    folder = RunFolder.open(run)
    name = folder.depth_folder(camera)
    with progress_bars() as progress:
        path = write_video(folder, name, stream_of(folder, name), fps, progress)
    out.print(f"{path}", soft_wrap=True, markup=False)


def _run_all(
    folder: RunFolder,
    recording: Dataset,
    streams: list[CameraStream],
    threads: int,
    progress: Any,
    renderer: Renderer,
) -> None:
    from docdepth.pipeline import run_classify, run_odometry, run_render
    from docdepth.pipeline.run_inputs import poses_of

    poses = poses_of(folder.manifest["source"], recording)
    run_odometry(folder, recording, poses, progress, threads)
    run_classify(folder, threads, progress)
    run_render(folder, streams, threads, progress, renderer)
