"""What a recording holds, and what its figures mean."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets import Dataset, Sweep, image_streams, usable_points
from docdepth.diagnostics.poses import Window, explain_misfit, rotations_are_missing
from docdepth.errors import Finding
from docdepth.geometry.ground_plane import GroundPlane
from docdepth.visualization.inspection import Figures


@dataclass
class Inspection:
    """What a recording holds.

    Attributes
    ----------
    figures : dict
        Of the recording, its sweeps, LiDARs, points, poses and cameras, ready for JSON.
    findings : list of Finding
        Errors, then warnings, then notes on what is unusual, but no problem.
    sweeps : dict of int to Sweep
        Those that were opened, by frame.
    poses : ndarray of float64, shape (n, 4, 4), or None
        ``T_world_lidar`` of every sweep.
    windows : list of Window
        Sweeps that were registered.
    """

    figures: Figures = field(default_factory=dict)
    findings: list[Finding] = field(default_factory=list)
    sweeps: dict[int, Sweep] = field(default_factory=dict)
    poses: NDArray[np.float64] | None = None
    windows: list[Window] = field(default_factory=list)
    ground: GroundPlane | None = None

    def add(self, code: str, subject: str, text: str, remedy: str = "") -> None:
        """Add a warning."""
        self.findings.append(Finding(code, subject, text, remedy))

    def note(self, code: str, text: str, remedy: str = "") -> None:
        """Add what is unusual, but no problem."""
        self.findings.append(Finding(code, "", text, remedy, "note"))


MOVING = 0.05
"""Metres a sweep, by registration; less may be its errors."""

_TILT_DEG = 10.0  # between z and the ground's normal; vehicles pitch and mounts lean by less
_ONE_PLACE = 0.005  # share of the rows in one place that is not the origin
_FEW_ROWS = 0.001  # share of the rows that is not worth a word
_CLOSE = 0.01  # share of the points closer than half a metre
_SAME_RAY, _SAME_POINT = 0.02, 0.05  # shares: of one return 0 to 0.005, of a room in two 0.08
_SPAN = (0.6, 1.3)  # of the time between sweeps that their points take
_TURN_DEG = 20.0  # from point to point in time: 0 to 6, of shuffled times 90
_WIDE_DEG = 180  # of the field of view of a LiDAR that turns
_WANDERS = 5.0  # metres that the middle of the points moves though the points do not


def stamp_figures(times: NDArray[np.int64]) -> dict[str, float | None]:
    """Count, rate, gaps and span of stamps [ns], ready for JSON."""
    pauses = np.diff(times) * 1e-9
    period = float(np.median(pauses)) if len(pauses) else None
    return {
        "count": len(times),
        "from_s": int(times[0]) / 1e9 if len(times) else None,
        "to_s": int(times[-1]) / 1e9 if len(times) else None,
        "period_s": None if period is None else round(period, 6),
        "rate_hz": None if not period else round(1 / period, 2),
        "longest_gap_s": round(float(pauses.max()), 4) if len(pauses) else None,
        "shortest_gap_s": round(float(pauses.min()), 4) if len(pauses) else None,
    }


def camera_figures(recording: Dataset) -> list[dict[str, object]]:
    """Images, rate and times against the sweeps of each camera, ready for JSON."""
    images, figures = image_streams(recording), []
    for name in dict.fromkeys([*recording.cameras, *images]):
        stream = recording.cameras.get(name) or images[name]
        entry: dict[str, object] = {"name": name, "images": len(stream.images)}
        entry["calibrated"] = name in recording.cameras
        if stream.camera is not None:
            camera = stream.camera
            entry["size"] = [camera.width, camera.height]
            field = 2 * np.degrees(np.arctan(camera.width / (2 * camera.K[0, 0])))
            entry["field_of_view_deg"] = round(float(field), 1)
        entry |= stamp_figures(stream.times)
        if len(stream.times):
            times = recording.times
            inside = (stream.times >= times[0]) & (stream.times <= times[-1])
            after = np.searchsorted(times, stream.times).clip(0, len(times) - 1)
            apart = np.minimum(
                np.abs(times[after] - stream.times),
                np.abs(times[(after - 1).clip(0)] - stream.times),
            )
            entry["within_sweeps"] = int(inside.sum())
            entry["starts_after_s"] = round(float(stream.times[0] - times[0]) * 1e-9, 4)
            entry["ends_after_s"] = round(float(stream.times[-1] - times[-1]) * 1e-9, 4)
            entry["from_nearest_sweep_s"] = round(float(np.median(apart)) * 1e-9, 4)
        figures.append(entry)
    return figures


def check_figures(recording: Dataset, result: Inspection) -> None:
    """Add what the figures show; what a run checks by itself is found already."""
    where, figures, ego = str(recording.path), result.figures, result.figures["ego"]
    if not result.sweeps:
        return
    _check_up(where, result)
    _check_rows(where, figures["rows"], result)
    _check_lidars(where, figures["lidars"], result)
    _check_times(where, result)
    _check_world(where, result)
    if ego is not None:
        mirrored = " and its mirror images below the ground" if ego["mirrored"] else ""
        result.note(
            "own-vehicle",
            f"{ego['returns']} returns a sweep within {ego['reach']:g} m stay with the LiDAR: its "
            f"vehicle{mirrored}",
            "a run leaves them out; to choose yourself, say in docdepth.yaml (least and greatest "
            f"x, y and z in metres) ego_boxes: {[list(map(list, box)) for box in ego['boxes']]}",
        )


def _check_up(where: str, result: Inspection) -> None:
    ground = result.ground
    if ground is None:
        result.note(
            "up-unknown",
            "the ground is not one plane, or lies another way in each sweep, as seen by a "
            "hand-held LiDAR: which way is up is not known",
        )
        return
    if ground.tilt_deg <= _TILT_DEG:
        return
    axis = int(np.abs(ground.up).argmax())
    like = ""
    if axis != 2 or ground.up[2] < 0:
        like = f", and {'-' if ground.up[axis] < 0 else ''}{'xyz'[axis]} is nearly up"
    camera = " as in a camera's frame" if axis == 1 and ground.up[1] < 0 else ""
    result.add(
        "tilted",
        where,
        f"z of the points is {ground.tilt_deg:.0f} degrees from the ground's normal{like}{camera}; "
        "a run turns them so that z is up",
        "if what is taken for the ground is a wall, say up: [x, y, z] in docdepth.yaml",
    )


def _check_rows(where: str, rows: dict[str, float], result: Inspection) -> None:
    if rows["at_origin"] > _FEW_ROWS:
        result.note(
            "rows-at-origin",
            f"up to {100 * rows['at_origin']:.1f} % of the rows of a sweep are points at the "
            "origin; they are no returns and are left out",
        )
    if rows["not_finite"] > _FEW_ROWS:
        result.note(
            "rows-not-finite",
            f"up to {100 * rows['not_finite']:.1f} % of the rows of a sweep are not finite; they "
            "are left out",
        )
    if rows["close"] > _CLOSE:
        result.note(
            "rows-close",
            f"{100 * rows['close']:.1f} % of the points are nearer than half a metre, of the "
            "vehicle or the LiDAR itself; they are left out",
        )
    if rows["one_place"] > _ONE_PLACE:
        result.add(
            "rows-in-one-place",
            where,
            f"{100 * rows['one_place']:.1f} % of the rows of a sweep are in one place that is not "
            "the origin: no returns that were moved along with the points",
            "remove them before points are transformed",
        )


def _check_lidars(where: str, lidars: list[Figures], result: Inspection) -> None:
    for lidar in lidars:
        name, same_ray, same_point = (lidar[k] for k in ("name", "same_ray", "same_point"))
        if same_point > _SAME_POINT:
            result.add(
                "repeated-points",
                where,
                f"{100 * same_point:.0f} % of the points of {name} come twice; a packet or a "
                "second return was written again",
                "remove the copies",
            )
        elif same_ray > _SAME_RAY:
            result.add(
                "two-returns",
                where,
                f"{100 * same_ray:.0f} % of the points of {name} share their ray with another "
                "point, so the LiDAR records two returns",
                "keep the strongest or the last of each ray, or set the LiDAR to one return",
            )


def _check_times(where: str, result: Inspection) -> None:
    times, lidars = result.figures["point_times"], result.figures["lidars"]
    if times is None:
        by_rotation = any(found.code == "times-by-rotation" for found in result.findings)
        if not result.figures["sweeps"]["motion_compensated"] and not by_rotation:
            result.note("no-times", "points have no times: sweeps are used as they were measured")
        return
    first, last = times["span"]
    if times["span_s"] is not None and not _SPAN[0] < last - first < _SPAN[1]:
        result.add(
            "span-of-times",
            where,
            f"points of a sweep are measured within {last - first:.2f} of the time between sweeps; "
            "are sweeps missing or cut?",
            "look at the stamps, and say point_time_unit in docdepth.yaml if the unit is wrong",
        )
    wide = bool(lidars) and lidars[0]["field_of_view_deg"]["horizontal"] > _WIDE_DEG
    if wide and times["turn_deg"] > _TURN_DEG:
        result.add(
            "times-of-other-points",
            where,
            f"points that follow each other in time are {times['turn_deg']:.0f} degrees apart "
            "(median), so times are not of their points",
            "drop rows and their times together",
        )


def _check_world(where: str, result: Inspection) -> None:
    """Whether the points are in the world, where the LiDAR moves and its points do not."""
    if not result.windows:
        return
    middles = np.array(
        [np.median(s.points[usable_points(s.points)], axis=0) for s in result.sweeps.values()]
    )
    wandered = float(np.linalg.norm(middles[-1] - middles[0]))
    if max(window.step for window in result.windows) < MOVING and wandered > _WANDERS:
        result.add(
            "in-the-world",
            where,
            f"points stay in their place from sweep to sweep, yet their middle moves by "
            f"{wandered:.0f} m: they are in the world, not in the LiDAR's frame",
            "say frame: world and poses in docdepth.yaml; a VIEWPOINT of zeros is no pose",
        )


def check_poses(
    recording: Dataset, poses: NDArray[np.float64], windows: Sequence[Window]
) -> list[Finding]:
    """What poses are instead, where they are something else."""
    where, found = str(recording.path), []
    if rotations_are_missing(poses):
        text = "all poses have the same rotation, though their path turns"
        found.append(Finding("no-rotations", where, text, "give rotations as well as positions"))
    cameras = {name: stream.T_camera_lidar for name, stream in recording.cameras.items()}
    misfit = explain_misfit(windows, cameras)
    return found if misfit is None else [*found, replace(misfit, subject=where)]
