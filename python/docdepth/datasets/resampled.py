"""Sweeps of another duration than the recording's: joined or cut by the times of their points."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.base import LidarStream
from docdepth.datasets.cloud import Cloud, LidarReader, joined_columns
from docdepth.datasets.files import OpenedOnce
from docdepth.datasets.point_times import LONGEST, PointTimes, TimeSample, median_period
from docdepth.datasets.pose_tables import continue_ends
from docdepth.errors import DatasetError
from docdepth.geometry.points import usable_points
from docdepth.geometry.trajectory import Trajectory

_LEAST = 0.5  # of the duration that measured sweeps must cover; a rest is no sweep
_KEPT = 4  # clouds beyond those of one sweep that stay in memory for the next one


class Piece(NamedTuple):
    """Rows (n,) of measured sweep ``own`` that belong to a joined one."""

    own: int
    rows: NDArray[np.int64]
    cloud: Cloud
    times: NDArray[np.int64]


@dataclass
class ResampledLidar:
    """A LiDAR whose points are divided into sweeps from ``starts[k]`` to ``starts[k] + duration``.

    Points keep the order in which they were recorded. Every point is in the one sweep of its own
    time; rows without a return, whose times mean nothing, may be anywhere.
    """

    measured: LidarReader  # its sweeps as they were recorded
    point_times: PointTimes  # how their points count times
    starts: NDArray[np.int64]  # (m,): Nanoseconds
    duration: int  # nanoseconds
    _clouds: OpenedOnce[OrderedDict[int, tuple[Cloud, NDArray[np.int64]]]] = field(
        default_factory=partial(OpenedOnce, OrderedDict)
    )

    def span(self) -> tuple[int, int]:
        """Nanoseconds from the stamp to the first and the last point, of a few sweeps."""
        stamps = self.measured.stream.times
        late = [
            self._late(self.measured.read(own), int(stamps[own]), own)
            for own in sorted({0, len(stamps) // 2, len(stamps) - 1})
        ]
        return min(int(own.min()) for own in late), max(int(own.max()) for own in late)

    @property
    def stream(self) -> LidarStream:
        """Stamps are the starts of its sweeps."""
        names = [str(start) for start in self.starts.tolist()]
        return replace(self.measured.stream, times=self.starts, names=names)

    def read(self, index: int) -> Cloud:
        """Sweep ``index``; times of its points are nanoseconds on the clock of the stamps."""
        clouds, times, no_rows = [], [], np.zeros(0, np.int64)
        for piece in self.pieces(index):
            clouds.append(_part_of(piece.cloud, piece.rows))
            times.append(piece.times[piece.rows])
        if not clouds:  # a LiDAR beside the first one may pause
            nearest = int(np.abs(self.measured.stream.times - self.starts[index]).argmin())
            clouds, times = [_part_of(self._read(nearest, _KEPT)[0], no_rows)], [no_rows]
        return Cloud(
            np.concatenate([cloud.points for cloud in clouds]),
            joined_columns([cloud.intensity for cloud in clouds]),
            joined_columns([cloud.ring for cloud in clouds]),
            np.concatenate(times),
        )

    def files(self, index: int) -> list[Path]:
        """The files of all sweeps that may hold points of it."""
        files = [file for own in self._near(index) for file in self.measured.files(own)]
        return list(dict.fromkeys(files))

    def _near(self, index: int) -> range:
        """Measured sweeps that may hold points of a sweep: no point is farther from its stamp."""
        stamps, start = self.measured.stream.times, int(self.starts[index])
        reach = int(LONGEST * self.point_times.period)
        first = int(np.searchsorted(stamps, start - reach))
        return range(first, int(np.searchsorted(stamps, start + self.duration + reach, "right")))

    def pieces(self, index: int) -> list[Piece]:
        """The measured sweeps that sweep ``index`` is made of, and nanoseconds of their points."""
        start, found = int(self.starts[index]), []
        near = self._near(index)
        for own in near:
            cloud, times = self._read(own, len(near) + _KEPT)
            rows = np.flatnonzero((times >= start) & (times < start + self.duration))
            if len(rows):
                found.append(Piece(own, rows, cloud, times))
        return found

    def _read(self, own: int, most: int) -> tuple[Cloud, NDArray[np.int64]]:
        """A measured sweep, and nanoseconds of its points; sweeps in turn share most of them."""
        with self._clouds as clouds:
            if own in clouds:
                clouds.move_to_end(own)
                return clouds[own]
        cloud = self.measured.read(own)
        stamp = int(self.measured.stream.times[own])
        times = stamp + self._late(cloud, stamp, own)
        with self._clouds as clouds:
            clouds[own] = cloud, times
            while len(clouds) > most:
                clouds.popitem(last=False)
        return cloud, times

    def _late(self, cloud: Cloud, stamp: int, own: int) -> NDArray[np.int64]:
        """Nanoseconds from the stamp to each point."""
        relative = None
        if cloud.times is not None:
            sample = TimeSample(cloud.times, usable_points(cloud.points), stamp)
            relative = self.point_times.relative(sample)
        if relative is None:
            where = self.measured.files(own)[0]
            raise DatasetError(
                f"{where} (frame {own}): points have no times of this sweep, which sweep_duration "
                "needs; leave it out of docdepth.yaml"
            )
        shares = np.nan_to_num(relative, nan=0.0).astype(np.float64)
        return np.rint(shares * self.point_times.period).astype(np.int64)


def resample(
    lidars: Sequence[LidarReader],
    poses: NDArray[np.float64] | None,
    duration: float,
    point_times: Sequence[PointTimes | None],
    path: Path,
) -> tuple[list[ResampledLidar], NDArray[np.float64] | None]:
    """LiDARs with sweeps of ``duration`` seconds, and poses at the new stamps.

    The sweeps of all are those of the first one's times. ``poses`` (n, 4, 4) are NaN where they are
    not known. ``point_times`` are those of each LiDAR. Times of points have to be known, and there
    has to be at least half of a sweep.
    """
    nanoseconds = round(duration * 1e9)
    starts = None
    result: list[ResampledLidar] = []
    for lidar, known in zip(lidars, point_times, strict=True):
        if known is None:
            raise DatasetError(
                f"{path}, {lidar.stream.name}: points have no times, which sweep_duration needs; "
                "leave it out of docdepth.yaml"
            )
        found = ResampledLidar(lidar, known, np.zeros(0, np.int64), nanoseconds)
        if starts is None:
            starts = sweep_starts(lidar.stream.times, found.span(), nanoseconds)
        result.append(replace(found, starts=starts))
    if starts is None or not len(starts):
        raise DatasetError(f"{path} is shorter than a sweep of {duration:g} s")
    if poses is None:
        return result, None
    known_poses = np.isfinite(poses).all(axis=(1, 2))
    moved = np.full((len(starts), 4, 4), np.nan)
    if known_poses.any():
        trajectory = Trajectory(lidars[0].stream.times[known_poses], poses[known_poses])
        inside = trajectory.covers(starts)
        moved[inside] = trajectory.interpolate(starts[inside])
        moved = continue_ends(moved, trajectory.times, trajectory.poses, starts)
    return result, moved


def sweep_starts(
    stamps: NDArray[np.int64], span: tuple[int, int], duration: int
) -> NDArray[np.int64]:
    """Starts (m,) of sweeps of a duration, one after the other, where the LiDAR measured.

    ``span`` is from the stamp of a measured sweep to its first and its last point; all are
    nanoseconds. Sweeps that were measured for less than half of their duration, as at the end and
    in gaps, are left out.
    """
    first, last = stamps + span[0], stamps + span[1]
    begin = max(int(first.min()), 0)  # runs keep no stamps before zero
    starts = begin + duration * np.arange(-(-int(last.max() - begin) // duration), dtype=np.int64)
    covered = np.zeros(len(starts))
    pause = median_period(stamps) or 0
    for a, b in zip(first.tolist(), np.maximum(last, first + pause).tolist(), strict=True):
        for k in range(max((a - begin) // duration, 0), int(-(-(b - begin) // duration))):
            if k < len(starts):
                covered[k] += min(b, int(starts[k]) + duration) - max(a, int(starts[k]))
    return starts[covered >= _LEAST * duration]


def _part_of(cloud: Cloud, rows: NDArray[np.int64]) -> Cloud:
    return Cloud(
        cloud.points[rows],
        None if cloud.intensity is None else cloud.intensity[rows],
        None if cloud.ring is None else cloud.ring[rows],
    )
