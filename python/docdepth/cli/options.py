"""Consoles, options, progress bars and summaries that the verbs share."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

if TYPE_CHECKING:
    from docdepth.io.run_folder import RunFolder

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Dense, metric depth maps for camera images from LiDAR recordings (DOC-Depth).",
)
out = Console(highlight=False)
err = Console(stderr=True, highlight=False)

RunPath = Annotated[Path, typer.Argument(metavar="RUN", help="Run folder.")]
Settings = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="STAGE.NAME=VALUE", help="Set a parameter."),
]
Threads = Annotated[int, typer.Option(min=0, help="Number of threads; 0 uses all cores.")]
RendererName = Annotated[
    str | None,
    typer.Option(
        "--renderer",
        metavar="NAME",
        help="auto (GPU if present, else cpu), cpu, egl, egl:N, surfaceless or osmesa; "
        "DOCDEPTH_RENDERER or auto if absent.",
    ),
]
CameraNames = Annotated[
    list[str] | None,
    typer.Option(
        "--camera", metavar="NAME", help="Camera, several with commas, or all; image_02 if absent."
    ),
]
Formats = Annotated[
    list[str] | None,
    typer.Option(
        "--format",
        metavar="NAME",
        help="png (default), exr, exr-half, tiff, npz or npy; several with commas.",
    ),
]
Scale = Annotated[float | None, typer.Option(help="PNG value per metre; 256 (KITTI) if absent.")]
LayerNames = Annotated[
    list[str] | None,
    typer.Option(
        "--layers",
        metavar="NAME",
        help="Per-pixel layers: class, time, range, support, std, normal, confidence.",
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON.")]


def show(result: Any, as_json: bool) -> None:
    text = json.dumps(result.as_dict(), indent=1) if as_json else str(result.table())
    out.print(text, soft_wrap=True, markup=False)


@contextmanager
def progress_bars() -> Iterator[Any]:
    """One progress bar per stage, with the time left; lines where output is no terminal."""
    if not err.is_terminal:
        yield _progress_lines()
        return
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


def _progress_lines() -> Callable[[str, int, int], None]:
    """For log files: a line whenever another tenth of a stage is done."""
    told: dict[str, int] = {}

    def tell(stage: str, done: int, total: int) -> None:
        tenths = 10 * done // max(total, 1)
        if told.get(stage) != tenths:
            told[stage] = tenths
            err.print(f"{stage} {done}/{total}", soft_wrap=True, markup=False)

    return tell


def listed(names: list[str] | None) -> str | list[str] | None:
    """Names from repeated options or commas; a single name as a string."""
    every = [name for text in names or [] for name in text.split(",")]
    return every[0] if len(every) == 1 else every or None


def changes_of(settings: list[str] | None) -> dict[str, Any]:
    from docdepth.config import parse_settings

    return parse_settings(settings or [])


def output_of(
    format: list[str] | None, scale: float | None, layers: list[str] | None
) -> dict[str, Any]:
    """Parameters that have an option of their own."""
    chosen: dict[str, Any] = {}
    if format:
        chosen["output.format"] = ",".join(format)
    if scale is not None:
        chosen["output.scale"] = scale
    if layers:
        chosen["output.layers"] = ",".join(layers)
    return chosen


def reopen(path: Path, changes: dict[str, Any], *stages: str) -> RunFolder:
    """A run with some parameters of one stage replaced; kept in run.yaml once a stage uses them."""
    from docdepth.config import replaced
    from docdepth.io.run_folder import RunFolder

    check_stages(changes, *stages)
    folder = RunFolder.open(path)
    values = replaced(folder.parameters, changes)
    folder.manifest["parameters"] = values.model_dump(mode="json")
    return folder


def check_stages(changes: dict[str, Any], *stages: str) -> None:
    """Refuse parameters of other stages."""
    from docdepth.errors import ConfigError

    for name in changes:
        if name.partition(".")[0] not in stages:
            raise ConfigError(f"--set {name}: this stage knows {' and '.join(stages)} only")


def show_summary(folder: RunFolder) -> None:
    """Print seconds per stage, density, images left out, and what is out of date."""
    from docdepth.pipeline.run import changes_since_start, states

    table = Table("stage", "frames", "seconds", "ms/frame", "seconds by step", box=None)
    for name, state in folder.manifest["stages"].items():
        seconds: dict[str, float] = state.get("seconds", {})
        total, frames = state.get("total_seconds", 0.0), state.get("total_frames", 0)
        parts = ", ".join(f"{k} {v:.1f}" for k, v in sorted(seconds.items(), key=lambda x: -x[1]))
        each = f"{1000 * total / frames:.0f}" if frames else ""
        table.add_row(name, str(state.get("all_frames", "")), f"{total:.1f}", each, parts)
    out.print(table)
    for name in folder.cameras:
        rendered = folder.stage(f"render {name}")
        if "density" in rendered:
            density = f"{100 * rendered['density']:.1f} % of the pixels"
            out.print(f"density of {name} {density}", style="bold", markup=False)
        if rendered.get("left_out"):
            names = ", ".join(rendered["left_out"])
            text = f"{len(rendered['left_out'])} images outside the sweeps left out: {names}"
            out.print(text, markup=False)
    peak = max((s.get("peak_memory_mb", 0) for s in folder.manifest["stages"].values()), default=0)
    out.print(f"peak memory {peak} MB; results in {folder.path}", soft_wrap=True, markup=False)
    for change in changes_since_start(folder):
        out.print(change, soft_wrap=True, markup=False)
    left = [state for state in states(folder) if state.state != "done"]
    if left:
        names = ", ".join(state.name for state in left)
        out.print(
            f"not up to date: {names}; bring it up to date: docdepth run {folder.path}",
            soft_wrap=True,
            markup=False,
        )
