"""Checks of the sweeps: some are opened, the sizes of all are compared."""

from __future__ import annotations

from contextlib import nullcontext
from filecmp import cmp
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.config import Parameters
from docdepth.datasets import Dataset, Sweep, usable_points
from docdepth.datasets.tolerance import reading_a_frame
from docdepth.errors import Collector, DatasetError, OdometryError
from docdepth.odometry.pose_checks import check_period
from docdepth.pipeline.problems import Findings

SAMPLES = 10
"""Sweeps and images that are opened: the first, the last, and some between."""

_FEWEST_POINTS = 100  # of a sweep; a LiDAR of one plane has more
_ONE_PLACE = 1.0  # metres within which no sweep has all its points
_FARTHEST = 250.0  # metres; half of the points of no sweep lie farther away
_GAP = 0.2  # share of rows in one piece that are not finite
_PAUSE = 1.8  # of the usual time between sweeps: one is missing
_CLOSE = 0.3  # and this share is too little; stamps of arrival stay above 0.5
_USABLE = 0.7  # of the share of usable points that sweeps of the drive usually have
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
    found: Findings,
    has_poses: bool = False,
) -> dict[int, Sweep]:
    """Check times, sizes and sampled sweeps; returns those that could be read, by index.

    ``files`` are those of each sweep. Given poses need no odometry, so sweeps may be taken seldom:
    by a scanner that is carried from place to place.
    """
    _check_period(recording, found, has_poses)
    sizes = np.array([_size(of_sweep[0]) if of_sweep else 0 for of_sweep in files], np.int64)
    _check_sizes(files, sizes, found)
    _check_repeats(files, sizes, found)
    opened: dict[int, Sweep] = {}
    broken, sampled = Collector(), sample(len(recording))
    for index in sampled:
        with broken.collected():
            sweep = recording.sweep(index)
            place = f"{files[index][0] if files[index] else sweep.name} (frame {index})"
            check_sweep(sweep, place, found)
            with found.collected():
                _check_parameters(sweep, place, parameters)
                opened[index] = sweep
    tell_broken(broken, len(sampled), found)
    _check_usable_shares(opened, recording, found)
    return opened


def tell_broken(broken: Collector, count: int, found: Findings) -> None:
    """Tell which of so many frames are broken; if most are, none can be left out."""
    few = reading_a_frame if 2 * len(broken.errors) <= count else nullcontext
    for error in broken.errors:
        with found.collected(), few():
            raise error


def check_sweep(sweep: Sweep, place: str, found: Findings) -> None:
    """Check points and times of one sweep.

    Raises
    ------
    DatasetError
        It is broken.
    """
    _check_points(sweep, place, found)
    _check_times(sweep, place)


def _check_period(recording: Dataset, found: Findings, has_poses: bool) -> None:
    if len(recording) < 2:
        return
    try:
        period = check_period(recording)
    except OdometryError as error:
        tell = found.warn if has_poses else found.error
        tell(str(error))
    else:
        _check_pauses(recording, np.diff(recording.times) * 1e-9, period, found)


def _check_pauses(
    recording: Dataset, pauses: NDArray[np.float64], period: float, found: Findings
) -> None:
    longest = int(np.argmax(pauses))
    if pauses[longest] > _PAUSE * period:
        found.warn(
            f"{recording.path}: {pauses[longest]:.2f} s lie between frames {longest} and "
            f"{longest + 1}, usually {period:.2f} s; are sweeps missing? Depth near the gap rests "
            "on fewer sweeps"
        )
    shortest = int(np.argmin(pauses))
    if pauses[shortest] < _CLOSE * period:
        found.warn(
            f"{recording.path}: {pauses[shortest]:.2g} s lie between frames {shortest} and "
            f"{shortest + 1}, usually {period:.2f} s; did the clock of the LiDAR jump back, or are "
            "there sweeps of two LiDARs?"
        )


def _size(file: Path) -> int:
    """Bytes of a file; 0 where it cannot be read."""
    try:
        return file.stat().st_size
    except OSError:
        return 0


def _check_sizes(files: list[list[Path]], sizes: NDArray[np.int64], found: Findings) -> None:
    if len(sizes) < 2:
        return
    around = np.pad(sizes, _AROUND, mode="reflect")
    usual = np.median(np.lib.stride_tricks.sliding_window_view(around, 2 * _AROUND + 1), axis=1)
    small = np.flatnonzero(sizes < _SMALL * usual)
    if len(small):
        first = int(small[0])
        found.warn(
            f"{files[first][0]} (frame {first}) has {sizes[first]} bytes, the sweeps around it "
            f"{usual[first]:.0f}{_more(len(small) - 1)}; copy partial sweeps again or remove them"
        )


def _check_repeats(files: list[list[Path]], sizes: NDArray[np.int64], found: Findings) -> None:
    """No two sweeps of a real LiDAR are the same to the last bit."""
    repeated = [
        k
        for k in (np.flatnonzero(np.diff(sizes) == 0) + 1).tolist()
        if files[k - 1] and files[k] and _are_copies(files[k - 1][0], files[k][0])
    ]
    if repeated:
        first = repeated[0]
        found.warn(
            f"{files[first][0]} (frame {first}) is a copy of the sweep before it"
            f"{_more(len(repeated) - 1)}; nothing moves between them: copy the recording again, "
            "or remove the sweeps and their times"
        )


def _are_copies(one: Path, other: Path) -> bool:
    return one != other and cmp(one, other, shallow=False)  # a bag holds many sweeps


def _more(count: int) -> str:
    return f", and {count} more are like it" if count else ""


def _check_points(sweep: Sweep, place: str, found: Findings) -> None:
    usable = usable_points(sweep.points)
    points = sweep.points[usable]
    if len(points) < _FEWEST_POINTS:
        raise DatasetError(
            f"{place} has {len(points)} usable points of {len(usable)}; copy the sweep again"
        )
    if np.ptp(points, axis=0).max() < _ONE_PLACE:
        x, y, z = np.median(points, axis=0)
        raise DatasetError(
            f"{place}: all points lie in one place, ({x:.2f}, {y:.2f}, {z:.2f}) m; coordinates are "
            "in metres, x y z reflectance as 4 float32"
        )
    distance = float(np.median(np.linalg.norm(points.astype(np.float64), axis=1)))
    if distance > _FARTHEST:
        raise DatasetError(
            f"{place}: points lie {distance:.0f} m away (median); coordinates are in metres, in "
            "the frame of the LiDAR; convert them"
        )
    finite = np.isfinite(sweep.points).all(axis=1)
    begin, length = _longest_run(np.logical_not(finite))
    if length > _GAP * len(usable):
        found.warn(
            f"{place}: {length} of {len(usable)} points in one piece, from row {begin}, are not "
            "finite; the LiDAR or its recording failed meanwhile: leave the sweep out"
        )


def _check_usable_shares(opened: dict[int, Sweep], recording: Dataset, found: Findings) -> None:
    """Sweeps with far fewer usable points than the others."""
    shares = {k: float(usable_points(sweep.points).mean()) for k, sweep in opened.items()}
    usual = float(np.median(list(shares.values()))) if shares else 0.0
    for index, share in shares.items():
        if share < _USABLE * usual:
            found.warn(
                f"{recording.path}: {100 * share:.0f} % of the points of sweep "
                f"{opened[index].name} (frame {index}) are usable, of other sweeps "
                f"{100 * usual:.0f} %; copy the sweep again, or leave it out of the recording"
            )


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
        raise DatasetError(f"{place}: a usable point has no finite time; mend its times")
    first, last = float(np.nanmin(late)), float(np.nanmax(late))
    if first < -_LATE or last > _LATE:
        raise DatasetError(
            f"{place}: points are measured {first:.3g} to {last:.3g} sweeps after the stamp; times "
            "of points are shares of the sweep's duration, -1 to 1"
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
            f"{100 * kept:.0f} % of the points of {place}; set wider ranges"
        )
    if odometry.blooming_deg and sweep.intensity is None:
        raise DatasetError(
            f"{place} has no intensity, which tells reflectors; leave odometry.blooming_deg at 0"
        )
