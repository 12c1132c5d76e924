"""Verbs that measure a run: labels, tracks, poses, depth, normals, left out returns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated

import typer

from docdepth.cli.options import MODES, Json, OneCamera, RunPath, Threads, one_of, option, verb
from docdepth.cli.progress import progress_bars
from docdepth.cli.status import show, show_findings
from docdepth.cli.terminal import app, err, say
from docdepth.datasets import CameraStream
from docdepth.diagnostics.error_sources import find_error_sources
from docdepth.errors import Finding, RunError
from docdepth.evaluation import Table
from docdepth.evaluation.camera_error import camera_error
from docdepth.evaluation.error_page import DepthPage, ErrorPage, HeldOutPage, LabelPage
from docdepth.evaluation.held_out import evaluate_held_out
from docdepth.evaluation.left_out import LeftOut
from docdepth.evaluation.normals import evaluate_normals
from docdepth.evaluation.runs import evaluate_depth, evaluate_labels, evaluate_tracks
from docdepth.evaluation.trajectories import evaluate_trajectories
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline.render import report
from docdepth.pipeline.run_inputs import recorded_camera
from docdepth.visualization.page import check_page
from docdepth.visualization.report import index_is_whole, keep_held_out

evaluate = typer.Typer(no_args_is_help=True, help="Measure the accuracy of a run.")
app.add_typer(evaluate, name="evaluate")

LabelFolder = Annotated[
    Path,
    option(
        "Folder of true labels in SemanticKITTI's format (NAME.label), or its parent.",
        "DIR",
        "--labels",
    ),
]
TrueDepth = Annotated[
    Path,
    option(
        "Folder of true depth maps of the same names, in any format that docdepth writes, or its "
        "parent. Images without one are not compared.",
        "DIR",
        "--depth",
    ),
]
Page = Annotated[
    Path | None,
    option("Write a page with pictures of the errors, the worst images first.", "FILE", "--html"),
]
MaxRange = Annotated[
    float,
    option("Ignore what is truly farther than this, metres.", "M", min=1, max=10000),
]


@verb(evaluate)
def labels(
    run: RunPath,
    truth: LabelFolder,
    html: Page = None,
    as_json: Json = False,
) -> None:
    """Compare labels with the truth, point by point.

    Static and dynamic accuracy, F1, precision and intersection over union.
    """
    page = None
    if html is not None:
        check_page(html)
        page = LabelPage(_title(run, "labels against the truth"))
    with progress_bars() as progress:
        result = evaluate_labels(run, truth, progress, page.look if page else None)
    show(result, as_json)
    _write(page, html, [result.table()])


@verb(evaluate)
def tracks(
    run: RunPath,
    truth: LabelFolder,
    tracks: Annotated[
        Path | None,
        option(
            "True tracks, as synth writes them; tracks.csv beside the folder of labels if left "
            "out.",
            "FILE",
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Compare instances and tracks with true ones.

    Share of moving objects found and of points with the right instance, HOTA and CLEAR, errors of
    boxes and velocities.
    """
    with progress_bars() as progress:
        result = evaluate_tracks(run, truth, tracks, progress)
    show(result, as_json)


@verb(evaluate)
def trajectories(
    run: RunPath,
    poses: Annotated[
        str,
        option(
            "True poses, as run takes them: a file of the LiDAR's (TUM, KITTI, PLY, NPY), "
            "CAMERA:FILE for a camera's, or dataset for those of the recording. A file with times "
            "may have any rate.",
            "FILE|dataset",
        ),
    ],
    as_json: Json = False,
) -> None:
    """Compare the poses of a run with true ones.

    Absolute and relative pose error, as evo computes them, and drift, as KITTI's odometry
    benchmark does. For its plots: docdepth convert RUN poses.tum --to tum, and evo_traj.
    """
    show(evaluate_trajectories(run, poses), as_json)


@verb(evaluate)
def depth(
    run: RunPath,
    truth: TrueDepth,
    mode: Annotated[
        str,
        option(
            "Pixels to compare: valid (those with depth), or kitti (all: empty ones are filled as "
            "KITTI's development kit does).",
            **one_of(MODES),
        ),
    ] = "valid",
    max_range: MaxRange = 80.0,
    camera: OneCamera = None,
    other: Annotated[
        Path | None,
        option(
            "Another run, or a folder of depth maps of another method: both are compared over the "
            "pixels that both fill.",
            "RUN",
        ),
    ] = None,
    html: Page = None,
    as_json: Json = False,
) -> None:
    """Compare depth maps with true ones, pixel by pixel.

    Mean absolute and root mean square error, density, and pixels more than 5 % too near or too far,
    by region; then the figures of KITTI's development kit.
    """
    page = None
    if html is not None:
        check_page(html)
        title = _title(run, "depth against the truth")
        page = DepthPage(title, max_range, _recorded_camera(RunFolder.open(run), camera))
    with progress_bars() as progress:
        result = evaluate_depth(
            run, truth, mode, max_range, camera,  # type: ignore[arg-type]
            progress, page.look if page else None, other,
        )  # fmt: skip
    show(result, as_json)
    if not as_json:
        say("", str(result.kitti_table()))
    _write(page, html, [result.table(), result.kitti_table()])


@verb(evaluate)
def normals(
    run: RunPath, truth: TrueDepth, camera: OneCamera = None, as_json: Json = False
) -> None:
    """Compare the layer normal with the surfaces of exact depth maps.

    Median angle, and shares of pixels within 11.25, 22.5 and 30 degrees, by class. Normals that the
    run has not stored are drawn.
    """
    with progress_bars() as progress:
        result = evaluate_normals(run, truth, camera, progress)
    show(result, as_json)


@verb(evaluate)
def held_out(
    run: RunPath,
    every: Annotated[int, option("Leave out every N-th sweep, one at a time.", "N", min=1)] = 10,
    lidar: Annotated[
        int | None,
        option(
            "Leave out this LiDAR of a rig, in all sweeps, instead of a sweep; they count from 0, "
            "as inspect lists them.",
            "N",
            min=0,
        ),
    ] = None,
    beams: Annotated[
        int | None,
        option("Leave out every N-th beam of the sweep instead of all of it.", "N", min=2),
    ] = None,
    sectors: Annotated[
        float | None,
        option(
            "Leave out every second sector of DEG degrees of the sweep instead of all of it.",
            "DEG",
            min=1,
            max=180,
        ),
    ] = None,
    max_range: MaxRange = 80.0,
    camera: OneCamera = None,
    threads: Threads = 0,
    html: Page = None,
    as_json: Json = False,
) -> None:
    """Compare depth with returns that were left out: needs no ground truth.

    A sweep is left out, or some of its beams or sectors, or a LiDAR of a rig. Its view is rendered
    from all else, and each of its returns is compared with the map. Pixels between returns are not
    evaluated.
    Poses that jitter and sweeps that are not motion compensated are named. Returns cannot tell
    where the camera is and when it looked. Where images can, it says what a wrong camera adds.
    """
    left_out, page = LeftOut(lidar, beams, sectors), None
    if html is not None:
        check_page(html)
        folder = RunFolder.open(run)
        title = _title(run, "depth against returns that were left out")
        stream, times = _recorded_camera(folder, camera), folder.trajectory().times
        page = HeldOutPage(title, max_range, str(left_out), stream, times)
    with progress_bars() as progress:
        result = evaluate_held_out(
            run, every, max_range, camera, threads,
            progress, left_out,
            page.look if page else None,
        )  # fmt: skip
        folder = RunFolder.open(run)
        findings = find_error_sources(folder, progress).findings
        wrong = camera_error(folder, camera, max_range, progress)
    if wrong:
        findings.append(Finding("camera", "", wrong.line))
        result = replace(result, camera_mae=wrong.mae, camera_wrong=wrong.wrong)
    result = replace(result, found=tuple(map(str, findings)))
    show(result, as_json)
    show_findings(findings)
    _write(page, html, [result.table()], result.found)
    _keep(folder, camera, result.table())


def _keep(folder: RunFolder, camera: str | None, table: Table) -> None:
    """Keep the errors for the report of the run, and write that anew."""
    if keep_held_out(folder, camera, asdict(table)) and index_is_whole(folder):
        try:
            report(folder)
        except RunError as error:
            say(f"the report of the run stays as it was: {error}", to=err)


def _recorded_camera(folder: RunFolder, camera: str | None) -> CameraStream | None:
    return recorded_camera(folder, folder.depth_folder(camera))


def _title(run: Path, what: str) -> str:
    return f"docdepth: {run.resolve().name}, {what}"


def _write(
    page: ErrorPage | None, path: Path | None, tables: list[Table], found: Sequence[str] = ()
) -> None:
    if page is not None and path is not None:
        page.write(path, tables, found)
        say(f"pictures of the errors: {path}", to=err)
