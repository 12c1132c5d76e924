"""Verbs that run the stages."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from docdepth.cli.options import (
    AllBelow,
    CameraNames,
    ChosenPreset,
    ConfigFile,
    Formats,
    GivenLabels,
    Json,
    LayerNames,
    Output,
    RendererName,
    RunPath,
    Scale,
    Settings,
    Threads,
    VirtualIntrinsics,
    VirtualName,
    VirtualPose,
    VirtualSize,
    VirtualTimes,
    changes_of,
    check_stages,
    output_of,
    reopen,
    with_options,
)
from docdepth.cli.progress import progress_bars
from docdepth.cli.status import show_states
from docdepth.cli.summary import show_json, show_summary
from docdepth.cli.terminal import app, out, verb
from docdepth.config import Parameters
from docdepth.errors import ConfigError
from docdepth.io.inputs import RunInputs, names_in
from docdepth.pipeline.execution import Execution

if TYPE_CHECKING:
    from docdepth.io.run_folder import RunFolder


@verb(app)
@with_options(inputs=RunInputs, execution=Execution)
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
    *,
    inputs: dict[str, Any],
    preset: ChosenPreset = None,
    settings: Settings = None,
    format: Formats = None,
    scale: Scale = None,
    layers: LayerNames = None,
    execution: dict[str, Any],
    as_json: Json = False,
) -> None:
    """Turn a recording into a depth map for every camera image: all stages.

    The same command continues a run that was interrupted, and makes again what is missing, damaged
    or out of date.

      docdepth run 2011_09_26_drive_0005_sync -o run --camera image_02
      docdepth run --config run/run.yaml -o again

      docdepth run --all 2011_09_26 -o runs --jobs 8
    """
    from docdepth.cli.config_file import RunConfigFile, read_config
    from docdepth.config import parameters

    how = Execution(**execution)
    if output is None:
        chosen = [every, config, preset, settings, format, scale, layers, how.memory]
        if inputs or how.force or any(option is not None for option in chosen):
            recording = None if recording is None else _refuse_options(recording)
        return _show(_continue(recording, how), as_json, how.dry_run)
    file = read_config(config) if config else RunConfigFile()
    inputs = file.inputs(recording or every, inputs)
    changes = file.settings | changes_of(settings) | output_of(format, scale, layers)
    values = parameters(preset or file.preset, changes)  # type: ignore[arg-type]
    if every is None:
        return _show(_run_one(inputs, output, values, how), as_json, how.dry_run)
    if recording is not None:
        raise ConfigError("--all names the recordings: leave out RECORDING")
    return _run_all(inputs, output, values, how, as_json)


def _show(folder: RunFolder, as_json: bool, dry_run: bool) -> None:
    return show_states(folder, as_json) if dry_run else show_summary(folder, as_json)


def _run_one(
    inputs: dict[str, Any], output: Path, values: Parameters, execution: Execution
) -> RunFolder:
    """Run one recording."""
    from docdepth.pipeline.run import run

    with progress_bars() as progress:
        return run(RunInputs(**inputs), output, values, execution.but(progress=progress))


def _run_all(
    inputs: dict[str, Any], output: Path, values: Parameters, execution: Execution, as_json: bool
) -> None:
    """Run every recording of a data set, and list what failed."""
    from docdepth.cli.failures import BUG, MISTAKE, explain
    from docdepth.pipeline.run_all import run_all

    with progress_bars() as progress:
        ended = run_all(RunInputs(**inputs), output, values, execution.but(progress=progress))
    failed = {one.recording: one.error for one in ended if one.error is not None}
    told = {place: explain(error) for place, error in failed.items()}
    said = {place: str(known.sentence if known else failed[place]) for place, known in told.items()}
    if as_json:
        show_json([{"recording": str(one.recording), "run": str(one.folder),
                    "error": said.get(one.recording)} for one in ended])  # fmt: skip
    else:
        state = "pass all checks" if execution.dry_run else f"are done; see {output}"
        out.print(f"{len(ended) - len(failed)} of {len(ended)} recordings {state}")
        for recording, sentence in said.items():
            out.print(f"failed: {recording}: {sentence}", soft_wrap=True, markup=False)
    if failed:
        raise typer.Exit(BUG if None in told.values() else MISTAKE)


def _refuse_options(run: Path) -> Path:
    if (run / "run.yaml").is_file():
        raise ConfigError(
            "a run alone goes on with what run.yaml holds: give no other option, or RECORDING and "
            "-o RUN"
        )
    return run


def _continue(run: Path | None, execution: Execution) -> RunFolder:
    """Bring a run up to date by its run.yaml."""
    from docdepth.pipeline.run import continue_run

    if run is None or not (run / "run.yaml").is_file():
        raise ConfigError("no run folder: docdepth run RECORDING -o RUN, or docdepth run RUN")
    with progress_bars() as progress:
        return continue_run(run, execution.but(progress=progress))


@verb(app)
def odometry(run: RunPath, settings: Settings = None, threads: Threads = 0) -> None:
    """Repeat odometry and deskewing, with other parameters."""
    from docdepth.pipeline import run_odometry
    from docdepth.pipeline.run_inputs import known_poses, open_recording

    folder = reopen(run, changes_of(settings), "odometry")
    recording = open_recording(folder.inputs, folder.manifest.derived)
    with progress_bars() as progress:
        run_odometry(folder, recording, known_poses(folder.inputs, recording), progress, threads)
    show_summary(folder)


@verb(app)
def classify(run: RunPath, settings: Settings = None, threads: Threads = 0) -> None:
    """Repeat ground growing, voting and classification, with other parameters.

    Classes of another method (--labels) are replaced.
    """
    from docdepth.pipeline import run_classify
    from docdepth.pipeline.plan import require

    folder = reopen(run, changes_of(settings), "ground", "dynamics")
    if folder.manifest.inputs is not None:
        folder.manifest.inputs = folder.manifest.inputs.but(labels=None)
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
            names_in(camera),
            ("virtual" if name is None else name, described) if described else None,
            labels=labels,
            threads=threads,
            renderer=drawn_by,
            progress=progress,
        )
    show_summary(folder)
