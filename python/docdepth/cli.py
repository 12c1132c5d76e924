"""The command line: each verb is a stage of the paper, or a question about its result."""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.logging import RichHandler
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from docdepth.errors import DocDepthError

if TYPE_CHECKING:
    from docdepth.backends import Renderer
    from docdepth.config import Parameters
    from docdepth.datasets.base import CameraStream, Dataset
    from docdepth.io.run_folder import RunFolder

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Dense, metric depth maps for camera images from LiDAR recordings (DOC-Depth).",
)
evaluate = typer.Typer(no_args_is_help=True, help="Compare a run with the truth.")
app.add_typer(evaluate, name="evaluate")
out = Console(highlight=False)
err = Console(stderr=True, highlight=False)

RunPath = Annotated[Path, typer.Argument(metavar="RUN", help="A run folder.")]
Settings = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="STAGE.NAME=VALUE", help="Replace one parameter."),
]
Threads = Annotated[int, typer.Option(min=0, help="Threads; 0 takes every core.")]
RendererName = Annotated[
    str | None,
    typer.Option(
        "--renderer",
        metavar="NAME",
        help="auto (a graphics card, else cpu), cpu, egl, egl:N, surfaceless or osmesa; "
        "DOCDEPTH_RENDERER, else auto, if absent.",
    ),
]
CameraNames = Annotated[
    list[str] | None,
    typer.Option(
        "--camera", metavar="NAME", help="Cameras, one or several, or all; image_02 if absent."
    ),
]
Formats = Annotated[
    list[str] | None,
    typer.Option(
        "--format", metavar="NAME", help="png (default), exr, exr-half, tiff, npz, npy; several."
    ),
]
Scale = Annotated[float | None, typer.Option(help="Steps of a PNG a metre; 256 (KITTI) if absent.")]
LayerNames = Annotated[
    list[str] | None,
    typer.Option(
        "--layers",
        metavar="NAME",
        help="Also write class, time, range, support, std, normal, confidence.",
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON.")]


@app.callback(invoke_without_command=True)
def options(
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Log what is done.")] = False,
) -> None:
    """Set up what every verb shares."""
    logging.basicConfig(
        level=logging.INFO if verbose else logging.WARNING,
        format="%(message)s",
        handlers=[RichHandler(console=err, show_time=False, show_path=False)],
    )
    if version:
        from docdepth import __version__

        out.print(__version__)
        raise typer.Exit


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
    from docdepth.backends import choose
    from docdepth.config import parameters, parse_settings
    from docdepth.io.run_folder import RunFolder
    from docdepth.sources import open_source

    drawn_by = choose(renderer)
    changes = parse_settings(settings or []) | _output(format, scale, layers)
    values = parameters(preset, changes)  # type: ignore[arg-type]
    source = {
        "dataset": str(dataset.resolve()),
        "name": name,
        "camera": _listed(camera),
        "poses": str(poses.resolve()) if poses else None,
        "camera_times": str(camera_times.resolve()) if camera_times else None,
        "image_size": image_size,
    }
    recording, streams = open_source(source)
    folder = RunFolder.create(output, source, values)
    with _progress() as progress:
        _stages(folder, recording, streams, threads, progress, drawn_by)
    _summary(folder)


@app.command()
def odometry(run: RunPath, settings: Settings = None) -> None:
    """Poses and deskewed sweeps again, with other parameters."""
    from docdepth.pipeline import run_odometry
    from docdepth.sources import open_source, poses_of

    folder = _reopen(run, _changes(settings), "odometry")
    source = folder.manifest["source"]
    recording, _ = open_source(source)
    with _progress() as progress:
        run_odometry(folder, recording, poses_of(source, recording), progress)
    _summary(folder)


@app.command()
def classify(run: RunPath, settings: Settings = None, threads: Threads = 0) -> None:
    """Ground, votes and classes again, with other parameters."""
    from docdepth.pipeline import run_classify

    folder = _reopen(run, _changes(settings), "ground", "surface", "dynamics")
    with _progress() as progress:
        run_classify(folder, threads, progress)
    _summary(folder)


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
    from docdepth.backends import choose
    from docdepth.datasets.run import RunDataset
    from docdepth.errors import ConfigError
    from docdepth.pipeline import run_render
    from docdepth.sources import open_source

    drawn_by = choose(renderer)
    changes = _changes(settings) | _output(format, scale, layers)
    if pose or K or size:
        from docdepth.io.run_folder import RunFolder
        from docdepth.virtual import virtual_camera

        if not (pose and K and size) or camera:
            raise ConfigError("a virtual camera needs --pose, --K and --size, and no --camera")
        folder = RunFolder.open(run)
        values = _replaced(folder, changes, "render", "output")  # the run itself keeps its own
        stream = virtual_camera(folder, name, pose, K, size, camera_times)
        with _progress() as progress:
            run_render(folder, stream, threads, progress, drawn_by, f"render {name}", values)
        return _summary(folder)
    folder = _reopen(run, changes, "render", "output")
    source = folder.manifest["source"]
    if source:
        if camera:
            source["camera"] = _listed(camera)
        _, streams = open_source(source)
        folder.save()
    else:
        streams = list(RunDataset(run).cameras.values())
    with _progress() as progress:
        run_render(folder, streams, threads, progress, drawn_by)
    _summary(folder)


@app.command()
def video(
    run: RunPath,
    camera: Annotated[str | None, typer.Option(help="Which, where there are several.")] = None,
    fps: Annotated[
        float | None, typer.Option(min=0.1, help="Images a second; as recorded if absent.")
    ] = None,
) -> None:
    """The images of a run above their depth, as report/video.mp4."""
    from docdepth.io.run_folder import RunFolder
    from docdepth.sources import stream_of
    from docdepth.video import write_video

    folder = RunFolder.open(run)
    name = folder.depth_folder(camera)
    with _progress() as progress:
        path = write_video(folder, name, stream_of(folder, name), fps, progress)
    out.print(f"{path}", soft_wrap=True, markup=False)


@app.command()
def synth(
    output: Annotated[Path, typer.Argument(metavar="OUT", help="Folder for the drive.")],
    scene: Annotated[str, typer.Option(help="Kind of street.")] = "city",
    sensor: Annotated[str, typer.Option(help="Kind of LiDAR.")] = "HDL-64",
    frames: Annotated[int, typer.Option(min=2, help="Number of sweeps.")] = 60,
    seed: Annotated[int, typer.Option(min=0, help="Another seed, another street.")] = 0,
    skew: Annotated[bool, typer.Option(help="Write raw sweeps, not motion compensated.")] = False,
) -> None:
    """A synthetic drive with exact labels, poses and depth, in SemanticKITTI layout."""
    from docdepth.synthetic import write_drive

    with _progress() as progress:
        write_drive(
            output, scene=scene, sensor=sensor, frames=frames, seed=seed, skew=skew,
            progress=lambda done, total: progress("synth", done, total),
        )  # fmt: skip
    out.print(f"{frames} sweeps in {output}")


@app.command()
def demo(
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder.")] = Path("demo"),
    frames: Annotated[int, typer.Option(min=3, help="Sweeps of the synthetic drive.")] = 40,
    preset: Annotated[str, typer.Option(help="default (measured best) or paper.")] = "default",
    threads: Threads = 0,
) -> None:
    """A synthetic drive, its depth maps and pictures, and how true they are."""
    from docdepth.demo import demo as make
    from docdepth.io.run_folder import RunFolder

    with _progress() as progress:
        sequence, folder = make(output, preset, frames, threads, progress)  # type: ignore[arg-type]
    _summary(RunFolder(folder))
    labels(folder, sequence)
    depth(folder, sequence)
    out.print(f"look at the pictures in {folder / 'report'}")


@app.command()
def sweep(
    run: RunPath,
    truth: Annotated[Path, typer.Option("--labels", help="Folder of SemanticKITTI labels.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="OUT", help="Results.")],
    vary: Annotated[
        list[str] | None,
        typer.Option(metavar="STAGE.NAME=A,B,C", help="Values to combine with all others."),
    ] = None,
    trials: Annotated[
        Path | None, typer.Option(help="YAML, a line a trial: NAME: {stage.name: value}.")
    ] = None,
    jobs: Annotated[int, typer.Option(min=1, help="Trials at a time.")] = 1,
    threads: Threads = 0,
) -> None:
    """Classify a run with many parameter sets: a table, CSV and a plot.

    The same command goes on where an interrupted sweep stopped.

      docdepth sweep RUN --labels DRIVE -o out --vary dynamics.tolerance=0.1,0.2,0.4
    """
    from docdepth.errors import ConfigError, MissingExtraError
    from docdepth.sweep import grid, parse_axes, plot, read_trials, table
    from docdepth.sweep import sweep as work

    if bool(vary) == bool(trials):
        raise ConfigError("say what to vary: --vary STAGE.NAME=A,B or --trials FILE")
    sets = read_trials(trials) if trials else grid(parse_axes(vary or []))
    with _progress() as progress:
        outcomes = work(
            run, truth, sets, output, jobs, threads,
            lambda done, total: progress("trials", done, total),
        )  # fmt: skip
    out.print(str(table(outcomes)), soft_wrap=True, markup=False)
    try:
        plot(outcomes, output / "sweep.png")
    except MissingExtraError as error:
        out.print(f"no plot: {error}", markup=False)


@app.command()
def doctor() -> None:
    """What this installation can do, and why it cannot do the rest."""
    from docdepth.doctor import doctor as examine

    for name, finding, well in examine():
        out.print(f"{'ok' if well else '--'}  {name:<24} {finding}", markup=False)


@evaluate.command()
def labels(
    run: RunPath,
    truth: Annotated[Path, typer.Option("--labels", help="Folder of SemanticKITTI labels.")],
    as_json: Json = False,
) -> None:
    """SA, DA, F1, precision and IoU of the dynamic class, point by point."""
    from docdepth.evaluation.runs import evaluate_labels

    _show(evaluate_labels(run, truth), as_json)


@evaluate.command()
def depth(
    run: RunPath,
    truth: Annotated[Path, typer.Option("--depth", help="Folder of true depth maps.")],
    mode: Annotated[str, typer.Option(help="valid, or kitti: empty pixels filled.")] = "valid",
    max_range: Annotated[float, typer.Option(help="Farther pixels are not compared [m].")] = 80.0,
    camera: Annotated[str | None, typer.Option(help="Which, where there are several.")] = None,
    as_json: Json = False,
) -> None:
    """MAE, RMSE, density, and pixels too near and too far."""
    from docdepth.evaluation.runs import evaluate_depth

    _show(evaluate_depth(run, truth, mode, max_range, camera), as_json)  # type: ignore[arg-type]


def _show(result: Any, as_json: bool) -> None:
    text = json.dumps(result.as_dict(), indent=1) if as_json else str(result.table())
    out.print(text, soft_wrap=True, markup=False)


@contextmanager
def _progress() -> Iterator[Any]:
    """A bar a stage, with the time left."""
    columns = (
        TextColumn("{task.description:<12}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(elapsed_when_finished=True),
    )
    with Progress(*columns, console=err) as bars:
        tasks: dict[str, Any] = {}

        def tell(stage: str, done: int, total: int) -> None:
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=total)
            bars.update(tasks[stage], completed=done, total=total)

        yield tell


def _stages(
    folder: RunFolder,
    recording: Dataset,
    streams: list[CameraStream],
    threads: int,
    progress: Any,
    renderer: Renderer,
) -> None:
    from docdepth.pipeline import run_classify, run_odometry, run_render
    from docdepth.sources import poses_of

    run_odometry(folder, recording, poses_of(folder.manifest["source"], recording), progress)
    run_classify(folder, threads, progress)
    run_render(folder, streams, threads, progress, renderer)


def _listed(names: list[str] | None) -> str | list[str] | None:
    """Names given one by one or with commas; one alone as itself."""
    every = [name for text in names or [] for name in text.split(",")]
    return every[0] if len(every) == 1 else every or None


def _changes(settings: list[str] | None) -> dict[str, Any]:
    from docdepth.config import parse_settings

    return parse_settings(settings or [])


def _output(
    format: list[str] | None, scale: float | None, layers: list[str] | None
) -> dict[str, Any]:
    """Options that stand for settings."""
    chosen: dict[str, Any] = {}
    if format:
        chosen["output.format"] = ",".join(format)
    if scale is not None:
        chosen["output.scale"] = scale
    if layers:
        chosen["output.layers"] = ",".join(layers)
    return chosen


def _reopen(path: Path, changes: dict[str, Any], *stages: str) -> RunFolder:
    """A run with some parameters of one stage replaced."""
    from docdepth.io.run_folder import RunFolder

    folder = RunFolder.open(path)
    values = _replaced(folder, changes, *stages)
    folder.manifest["parameters"] = values.model_dump(mode="json")
    folder.save()
    return folder


def _replaced(folder: RunFolder, changes: dict[str, Any], *stages: str) -> Parameters:
    """The parameters of a run with some replaced."""
    from docdepth.config import parameters
    from docdepth.errors import ConfigError

    for name in changes:
        if name.partition(".")[0] not in stages:
            raise ConfigError(f"--set {name}: this stage knows {' and '.join(stages)} only")
    saved = {
        f"{stage}.{key}": value
        for stage, values in folder.parameters.model_dump().items()
        if stage != "preset"
        for key, value in values.items()
    }
    return parameters(folder.parameters.preset, {**saved, **changes})


def _summary(folder: RunFolder) -> None:
    """Seconds by stage, density and what was left out."""
    table = Table("stage", "frames", "seconds", "ms a frame", "where the time went", box=None)
    for name, state in folder.manifest["stages"].items():
        seconds: dict[str, float] = state.get("seconds", {})
        total, frames = state.get("wall_seconds", 0.0), state.get("frames", 0)
        parts = ", ".join(f"{k} {v:.1f}" for k, v in sorted(seconds.items(), key=lambda x: -x[1]))
        each = f"{1000 * total / frames:.0f}" if frames else ""
        table.add_row(name, str(frames), f"{total:.1f}", each, parts)
    out.print(table)
    rendered = folder.stage("render")
    if "density" in rendered:
        out.print(f"density {100 * rendered['density']:.1f} % of the pixels", style="bold")
    if rendered.get("left_out"):
        names = ", ".join(rendered["left_out"])
        out.print(f"{len(rendered['left_out'])} images outside the sweeps left out: {names}")
    peak = max((s.get("peak_memory_mb", 0) for s in folder.manifest["stages"].values()), default=0)
    out.print(f"peak memory {peak} MB; results in {folder.path}")


def main() -> None:
    """Entry point: one clear sentence and exit code 2 for a user's mistake."""
    try:
        app()
    except DocDepthError as error:
        err.print("error:", style="red", end=" ")
        err.print(str(error), soft_wrap=True, markup=False)
        sys.exit(2)
