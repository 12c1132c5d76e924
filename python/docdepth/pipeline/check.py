"""All inputs of a run are checked before it begins, and all problems are told at once.

Sizes of all files are read, but only a few sweeps and images are opened: a drive of thousands of
sweeps takes seconds.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from docdepth.config import Parameters
from docdepth.datasets import CameraStream, Dataset, Sweep, usable_points
from docdepth.datasets.times import read_times
from docdepth.diagnostics.cameras import check_camera
from docdepth.diagnostics.sweeps import check_sweeps
from docdepth.errors import DatasetError, DocDepthError, Finding, collect_findings, in_order
from docdepth.io.calibration import read_camera_calibration
from docdepth.io.depth import check_format
from docdepth.io.inputs import DerivedInputs, RunInputs
from docdepth.io.poses import read_poses
from docdepth.odometry.pose_checks import check_given_poses, find_misfit
from docdepth.pipeline.execution import check_resources, estimate, size_text
from docdepth.pipeline.given_poses import (
    file_of_poses,
    read_given_poses,
    refuse_points_of_another_frame,
    refuse_poses_of_a_camera,
)
from docdepth.pipeline.label_folder import LabelFolder
from docdepth.pipeline.run_inputs import known_poses, open_as_begun, open_inputs
from docdepth.render.layers import check_layers


@dataclass(frozen=True)
class CheckResult:
    """What the checks found."""

    findings: list[Finding]  # errors first; empty if all is well
    # sweeps, cameras, memory and disk by estimate; empty if the recording cannot be opened
    summary: str


def check_inputs(
    inputs: RunInputs, parameters: Parameters, output: Path | None = None
) -> CheckResult:
    """Find all problems of the inputs of a run; ``output`` is its folder, if it is known."""
    found: list[Finding] = []
    opened = None
    try:
        opened = open_inputs(inputs)
    except DocDepthError:
        with collect_findings(found):  # where sweeps cannot be read, the checks below name them
            opened = open_as_begun(inputs, DerivedInputs())
    if opened is not None:
        recording = opened.recording
        checked = check_opened(inputs, recording, opened.cameras, parameters, output)
        if not inputs.poses or any(f.severity == "error" for f in checked.findings):
            return checked
        misfit = misfit_of_poses(inputs.poses, recording, parameters)
        return CheckResult([*checked.findings, *misfit], checked.summary)
    found += _check_files_of_options(inputs)
    found += _check_parameters(parameters)
    if output is not None:
        found += _check_output(output, [], inputs.recording)
    return CheckResult(in_order(found), "")


def misfit_of_poses(poses: str, recording: Dataset, parameters: Parameters) -> list[Finding]:
    """Whether sweeps fit each other by given poses."""
    return find_misfit(
        lambda k: recording.sweep(k).points,
        read_given_poses(poses, recording),
        recording.times,
        parameters.odometry,
    )


def check_opened(
    inputs: RunInputs,
    recording: Dataset,
    cameras: list[CameraStream],
    parameters: Parameters,
    output: Path | None = None,
    jobs: int = 1,
) -> CheckResult:
    """:func:`check_inputs` for inputs that are open already.

    ``cameras`` are those whose depth maps are wanted, ``jobs`` the processes that share the work.
    """
    found = _check_parameters(parameters)
    has_poses = bool(inputs.poses)
    with collect_findings(found):
        poses = known_poses(inputs, recording)
        if poses is not None:
            poses = check_given_poses(recording, poses)
        refuse_points_of_another_frame(recording, parameters.odometry)
        if poses is not None and inputs.poses:
            refuse_poses_of_a_camera(inputs.poses, recording, poses, parameters.odometry)
    files = [recording.sweep_files(k) for k in range(len(recording))]
    sweeps, of_sweeps = check_sweeps(recording, files, parameters, has_poses)
    found += of_sweeps
    if inputs.labels is not None:
        found += _check_labels(inputs.labels, recording, sweeps)
    for stream in cameras:
        found += check_camera(recording, stream, sweeps)
    if output is not None:
        # Beside a recording that is a file, such as a bag, lies whatever its folder holds.
        in_folder = files and recording.path.is_dir()
        folders = sorted({file.parent for file in files[0]}) if in_folder else []
        found += _check_output(output, folders, recording.path)
    points = np.array([len(sweep.points) for sweep in sweeps.values()] or [0])
    needed = estimate(points, len(files), cameras, parameters, jobs)
    found += check_resources(needed, cameras, output)
    seen = ", ".join(f"{s.name} ({len(s.names)} images)" for s in cameras) or "none"
    summary = (
        f"{len(recording)} sweeps of {np.median(points):.0f} points, cameras {seen}; by estimate "
        f"{size_text(needed.memory)} of memory and {size_text(needed.disk)} on disk"
    )
    return CheckResult(in_order(found), summary)


def _check_labels(folder: Path, recording: Dataset, sweeps: dict[int, Sweep]) -> list[Finding]:
    """Labels of every sweep are there, and those of some sweeps fit."""
    found: list[Finding] = []
    names = next(iter(recording.lidars.values())).names
    with collect_findings(found):
        given = LabelFolder(folder)
        given.check(names)
        for frame, sweep in sweeps.items():
            points = sweep.points
            returns = partial(np.flatnonzero, usable_points(points))
            given.check_count(sweep.name, frame, len(points), returns)
    return found


def _check_files_of_options(inputs: RunInputs) -> list[Finding]:
    """Files that options name, where the recording itself cannot be opened."""
    found: list[Finding] = []
    with collect_findings(found):
        if inputs.camera_times is not None:
            read_times(inputs.camera_times)
    with collect_findings(found):
        if inputs.calibration is not None:
            read_camera_calibration(inputs.calibration)
    with collect_findings(found):
        if inputs.labels is not None:
            LabelFolder(inputs.labels)
    with collect_findings(found):
        if inputs.poses and (poses := file_of_poses(inputs.poses)):
            read_poses(poses)
    return found


def _check_parameters(parameters: Parameters) -> list[Finding]:
    """What only the last stage would refuse, and packages that are missing."""
    found: list[Finding] = []
    for format in parameters.output.format:
        with collect_findings(found):
            check_format(format, parameters.output.scale, parameters.render.max_depth)
    with collect_findings(found):
        check_layers(parameters.output.layers, parameters.render)
    return found


def _check_output(output: Path, sweeps: list[Path], recording: Path) -> list[Finding]:
    """Whether a run folder can be written to, and lies outside the recording."""
    found: list[Finding] = []
    with collect_findings(found):
        if output.is_symlink() and not output.exists():
            raise DatasetError(
                f"{output} is a link to {output.readlink()}, which is missing; name another folder"
            )
        existing = next(p for p in [output.absolute(), *output.absolute().parents] if p.exists())
        if not existing.is_dir():
            raise DatasetError(f"{existing} is a file; name a folder for the run")
        if not os.access(existing, os.W_OK | os.X_OK):
            raise DatasetError(f"{existing} cannot be written to; name another folder for the run")
        place = output.resolve()
        for folder in [*sweeps, recording]:
            there = folder.resolve()
            if place == there or (folder in sweeps and there in place.parents):
                raise DatasetError(
                    f"{output} lies in the recording ({folder}); name another folder for the run"
                )
    return found
