"""Verbs that run the stages."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from docdepth.cli.options import (
    AllBelow,
    CalibrationFile,
    CameraNames,
    CameraTimes,
    ChosenPreset,
    ConfigFile,
    DatasetName,
    DryRun,
    Force,
    Formats,
    Frames,
    GivenLabels,
    HashInputs,
    ImageSize,
    Jobs,
    Json,
    Keep,
    LayerNames,
    Memory,
    OnError,
    Output,
    PosesFile,
    RendererName,
    RunPath,
    Scale,
    Scheduler,
    Settings,
    Threads,
    VirtualIntrinsics,
    VirtualName,
    VirtualPose,
    VirtualSize,
    VirtualTimes,
    changes_of,
    check_stages,
    listed,
    output_of,
    reopen,
)
from docdepth.cli.progress import progress_bars
from docdepth.cli.status import show_states
from docdepth.cli.summary import show_json, show_summary
from docdepth.cli.terminal import app, out, verb

if TYPE_CHECKING:
    from docdepth.io.run_folder import RunFolder


@verb(app)
def run(
    recording: Annotated[
        Path | None,
        typer.Argument(
            metavar="RECORDING",
            help="A recording (its folder, or a bag), or the folder of a run; that of --config if "
            "absent. A run alone, without -o, is brought up to date.",
            show_default=False,
        ),
    ] = None,
    output: Output = None,
    every: AllBelow = None,
    config: ConfigFile = None,
    dataset: DatasetName = None,
    camera: CameraNames = None,
    frames: Frames = None,
    poses: PosesFile = None,
    camera_times: CameraTimes = None,
    calibration: CalibrationFile = None,
    labels: GivenLabels = None,
    image_size: ImageSize = None,
    preset: ChosenPreset = None,
    settings: Settings = None,
    format: Formats = None,
    scale: Scale = None,
    layers: LayerNames = None,
    threads: Threads = 0,
    jobs: Jobs = 1,
    scheduler: Scheduler = None,
    memory: Memory = None,
    renderer: RendererName = "cpu",
    on_error: OnError = None,
    keep: Keep = None,
    hash_inputs: HashInputs = False,
    force: Force = False,
    dry_run: DryRun = False,
    as_json: Json = False,
) -> None:
    """Turn a recording into a depth map for every camera image: all stages.

    The same command continues a run that was interrupted, and makes again what is missing, damaged
    or out of date.

      docdepth run 2011_09_26_drive_0005_sync -o run --camera image_02
      docdepth run --config run/run.yaml -o again

      docdepth run --all 2011_09_26 -o runs --jobs 8
    """
    from docdepth.cli.config_file import Given, read_config
    from docdepth.config import parameters
    from docdepth.render.backends import Renderer

    how: dict[str, Any] = {"dry_run": dry_run, "threads": threads, "renderer": Renderer(renderer)}
    how |= {"jobs": jobs, "scheduler": scheduler, "keep": keep}
    if output is None:
        chosen = (every, config, dataset, camera, frames, poses, camera_times, calibration, labels,
                  image_size, preset, settings, format, scale, layers, memory,
                  on_error, hash_inputs or None, force or None)  # fmt: skip
        return _show(_continue(recording, chosen, how), dry_run, as_json)
    given = read_config(config) if config else Given()
    inputs = given.inputs(
        recording or every, dataset, listed(camera), poses, camera_times, image_size, frames,
        calibration, labels,
    )  # fmt: skip
    changes = given.settings | changes_of(settings) | output_of(format, scale, layers)
    how["parameters"] = parameters(preset or given.preset, changes)  # type: ignore[arg-type]
    how |= {"memory": memory, "on_error": on_error, "hash_inputs": hash_inputs, "force": force}
    if every is not None:
        return _run_all(recording, output, inputs | how, as_json)
    return _show(_run_one(output, inputs | how), dry_run, as_json)


def _show(folder: RunFolder, dry_run: bool, as_json: bool) -> None:
    return show_states(folder, as_json) if dry_run else show_summary(folder, as_json)


def _run_one(output: Path, options: dict[str, Any]) -> RunFolder:
    """Run one recording."""
    from docdepth.pipeline.run import run

    with progress_bars() as progress:
        return run(options.pop("recording"), output, **options, progress=progress)


def _run_all(recording: Path | None, output: Path, options: dict[str, Any], as_json: bool) -> None:
    """Run every recording of a data set, and list what failed."""
    from docdepth.cli.failures import BUG, MISTAKE, explain
    from docdepth.errors import ConfigError
    from docdepth.pipeline.run_all import run_all

    if recording is not None:
        raise ConfigError("--all names the recordings: leave out RECORDING")
    with progress_bars() as progress:
        ended = run_all(options.pop("recording"), output, **options, progress=progress)
    failed = {one.recording: one.error for one in ended if one.error is not None}
    told = {place: explain(error) for place, error in failed.items()}
    said = {place: str(known.sentence if known else failed[place]) for place, known in told.items()}
    if as_json:
        show_json([{"recording": str(one.recording), "run": str(one.folder),
                    "error": said.get(one.recording)} for one in ended])  # fmt: skip
    else:
        state = "pass all checks" if options["dry_run"] else f"are done; see {output}"
        out.print(f"{len(ended) - len(failed)} of {len(ended)} recordings {state}")
        for recording, sentence in said.items():
            out.print(f"failed: {recording}: {sentence}", soft_wrap=True, markup=False)
    if failed:
        raise typer.Exit(BUG if None in told.values() else MISTAKE)


def _continue(run: Path | None, chosen: tuple[object, ...], how: dict[str, Any]) -> RunFolder:
    """Bring a run up to date by its run.yaml; no option can be chosen."""
    from docdepth.errors import ConfigError
    from docdepth.pipeline.run import continue_run

    if run is None or not (run / "run.yaml").is_file():
        raise ConfigError("no run folder: docdepth run RECORDING -o RUN, or docdepth run RUN")
    if any(option is not None for option in chosen):
        raise ConfigError(
            "a run alone goes on with what run.yaml holds: give no other option, or RECORDING and "
            "-o RUN"
        )
    with progress_bars() as progress:
        return continue_run(run, **how, progress=progress)


@verb(app)
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


@verb(app)
def classify(run: RunPath, settings: Settings = None, threads: Threads = 0) -> None:
    """Repeat ground growing, voting and classification, with other parameters.

    Classes of another method (--labels) are replaced.
    """
    from docdepth.pipeline import run_classify
    from docdepth.pipeline.run_state import require

    folder = reopen(run, changes_of(settings), "ground", "dynamics")
    folder.manifest["source"].pop("labels", None)
    require(folder, "odometry")
    with progress_bars() as progress:
        run_classify(folder, threads, progress)
    show_summary(folder)


@verb(app)
def render(
    run: RunPath,
    settings: Settings = None,
    camera: CameraNames = None,
    format: Formats = None,
    scale: Scale = None,
    layers: LayerNames = None,
    pose: VirtualPose = None,
    K: VirtualIntrinsics = None,
    size: VirtualSize = None,
    name: VirtualName = None,
    camera_times: VirtualTimes = None,
    labels: GivenLabels = None,
    threads: Threads = 0,
    renderer: RendererName = "cpu",
) -> None:
    """Repeat rendering with other parameters, formats or cameras, or for a virtual camera.

    docdepth render RUN --pose 0,0,0.5 --K 700,700,640,360 --size 1280x720
    """
    from docdepth.errors import ConfigError
    from docdepth.pipeline.run import render_again
    from docdepth.pipeline.virtual_camera import virtual_camera
    from docdepth.render.backends import Renderer

    drawn_by = Renderer(renderer)
    changes = changes_of(settings) | output_of(format, scale, layers)
    check_stages(changes, "render", "output")
    described = None
    if pose or K or size or name is not None or camera_times:
        if not (pose and K and size) or camera:
            raise ConfigError(
                "a virtual camera needs --pose, --K and --size, and no --camera; --name and "
                "--camera-times are for it alone"
            )
        described = virtual_camera(pose, K, size, camera_times)
    with progress_bars() as progress:
        folder = render_again(
            run,
            changes,
            listed(camera),
            ("virtual" if name is None else name, described) if described else None,
            labels=labels,
            threads=threads,
            renderer=drawn_by,
            progress=progress,
        )
    show_summary(folder)
