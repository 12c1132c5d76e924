"""Checks of sweeps: some are opened, the sizes of all are compared."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext, suppress
from dataclasses import replace
from filecmp import cmp
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.config import Parameters
from docdepth.datasets import Dataset, Sweep, usable_points
from docdepth.datasets.files import suggest_skipping
from docdepth.datasets.sensor_pose import LEAST_IN_TRIANGLES, SensorOrigin, estimate_sensor_origin
from docdepth.errors import (
    DatasetError,
    DocDepthError,
    Finding,
    OdometryError,
    collect_errors,
    collect_findings,
)
from docdepth.geometry.lidar_frame import LidarFrame
from docdepth.geometry.points import evenly
from docdepth.geometry.scan_mesh import share_in_triangles
from docdepth.odometry.pose_checks import check_period

SAMPLES = 10
"""Sweeps and images that are opened: the first, the last, and some between."""

_MESHES = 5  # sweeps whose mesh is made to see whether their returns have neighbours
_FEWEST_POINTS = 100  # of a sweep; a LiDAR of one plane has more
_ONE_PLACE = 1.0  # metres within which no sweep has all its points
_FARTHEST = 250.0  # metres; half of the points of no sweep lie farther away
_GAP = 0.2  # share of rows in one piece that are not finite
_LONG = 1.8  # of the usual time between sweeps: one is missing
_CLOSE = 0.3  # and this share is too little; stamps of arrival stay above 0.5
_USABLE = 0.7  # of the share of usable points that sweeps of the drive usually have
_SHORTEST = 0.04  # seconds; some LiDARs turn 20 times a second, none much faster
_SECTORS = 72  # around the LiDAR, of 5 degrees
_SAME_DIRECTIONS = 0.5  # share of its sectors that a sweep has in common with the next one
_SMALL = 0.7  # share of the size of those around below which a sweep is partial
_AROUND = 5  # sweeps before and after
_LATE = 1.5  # durations of a sweep after its stamp; no point is measured later
_REGISTERED = 0.05  # share of the points within the ranges that odometry takes


def sample(count: int, most: int = SAMPLES) -> list[int]:
    """Indices spread over ``range(count)``, with the first and the last."""
    return np.unique(np.linspace(0, count - 1, min(most, count)).round().astype(int)).tolist()


def check_sweeps(
    recording: Dataset,
    files: list[list[Path]],
    parameters: Parameters,
    has_poses: bool,
) -> tuple[dict[int, Sweep], list[Finding]]:
    """Check times, sizes and sampled sweeps.

    Parameters
    ----------
    has_poses : bool
        Given poses need no odometry, so sweeps may be taken seldom: by a scanner that is carried
        from place to place.

    Returns
    -------
    sweeps : dict of int to Sweep
        Those that could be read, by index.
    findings : list of Finding
    """
    sizes = np.array([_size(of_sweep[0]) if of_sweep else 0 for of_sweep in files], np.int64)
    found = [*_check_period(recording, has_poses), *_check_sizes(files, sizes)]
    found += _check_repeats(files, sizes)
    opened: dict[int, Sweep] = {}
    broken: list[DocDepthError] = []
    sampled = sample(len(recording))
    for index in sampled:
        with collect_errors(broken):
            sweep = recording.sweep(index)
            place = f"{files[index][0] if files[index] else sweep.name} (frame {index})"
            found += check_sweep(sweep, place)
            with collect_findings(found):
                _check_parameters(sweep, place, parameters)
                opened[index] = sweep
    found += broken_frames_found(broken, len(sampled))
    found += _check_usable_shares(opened, recording)
    if not any(finding.code == "mini-sweeps" for finding in found):
        found += _find_parts_of_turns(recording, opened)
    return opened, found


def _find_parts_of_turns(recording: Dataset, opened: dict[int, Sweep]) -> list[Finding]:
    """Whether a sweep and the next one look in different directions, as halves of a turn do."""
    for k, sweep in opened.items():
        if k + 1 == len(recording):
            continue
        with suppress(DatasetError):
            seen = [
                _directions(one) for one in (sweep, opened.get(k + 1) or recording.sweep(k + 1))
            ]
            least = min(map(np.count_nonzero, seen))
            if np.count_nonzero(seen[0] & seen[1]) >= _SAME_DIRECTIONS * least:
                return []  # also where one is empty
            turn = float(np.median(np.diff(recording.times))) * 1e-9 * round(_SECTORS / least)
            return [
                Finding(
                    "mini-sweeps",
                    str(recording.path),
                    f"frames {k} and {k + 1} look in different directions: they are parts "
                    "of a turn",
                    f"join them: say sweep_duration: {turn:.2g} in docdepth.yaml",
                )
            ]
    return []


def _directions(sweep: Sweep) -> NDArray[np.bool_]:
    """Which sectors around the LiDAR hold returns of a sweep, (_SECTORS,)."""
    x, y, _ = sweep.points[usable_points(sweep.points)].T
    sectors = (np.arctan2(y, x) / (2 * np.pi) * _SECTORS).astype(int) % _SECTORS
    counts = np.bincount(sectors, minlength=_SECTORS)
    return counts > 0.1 * counts.mean()


def broken_frames_found(broken: list[DocDepthError], count: int) -> list[Finding]:
    """Which of so many frames are broken; if most are, none can be left out."""
    few = suggest_skipping if 2 * len(broken) <= count else nullcontext
    found: list[Finding] = []
    for error in broken:
        with collect_findings(found), few():
            raise error
    return found


def check_sweep(sweep: Sweep, place: str) -> list[Finding]:
    """Check points and times of one sweep."""
    found = _check_points(sweep, place)
    _check_times(sweep, place)
    return found


def find_lonely_returns(read: Callable[[int], LidarFrame], count: int) -> list[Finding]:
    """Whether returns lack neighbours: they were not measured from where they are seen.

    A few of ``count`` sweeps are read, usable returns alone.
    """
    frames = map(read, evenly(count, _MESHES))
    shares = [share_in_triangles(f.points, f.sensor_rig) for f in frames if len(f)]
    if not shares or np.median(shares) >= LEAST_IN_TRIANGLES:
        return []
    return [
        Finding(
            "lonely-returns",
            "",
            f"only {100 * np.median(shares):.0f} % of the returns have neighbours in their sweep: "
            "the points may be merged of several LiDARs, or be in the vehicle's frame",
            "say with sensor_origin in docdepth.yaml where the LiDAR is",
        )
    ]


def find_sensor_origin(recording: Dataset) -> tuple[SensorOrigin | None, list[Finding]]:
    """Where rays begin if they clearly do not begin at the origin, and that they do."""
    viewpoint = None if recording.name == "run" else estimate_sensor_origin(recording)
    if viewpoint is None or viewpoint.share < LEAST_IN_TRIANGLES:
        return None, []
    places = " and ".join("[{:g}, {:g}, {:g}]".format(*place) for place in viewpoint.places)
    text = (
        f"seen from the origin, {100 * viewpoint.at_origin:.0f} % of the returns have neighbours "
        f"in their sweep, from {places} {100 * viewpoint.share:.0f} %: rays are taken to begin "
        "there"
    )
    remedy = (
        "its points are of several LiDARs, one after the other; bring them as several if you can"
        if len(viewpoint.places) > 1
        else "say by sensor_origin in docdepth.yaml where the LiDAR is if you know it, and bring "
        "several LiDARs as several"
    )
    return viewpoint, [Finding("sensor-origin", str(recording.path), text, remedy)]


def _check_period(recording: Dataset, has_poses: bool) -> list[Finding]:
    if len(recording) < 2:
        return []
    try:
        period = check_period(recording)
    except OdometryError as error:
        found = Finding.of(error)
        return [replace(found, severity="warning") if has_poses else found]
    where, gaps = str(recording.path), np.diff(recording.times) * 1e-9
    found_gaps = _check_gaps(where, gaps, period)
    if period > _SHORTEST:
        return found_gaps
    text = (
        f"sweeps are {period:.2g} s apart, and a LiDAR takes 0.05 s or longer for one: these are "
        "parts of sweeps"
    )
    remedy = "join them: say sweep_duration: 0.1 in docdepth.yaml, for a LiDAR of 10 Hz"
    return [Finding("mini-sweeps", where, text, remedy), *found_gaps]


def _check_gaps(where: str, gaps: NDArray[np.float64], period: float) -> list[Finding]:
    found = []
    longest, shortest = int(np.argmax(gaps)), int(np.argmin(gaps))
    if gaps[longest] > _LONG * period:
        text = (
            f"{gaps[longest]:.2f} s lie between frames {longest} and {longest + 1}, usually "
            f"{period:.2f} s; are sweeps missing? Depth near the gap rests on fewer sweeps"
        )
        found.append(Finding("sweep-gap", where, text))
    if gaps[shortest] < _CLOSE * period:
        text = (
            f"{gaps[shortest]:.2g} s lie between frames {shortest} and {shortest + 1}, usually "
            f"{period:.2f} s; did the clock of the LiDAR jump back, or are there sweeps of two "
            "LiDARs?"
        )
        found.append(Finding("sweeps-too-close", where, text))
    return found


def _size(file: Path) -> int:
    """Bytes of a file; 0 where it cannot be read."""
    try:
        return file.stat().st_size
    except OSError:
        return 0


def _check_sizes(files: list[list[Path]], sizes: NDArray[np.int64]) -> list[Finding]:
    if len(sizes) < 2:
        return []
    around = np.pad(sizes, _AROUND, mode="reflect")
    usual = np.median(np.lib.stride_tricks.sliding_window_view(around, 2 * _AROUND + 1), axis=1)
    small = np.flatnonzero(sizes < _SMALL * usual)
    if not len(small):
        return []
    first = int(small[0])
    text = (
        f"{files[first][0]} (frame {first}) has {sizes[first]} bytes, the sweeps around it "
        f"{usual[first]:.0f}{_more(len(small) - 1)}"
    )
    return [Finding("partial-sweep", "", text, "copy partial sweeps again or remove them")]


def _check_repeats(files: list[list[Path]], sizes: NDArray[np.int64]) -> list[Finding]:
    """No two sweeps of a real LiDAR are the same to the last bit."""
    repeated = [
        k
        for k in (np.flatnonzero(np.diff(sizes) == 0) + 1).tolist()
        if files[k - 1]
        and files[k]
        and files[k - 1][0] != files[k][0]  # a bag holds many sweeps
        and cmp(files[k - 1][0], files[k][0], shallow=False)
    ]
    if not repeated:
        return []
    first = repeated[0]
    text = (
        f"{files[first][0]} (frame {first}) is a copy of the sweep before it"
        f"{_more(len(repeated) - 1)}; nothing moves between them"
    )
    remedy = "copy the recording again, or remove the sweeps and their times"
    return [Finding("repeated-sweep", "", text, remedy)]


def _more(count: int) -> str:
    return f", and {count} more are like it" if count else ""


def _check_points(sweep: Sweep, place: str) -> list[Finding]:
    usable = usable_points(sweep.points)
    points = sweep.points[usable]
    if len(points) < _FEWEST_POINTS:
        near = np.sum(np.abs(sweep.points[~usable]).max(axis=1, initial=0) < 1)
        raise DatasetError(
            f"{place} has {len(points)} usable points of {len(usable)}: {near} lie within 0.5 m "
            f"of the origin, {np.sum(~usable) - near} are NaN or beyond 100 km",
            "copy the sweep again, or give metres",
            code="empty-sweep",
        )
    if np.ptp(points, axis=0).max() < _ONE_PLACE:
        x, y, z = np.median(points, axis=0)
        raise DatasetError(
            f"{place}: all points lie in one place, ({x:.2f}, {y:.2f}, {z:.2f}) m",
            "coordinates are in metres, x y z reflectance as 4 float32",
            code="one-place",
        )
    distance = float(np.median(np.linalg.norm(points.astype(np.float64), axis=1)))
    if distance > _FARTHEST:
        raise DatasetError(
            f"{place}: points lie {distance:.0f} m away (median)",
            "coordinates are in metres, in the frame of the LiDAR; convert them",
            code="not-metres",
        )
    finite = np.isfinite(sweep.points).all(axis=1)
    begin, length = _longest_run(np.logical_not(finite))
    if length <= _GAP * len(usable):
        return []
    text = (
        f"{length} of {len(usable)} points in one piece, from row {begin}, are not finite; the "
        "LiDAR or its recording failed meanwhile"
    )
    return [Finding("not-finite", place, text, "leave the sweep out")]


def _check_usable_shares(opened: dict[int, Sweep], recording: Dataset) -> list[Finding]:
    """Sweeps with far fewer usable points than the others."""
    shares = {k: float(usable_points(sweep.points).mean()) for k, sweep in opened.items()}
    usual = float(np.median(list(shares.values()))) if shares else 0.0
    return [
        Finding(
            "few-usable",
            str(recording.path),
            f"{100 * share:.0f} % of the points of sweep {opened[index].name} (frame {index}) are "
            f"usable, of other sweeps {100 * usual:.0f} %",
            "copy the sweep again, or leave it out of the recording",
        )
        for index, share in shares.items()
        if share < _USABLE * usual
    ]


def _longest_run(flags: NDArray[Any]) -> tuple[int, int]:
    """Begin and length of the longest piece of true flags."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    begins, lengths = edges[::2], edges[1::2] - edges[::2]
    if not len(begins):
        return 0, 0
    longest = int(lengths.argmax())
    return int(begins[longest]), int(lengths[longest])


def _check_times(sweep: Sweep, place: str) -> None:
    late = sweep.relative_time
    if late is None or not np.isfinite(late).any():
        return
    if not sweep.motion_compensated and not np.isfinite(late[usable_points(sweep.points)]).all():
        raise DatasetError(
            f"{place}: a usable point has no finite time", "mend its times", code="point-times"
        )
    first, last = float(np.nanmin(late)), float(np.nanmax(late))
    if first < -_LATE or last > _LATE:
        raise DatasetError(
            f"{place}: points are measured {first:.3g} to {last:.3g} sweeps after the stamp",
            "times of points are shares of the sweep's duration, -1 to 1",
            code="point-times",
        )


def _check_parameters(sweep: Sweep, place: str, parameters: Parameters) -> None:
    """Parameters that leave nothing of the sweep."""
    odometry = parameters.odometry
    points = sweep.points[usable_points(sweep.points)]
    distance = np.linalg.norm(points, axis=1)
    kept = float(np.mean((distance > odometry.min_range) & (distance < odometry.max_range)))
    if kept < _REGISTERED:
        raise DatasetError(
            f"odometry.min_range={odometry.min_range:g} and max_range={odometry.max_range:g} leave "
            f"{100 * kept:.0f} % of the points of {place}",
            "set wider ranges",
            code="out-of-range",
        )
    if odometry.blooming_deg and sweep.intensity is None:
        raise DatasetError(
            f"{place} has no intensity, which tells reflectors",
            "leave odometry.blooming_deg at 0",
            code="no-intensity",
        )
