"""Verbs that run the stages, and the video of their result."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

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
    check_stages,
    listed,
    out,
    output_of,
    progress_bars,
    reopen,
    show_summary,
)


@app.command()
def run(
    dataset: Annotated[
        Path, typer.Argument(help="Folder of a recording (KITTI raw, KITTI odometry) or of a run.")
    ],
    output: Annotated[
        Path,
        typer.Option("-o", "--output", metavar="RUN", help="Run folder to create or continue."),
    ],
    layout: Annotated[
        str | None,
        typer.Option(
            "--dataset",
            metavar="LAYOUT",
            help="kitti_raw, kitti_odometry, semantic_kitti or run; guessed if absent.",
        ),
    ] = None,
    camera: CameraNames = None,
    poses: Annotated[
        Path | None, typer.Option(help="LiDAR poses of your SLAM, TUM or KITTI format.")
    ] = None,
    camera_times: Annotated[
        Path | None, typer.Option(help="Image times in seconds, one a line.")
    ] = None,
    image_size: Annotated[
        str | None, typer.Option(metavar="WxH", help="Image size in pixels.")
    ] = None,
    preset: Annotated[
        str, typer.Option(help="default (most accurate) or paper (the paper's method).")
    ] = "default",
    settings: Settings = None,
    format: Formats = None,
    scale: Scale = None,
    layers: LayerNames = None,
    threads: Threads = 0,
    renderer: RendererName = None,
) -> None:
    """Turn a recording into a depth map for every camera image: all stages.

    The same command continues a run that was interrupted.

      docdepth run 2011_09_26_drive_0005_sync -o run --camera image_02
    """
    from docdepth.config import parameters, parse_settings
    from docdepth.pipeline.run import run as run_all
    from docdepth.render.backends import choose

    drawn_by = choose(renderer)
    changes = parse_settings(settings or []) | output_of(format, scale, layers)
    with progress_bars() as progress:
        folder = run_all(
            dataset,
            output,
            parameters(preset, changes),  # type: ignore[arg-type]
            layout=layout,
            camera=listed(camera),
            poses=poses,
            camera_times=camera_times,
            image_size=image_size,
            threads=threads,
            renderer=drawn_by,
            progress=progress,
        )
    show_summary(folder)


@app.command()
def odometry(run: RunPath, settings: Settings = None, threads: Threads = 0) -> None:
    """Repeat odometry and deskewing, with other parameters."""
    from docdepth.pipeline import run_odometry
    from docdepth.pipeline.run_inputs import known_poses, open_recording

    folder = reopen(run, changes_of(settings), "odometry")
    source = folder.manifest["source"]
    recording = open_recording(source)
    with progress_bars() as progress:
        run_odometry(folder, recording, known_poses(source, recording), progress, threads)
    show_summary(folder)


@app.command()
def classify(run: RunPath, settings: Settings = None, threads: Threads = 0) -> None:
    """Repeat ground growing, voting and classification, with other parameters."""
    from docdepth.pipeline import run_classify
    from docdepth.pipeline.run import require

    folder = reopen(run, changes_of(settings), "ground", "dynamics")
    require(folder, "odometry")
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
        typer.Option(help="Virtual camera in the LiDAR frame: x,y,z[,qx,qy,qz,qw] or a 4x4 file."),
    ] = None,
    K: Annotated[
        str | None, typer.Option("--K", metavar="FX,FY,CX,CY", help="Its intrinsics.")
    ] = None,
    size: Annotated[str | None, typer.Option(metavar="WxH", help="Its image size.")] = None,
    name: Annotated[str, typer.Option(help="Its name: maps go to depth/NAME.")] = "virtual",
    camera_times: Annotated[
        Path | None, typer.Option(help="Its image times; the sweeps' if absent.")
    ] = None,
    threads: Threads = 0,
    renderer: RendererName = None,
) -> None:
    """Repeat rendering with other parameters, formats or cameras, or for a virtual camera.

    docdepth render RUN --pose 0,0,0.5 --K 700,700,640,360 --size 1280x720
    """
    from docdepth.errors import ConfigError
    from docdepth.pipeline.run import render_again
    from docdepth.pipeline.virtual_camera import virtual_camera
    from docdepth.render.backends import choose

    drawn_by = choose(renderer)
    changes = changes_of(settings) | output_of(format, scale, layers)
    check_stages(changes, "render", "output")
    described = None
    if pose or K or size:
        if not (pose and K and size) or camera:
            raise ConfigError("a virtual camera needs --pose, --K and --size, and no --camera")
        described = virtual_camera(pose, K, size, camera_times)
    with progress_bars() as progress:
        folder = render_again(
            run,
            changes,
            listed(camera),
            (name, described) if described else None,
            threads=threads,
            renderer=drawn_by,
            progress=progress,
        )
    show_summary(folder)


@app.command()
def video(
    run: RunPath,
    camera: Annotated[
        str | None, typer.Option(help="Camera; needed where there are several.")
    ] = None,
    fps: Annotated[
        float | None, typer.Option(min=0.1, help="Images per second; as recorded if absent.")
    ] = None,
) -> None:
    """Write report/video.webm: each image above its depth map."""
    from docdepth.io.run_folder import RunFolder
    from docdepth.pipeline.run import require
    from docdepth.pipeline.run_inputs import recorded_camera
    from docdepth.visualization.video import write_video

    folder = RunFolder.open(run)
    name = folder.depth_folder(camera)
    require(folder, f"render {folder.camera_in(name)}")
    with progress_bars() as progress:
        path = write_video(folder, name, recorded_camera(folder, name), fps, progress)
    out.print(f"{path}", soft_wrap=True, markup=False)


@app.command()
def view(
    run: RunPath,
    frame: Annotated[
        int | None, typer.Option(min=0, help="Index of the sweep; the middle one if absent.")
    ] = None,
    camera: Annotated[
        str | None, typer.Option(help="Camera; needed where there are several.")
    ] = None,
    around: Annotated[int, typer.Option(min=0, help="Sweeps before and after to add.")] = 0,
    image: Annotated[
        Path | None, typer.Option(help="Write a PNG instead of opening a window.")
    ] = None,
) -> None:
    """Look at a sweep's labels, the trajectory and a depth map in 3-D (Open3D)."""
    from docdepth.visualization.viewer import view_run

    view_run(run, frame, camera, around, image=image)
