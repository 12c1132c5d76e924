"""Verbs that make a run, and draw it again."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from docdepth.cli.config_file import RunConfigFile, read_config
from docdepth.cli.failures import BUG, MISTAKE, explain
from docdepth.cli.options import (
    PRESETS,
    Formats,
    Json,
    LayerNames,
    RunPath,
    Scale,
    Settings,
    Threads,
    changes,
    check_stages,
    one_of,
    option,
    option_of,
    verb,
)
from docdepth.cli.progress import progress_bars
from docdepth.cli.status import show_states, show_summary
from docdepth.cli.terminal import out, say, show_json
from docdepth.config import Parameters, parameters
from docdepth.errors import ConfigError
from docdepth.io.inputs import RunInputs, names_in
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline.cameras import virtual_camera
from docdepth.pipeline.execution import Execution
from docdepth.pipeline.render_again import render_again
from docdepth.pipeline.run import continue_run, run_stages
from docdepth.pipeline.run_all import run_all
from docdepth.render.backends import Renderer

_COMMON = (
    *("output", "camera", "frames", "poses", "calibration"),
    *("settings", "layers", "format", "jobs", "dry_run"),
)
"""Options that most people use."""


@verb(inputs=RunInputs, execution=Execution, common=_COMMON)
def run(
    recording: Annotated[
        Path | None,
        typer.Argument(
            metavar="RECORDING",
            help="A recording (its folder, or a bag), or a run, which is brought up to date; that "
            "of --config if absent.",
            show_default=False,
        ),
    ] = None,
    output: Annotated[
        Path | None,
        option(
            "Run folder, created or continued; RECORDING_run in this folder if absent.",
            "RUN",
            "-o --output",
        ),
    ] = None,
    every: Annotated[
        Path | None,
        option(
            "Run every recording below this folder, the longest first, each into a folder of its "
            "own below -o. One that fails does not stop the others.",
            "ROOT",
            "--all",
        ),
    ] = None,
    config: Annotated[
        Path | None,
        option(
            "YAML file of parameters by stage (odometry: {max_range: 80}), or the run.yaml of a "
            "run, whose recording and camera are then taken too. Options win over the file.",
            "FILE",
        ),
    ] = None,
    *,
    inputs: dict[str, object],
    preset: Annotated[
        str | None,
        option(
            "Values that all parameters start from: default (most accurate, taken if absent) or "
            "paper (the paper's method).",
            **one_of(PRESETS),
        ),
    ] = None,
    settings: Settings = None,
    format: Formats = None,
    scale: Scale = None,
    layers: LayerNames = None,
    execution: dict[str, object],
    as_json: Json = False,
) -> None:
    """Turn a recording into a depth map for every camera image.

    The same command continues a run, and makes again what is missing, damaged or out of date. A run
    by itself takes other parameters, formats and layers.

      docdepth run 2011_09_26_drive_0005_sync -o run --camera image_02
      docdepth run run --layers normal
    """
    how = Execution(**execution)
    show = show_states if how.dry_run else show_summary
    if output is None and (recording is None or (recording / "run.yaml").is_file()) and not every:
        begun = [config, preset, how.memory]
        is_alone = not (inputs or how.force or any(one is not None for one in begun))
        changed = changes(settings, format, scale, layers)
        return show(_continue(recording, changed, how, is_alone), as_json)
    file = read_config(config) if config else RunConfigFile(None, "default", {})
    place = recording or every
    if place is not None:
        inputs = {"recording": place, "dataset": None} | inputs
    elif file.inputs is None:
        raise ConfigError("no recording: docdepth run RECORDING -o RUN, or --config RUN/run.yaml")
    if file.inputs is not None:
        inputs = file.inputs.model_dump(exclude_none=True) | inputs
    changed = file.settings | changes(settings, format, scale, layers)
    values = parameters(preset or file.preset, changed)  # type: ignore[arg-type]
    if output is None:
        named = Path(str(inputs["recording"])).resolve()
        output = Path(f"{named.stem if named.is_file() else named.name}_run")
    if every is not None:
        if recording is not None:
            raise ConfigError("--all names the recordings: leave out RECORDING")
        return _run_all(RunInputs(**inputs), output, values, how, as_json)
    with progress_bars() as progress:
        folder = run_stages(RunInputs(**inputs), output, values, how.but(progress=progress))
    return show(folder, as_json)


def _continue(
    run: Path | None, changed: dict[str, object], how: Execution, is_alone: bool
) -> RunFolder:
    """Bring a run up to date by its run.yaml, perhaps with other parameters."""
    if run is None or not (run / "run.yaml").is_file():
        raise ConfigError("no recording: docdepth run RECORDING, or docdepth run RUN")
    if not is_alone:
        raise ConfigError(
            "docdepth run RUN keeps the inputs of the run and takes no option but --set, --format, "
            "--scale and --layers; for others give RECORDING and -o RUN"
        )
    with progress_bars() as progress:
        return continue_run(run, changed, how.but(progress=progress))


def _run_all(
    inputs: RunInputs, output: Path, values: Parameters, how: Execution, as_json: bool
) -> None:
    """Run every recording of a data set, and list what failed."""
    with progress_bars() as progress:
        ended = run_all(inputs, output, values, how.but(progress=progress))
    failed = {one.recording: one.error for one in ended if one.error is not None}
    told = {place: explain(error) for place, error in failed.items()}
    said = {place: str(known or failed[place]) for place, known in told.items()}
    if as_json:
        show_json([{"recording": str(one.recording), "run": str(one.folder),
                    "error": said.get(one.recording)} for one in ended])  # fmt: skip
    else:
        state = "pass all checks" if how.dry_run else f"are done; see {output}"
        out.print(f"{len(ended) - len(failed)} of {len(ended)} recordings {state}")
        say(*(f"failed: {recording}: {sentence}" for recording, sentence in said.items()))
    if failed:
        raise typer.Exit(BUG if None in told.values() else MISTAKE)


@verb()
def render(
    run: RunPath,
    settings: Settings = None,
    camera: Annotated[list[str] | None, option_of(RunInputs, "camera")] = None,
    format: Formats = None,
    scale: Scale = None,
    layers: LayerNames = None,
    pose: Annotated[
        str | None,
        option(
            "Draw for a virtual camera at this pose in the LiDAR frame (x forward, y left, z up): "
            "x,y,z looks ahead; x,y,z,qx,qy,qz,qw; or a file with a 4x4 matrix.",
            "POSE",
        ),
    ] = None,
    K: Annotated[
        str | None,
        option(
            "Intrinsics of the virtual camera: focal lengths and principal point in pixels, for "
            "example 700,700,640,360.",
            "FX,FY,CX,CY",
            "--K",
        ),
    ] = None,
    size: Annotated[
        str | None,
        option("Image size of the virtual camera in pixels, for example 1280x720.", "WxH"),
    ] = None,
    name: Annotated[
        str | None,
        option("Name of the virtual camera: maps go to depth/NAME; virtual if absent.", "NAME"),
    ] = None,
    camera_times: Annotated[
        Path | None,
        option(
            "Times of the virtual camera's images in seconds, one per line; those of the sweeps if "
            "absent.",
            "FILE",
        ),
    ] = None,
    labels: Annotated[Path | None, option_of(RunInputs, "labels")] = None,
    threads: Threads = 0,
    renderer: Annotated[str, option_of(Execution, "renderer")] = "cpu",
) -> None:
    """Repeat rendering with other parameters, formats or cameras, or for a virtual camera.

    docdepth render RUN --pose 0,0,0.5 --K 700,700,640,360 --size 1280x720
    """
    drawn_by = Renderer(renderer)
    changed = changes(settings, format, scale, layers)
    check_stages(changed, "render", "output")
    described = None
    if pose or K or size or name is not None or camera_times:
        if not (pose and K and size) or camera:
            raise ConfigError(
                "a virtual camera needs --pose, --K and --size, and no --camera; --name and "
                "--camera-times are for it alone"
            )
        named = "virtual" if name is None else name
        described = named, virtual_camera(pose, K, size, camera_times)
    with progress_bars() as progress:
        folder = render_again(
            run,
            changed,
            names_in(camera),
            described,
            labels=labels,
            threads=threads,
            renderer=drawn_by,
            progress=progress,
        )
    show_summary(folder)
