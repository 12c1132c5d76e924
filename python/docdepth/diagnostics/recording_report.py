"""Looks at a recording: what it holds, and frames, poses and times that are wrong.

A few sweeps and images are opened and some sweeps registered, so that a drive of thousands of
sweeps takes seconds. What a run checks when it starts is checked by the same functions.
"""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import asdict

import numpy as np
from numpy.typing import NDArray

from docdepth.config import Parameters
from docdepth.datasets import Dataset, FrameRange, Sweep, full_recording, usable_points
from docdepth.datasets.views import is_lone_lidar, lacks_times
from docdepth.diagnostics import recording_checks
from docdepth.diagnostics.cameras import check_camera
from docdepth.diagnostics.lidar_figures import lidar_figures, row_shares, time_figures
from docdepth.diagnostics.own_vehicle import find_own_vehicle
from docdepth.diagnostics.poses import Window, pose_figures, share_on, windows_of
from docdepth.diagnostics.recording_checks import Inspection
from docdepth.diagnostics.sweeps import check_sweeps, find_lonely_returns, find_sensor_origin
from docdepth.errors import DocDepthError, Finding, collect_findings, in_order
from docdepth.geometry.ground_plane import find_ground
from docdepth.geometry.lidar_frame import LidarFrame
from docdepth.geometry.se3 import inverse
from docdepth.geometry.trajectory import Trajectory
from docdepth.odometry.odometry import estimate_poses
from docdepth.odometry.pose_checks import (
    check_given_poses,
    find_camera_poses,
    find_jumps,
    find_misfit,
    find_no_motion,
)
from docdepth.odometry.skew import find_rotation
from docdepth.odometry.sweeps import lidar_frame

_WINDOW = 6  # sweeps that are registered with each other
_BETTER = 1.1  # times the share of points on each other, by registration against given poses
_PARAMETERS = Parameters()


def inspect_recording(
    recording: Dataset,
    poses: NDArray[np.float64] | None = None,
    opening: Iterable[Finding] = (),
) -> Inspection:
    """Look at a recording.

    Parameters
    ----------
    poses : ndarray of float64, shape (n, 4, 4), optional
        ``T_world_lidar`` of another SLAM; those of the recording if left out.
    opening : iterable of Finding
        Of opening the recording.
    """
    result = Inspection(findings=list(opening))
    given = recording.poses if poses is None else poses
    files = [recording.sweep_files(k) for k in range(len(recording))]
    result.sweeps, found = check_sweeps(recording, files, _PARAMETERS, given is not None)
    result.findings += found
    _look_at_sweeps(recording, result)
    _look_at_rotation(recording, result)
    if given is not None:
        with collect_findings(result.findings):
            checked = check_given_poses(recording, given)
            result.findings += find_no_motion(recording, checked, _PARAMETERS.odometry)
            result.findings += find_camera_poses(checked)
            result.poses = checked
    result.windows = _register(recording, result)
    _look_at_poses(recording, result, "file" if poses is not None else "recording")
    for stream in recording.cameras.values():
        result.findings += check_camera(recording, stream, result.sweeps)
    result.figures["cameras"] = recording_checks.camera_figures(recording)
    recording_checks.check_figures(recording, result)
    result.findings = in_order(result.findings)
    return result


def _look_at_sweeps(recording: Dataset, result: Inspection) -> None:
    """Figures of the times of sweeps and of those that were opened."""
    sweeps, figures = list(result.sweeps.values()), result.figures
    figures["recording"] = {
        "path": str(recording.path),
        "format": recording.name,
        "lidars": list(recording.lidars),
        "cameras": list(recording.cameras),
        "poses": recording.poses is not None,
    }
    figures["sweeps"] = recording_checks.stamp_figures(recording.times)
    if not sweeps:
        return
    period = figures["sweeps"]["period_s"]
    middle = sweeps[len(sweeps) // 2]
    figures["sweeps"]["motion_compensated"] = middle.motion_compensated
    figures["lidars"] = lidar_figures(middle, list(recording.lidars))
    shares = [row_shares(sweep.points) for sweep in sweeps]
    figures["rows"] = {name: max(s[name] for s in shares) for name in shares[0]}
    figures["point_times"] = time_figures(middle, period)
    counts = [c for c in getattr(full_recording(recording), "point_times", ()) if c is not None]
    if figures["point_times"] is not None and counts:
        figures["point_times"]["counted"] = [
            {"from": count.origin, "unit_ns": count.unit, "shift_ns": count.shift}
            for count in counts
        ]
    result.ground = find_ground([s.points[usable_points(s.points)] for s in sweeps])
    figures["ground"] = None
    if result.ground is not None:
        ground = result.ground
        figures["ground"] = {
            "tilt_deg": round(ground.tilt_deg, 1),
            "up": ground.up.round(3).tolist(),
            "height_m": round(ground.height, 2),
            "share": round(ground.share, 3),
        }


def _look_at_rotation(recording: Dataset, result: Inspection) -> None:
    """Whether sweeps are as measured, where no times tell it and where they are said not to be."""
    if not result.sweeps or not is_lone_lidar(recording):
        return
    if lacks_times(recording) or recording.sweep(0).motion_compensated:
        stamp = getattr(full_recording(recording), "stamp", None)
        result.findings += find_rotation(recording, stamp)[1]


def _register(recording: Dataset, result: Inspection) -> list[Window]:
    """Poses of a few pieces of the drive by registration alone."""
    poses, ground, windows = result.poses, result.ground, []
    registered = result.sweeps and len(recording) > 1  # not where every sweep is broken
    for frames in windows_of(poses, len(recording), _WINDOW) if registered else []:
        part = FrameRange(recording, f"{frames.start}:{frames.stop}")
        try:
            measured = estimate_poses(part, threads=1, passes=1, findings=result.findings)
        except DocDepthError as error:
            text = f"frames {frames.start} to {frames.stop - 1} are not registered: {error}"
            result.note("not-registered", text)
            continue
        given = measured if poses is None else poses[frames.start : frames.stop]
        first, last = (recording.sweep(k).points for k in (frames[0], frames[-1]))
        shares = [share_on(first, last, inverse(p[0]) @ p[-1], ground) for p in (given, measured)]
        windows.append(Window(frames.start, given, measured, shares[1] > _BETTER * shares[0]))
    return windows


def _look_at_poses(recording: Dataset, result: Inspection, source: str) -> None:
    """Figures of the poses, checks that a run makes of them, and the body of the vehicle."""
    poses, figures = result.poses, result.figures
    figures["poses"] = None
    figures["registered"] = [
        {"frames": [w.first, w.first + len(w.measured) - 1], "metres_a_sweep": round(w.step, 3)}
        for w in result.windows
    ]
    if poses is not None:
        figures["poses"] = {"source": source, **pose_figures(poses, recording.times)}
        found = find_jumps(Trajectory(recording.times, poses))
        if result.sweeps:
            wrong = recording_checks.check_poses(recording, poses, result.windows)
            found += wrong
            if not wrong and np.ptp(poses, axis=0).any():
                with collect_findings(found):
                    found += find_misfit(
                        lambda k: recording.sweep(k).points,
                        poses,
                        recording.times,
                        _PARAMETERS.odometry,
                    )
        result.findings += found
    figures["ego"] = None
    if not result.sweeps:
        return
    with suppress(DocDepthError):  # of a broken sweep, which is told already
        vehicle = find_own_vehicle(recording)
        figures["ego"] = None if vehicle is None else asdict(vehicle)
    viewpoint, found = find_sensor_origin(recording)
    result.findings += found
    if viewpoint is None:
        keys = list(result.sweeps)
        result.findings += find_lonely_returns(
            lambda i: _returns(result.sweeps[keys[i]]), len(keys)
        )


def _returns(sweep: Sweep) -> LidarFrame:
    return lidar_frame(sweep, np.float32(1)).select(usable_points(sweep.points))
