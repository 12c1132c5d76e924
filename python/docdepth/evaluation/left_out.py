"""What is left out of a depth map and compared with it: a sweep, a part of it, or a LiDAR."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from docdepth.config import DynamicsParameters
from docdepth.dynamics.voting import KeyFrame, vote
from docdepth.errors import InputError
from docdepth.geometry.lidar_frame import LidarFrame, LidarView, SensorRig, lidar_views
from docdepth.geometry.points import elevation_of
from docdepth.geometry.scan_mesh import ScanMesh
from docdepth.geometry.se3 import inverse

_MANY_LASERS = 4  # a rig of more places knows each laser, as that of KITTI's LiDAR
_PIXEL_DEG = 0.05  # of the picture in which returns are looked up; half a pixel of most cameras
_BAND_DEG = 0.2  # least height of a beam; returns of sharper ones lie together


class Neighbour(NamedTuple):
    """A sweep near the evaluated one, and ``T_neighbour_lidar``, (4, 4)."""

    frame: LidarFrame
    T_neighbour_lidar: NDArray[np.float64]


@dataclass(frozen=True)
class LeftOut:
    """Which returns are left out of the depth and then compared with it.

    Attributes
    ----------
    lidar : int, optional
        A LiDAR of the rig, left out of all sweeps. Without any of these a whole sweep is.
    beams : int, optional
        Every n-th beam of the sweep; its other beams and all other sweeps are drawn.
    sectors : float, optional
        Every second sector of so many degrees of the sweep; its other sectors and all other sweeps
        are drawn.
    """

    lidar: int | None = None
    beams: int | None = None
    sectors: float | None = None

    def __post_init__(self) -> None:
        if sum(part is not None for part in (self.lidar, self.beams, self.sectors)) > 1:
            raise InputError("leave out beams, sectors or a LiDAR, not several of them")
        if self.sectors is not None and not 1 <= self.sectors <= 180:
            raise InputError(
                f"sectors of {self.sectors:g} degrees cannot be left out; give 1 to 180"
            )
        if self.beams is not None and self.beams < 2:
            raise InputError(f"every {self.beams}-th beam cannot be left out; 2 leaves out half")

    @property
    def whole_sweep(self) -> bool:
        """Whether nothing of the evaluated sweep is drawn."""
        return self.lidar is None and self.beams is None and self.sectors is None

    def view(self, frame: LidarFrame) -> LidarView:
        """The returns that are left out, as their LiDAR saw them; other rows are NaN."""
        views = {number: view for number, view in _by_number(frame)}
        number = min(views) if self.lidar is None else self.lidar
        if number not in views or (self.lidar is not None and len(views) < 2):
            raise InputError(
                f"sweep {frame.name} has returns of LiDAR {', '.join(map(str, views))}; LiDAR "
                f"{self.lidar} cannot be left out. LiDARs count from 0",
                "`docdepth.diagnostics.recording_report.inspect_recording()` lists them",
            )
        if self.beams is None and self.sectors is None:
            return views[number]
        points = views[number].points.copy()
        points[~self.rows(frame)] = np.nan
        return views[number]._replace(points=points)

    def rows(self, frame: LidarFrame) -> NDArray[np.bool_]:
        """Rows of a sweep that are not drawn, (N,)."""
        if self.lidar is not None:
            rig = frame.sensor_rig
            number = np.zeros(len(frame)) if rig is None else rig.lidar_id[rig.index]
            return np.asarray(number == self.lidar)
        if self.whole_sweep:
            return np.ones(len(frame.points), np.bool_)
        _, view = next(_by_number(frame))
        own = np.isfinite(view.points).all(axis=1)
        if self.sectors is not None:
            sector = np.floor(_directions(view.motion_corrected())[:, 0] / self.sectors)
            return np.asarray((sector % 2 == 0) & own)
        assert self.beams is not None
        return np.asarray((beam_of(view, frame.sensor_rig) % self.beams == self.beams // 2) & own)

    def clear(self, frame: LidarFrame, neighbours: Iterable[Neighbour] = ()) -> NDArray[np.bool_]:
        """Which returns can be compared to the pixel, (N,): it is clear what their pixel shows.

        A return beside a depth edge of its own sweep may fall into a pixel of the other side. Where
        a LiDAR of a rig was left out, the others tell two things more. A return between the two
        sides of a depth edge of theirs may belong to either: nothing was measured there. A single
        sweep may miss a thin post, so neighbouring sweeps are asked as well. And what they could
        not see at that time is hidden from where they stand: no ray of their sweep ended there or
        passed behind it, which is how a key frame votes.
        """
        own, rig = self.rows(frame), frame.sensor_rig
        view = LeftOut(self.lidar).view(frame)
        clear = ~beside_edges(view)
        if self.lidar is None or rig is None:
            return clear
        for sweep in (Neighbour(frame, np.eye(4)), *neighbours):
            T = sweep.T_neighbour_lidar.astype(np.float32)
            points = frame.points @ T[:3, :3].T + T[:3, 3]
            for number, other in _by_number(sweep.frame):
                if number != self.lidar:
                    clear &= ~between_sides(points, other)
        others = frame.points.copy()
        others[own] = np.nan
        flat = np.zeros(len(own), np.bool_)
        mesh = KeyFrame(others, flat, DynamicsParameters(vote_model="surface"), None, rig)
        votes = vote(frame.points, flat, np.eye(4), [mesh], np.eye(4)[None], threads=1)
        return np.asarray(clear & (votes.static + votes.dynamic > 0))

    def __str__(self) -> str:
        """In words, for the title of a table."""
        if self.lidar is not None:
            return f"sweeps of LiDAR {self.lidar}, which was left out"
        if self.beams is not None:
            return f"sweeps of which every {self.beams}-th beam was left out"
        if self.sectors is not None:
            return f"sweeps of which every second sector of {self.sectors:g} degrees was left out"
        return "held-out sweeps"


def _by_number(frame: LidarFrame) -> Iterator[tuple[int, LidarView]]:
    """The views of a sweep with the numbers of their LiDARs."""
    rig = frame.sensor_rig
    numbers = [0] if rig is None else sorted(set(rig.lidar_id.tolist()))
    yield from zip(numbers, lidar_views(frame.points, rig), strict=True)


def beam_of(view: LidarView, rig: SensorRig | None) -> NDArray[np.int64]:
    """The beam of each return, numbers from below or from above, (N,).

    The laser where the rig knows it; else bands of elevation as high as the returns are apart.
    """
    if rig is not None and len(rig.T_lidar_sensor) > _MANY_LASERS:
        return rig.index.astype(np.int64)
    points = view.motion_corrected().astype(np.float64)
    with np.errstate(invalid="ignore"):
        elevation = np.degrees(elevation_of(points))
    band = np.maximum(_BAND_DEG, _spacing_deg(view))
    return np.nan_to_num(np.floor(elevation / band), nan=-1).astype(np.int64)


def beside_edges(view: LidarView) -> NDArray[np.bool_]:
    """Returns that a triangle over a depth jump joins to another one, (N,)."""
    points, mesh = _mesh(view)
    found = np.zeros(len(points), np.bool_)
    found[mesh.triangles[mesh.discontinuity].ravel()] = True
    return found


def between_sides(points: NDArray[np.float32], view: LidarView) -> NDArray[np.bool_]:
    """Which points lie, as a LiDAR sees them, in a triangle over a depth jump of its sweep, (N,).

    Or half a pixel of a camera beside it: a pixel shows what its middle meets.

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)
        LiDAR frame of the sweep [m].
    """
    corners, mesh = _mesh(view)
    directions = _directions(corners)[mesh.triangles[mesh.discontinuity].astype(np.int64)]
    # The shorter way around from the first corner; triangles over the seam are drawn at both ends.
    directions[..., 0] -= 360 * np.rint((directions[..., 0] - directions[:, :1, 0]) / 360)
    turn, height = round(360 / _PIXEL_DEG), round(180 / _PIXEL_DEG)
    image = np.zeros((height + 1, turn + 1), np.uint8)
    pixels = np.rint((directions + (180, 90)) / _PIXEL_DEG).astype(np.int32)
    for triangle in pixels:
        for side in (-turn, 0, turn):
            if triangle[:, 0].max() + side >= 0 and triangle[:, 0].min() + side <= turn:
                cv2.fillConvexPoly(image, triangle + np.array((side, 0), np.int32), 1)
    image = cv2.dilate(image, np.ones((3, 3), np.uint8))
    T = inverse(view.T_lidar_sensor).astype(np.float32)
    places = np.rint((_directions(points @ T[:3, :3].T + T[:3, 3]) + (180, 90)) / _PIXEL_DEG)
    column, row = places.astype(np.int64).T
    return np.asarray(image[row, column] > 0)


def _directions(points: NDArray[np.float32]) -> NDArray[np.float64]:
    """Azimuth and elevation of points, (N, 2) [degrees]; 0 of those that are not finite."""
    x, y, z = points.astype(np.float64).T
    angles = np.degrees([np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))]).T
    return np.nan_to_num(angles)


def _spacing_deg(view: LidarView) -> float:
    """Angle between neighbouring beams: the median height of the triangles of the sweep."""
    points, mesh = _mesh(view)
    corners = points[mesh.triangles[~mesh.discontinuity].astype(np.int64)].astype(np.float64)
    if not len(corners):
        return _BAND_DEG
    elevation = np.degrees(elevation_of(corners))
    return float(np.median(np.ptp(elevation, axis=1)))


def _mesh(view: LidarView) -> tuple[NDArray[np.float32], ScanMesh]:
    points = view.motion_corrected()
    return points, ScanMesh(points)
