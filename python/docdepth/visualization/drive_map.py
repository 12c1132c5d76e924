"""A drive from above: what stands around the path as a picture, and a section of the report."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from docdepth.geometry.points import DYNAMIC, STATIC, usable_points
from docdepth.geometry.se3 import transform_points
from docdepth.geometry.track import Track
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.run_folder import RunFolder
from docdepth.visualization.image_views import track_color
from docdepth.visualization.page import css, embedded, swatches
from docdepth.visualization.pictures import TRACK_COLORS, Picture, round_length

# Heights above ground up to which static points are drawn [m]; crowns of trees hide streets.
_TALL = 3.5
_UNSEEN_TONE, _GROUND_TONE, _LOW_TONE, _TALL_TONE = 255, 228, 190, 60  # grey; from low to _TALL
_PATH_COLOR = (150, 60, 0)  # dark blue

STYLE = """
#map { width: 100%; max-height: 80vh; background: #fff; border: 1px solid #ccc; --px: 1 }
#map polyline { fill: none; vector-effect: non-scaling-stroke; stroke-linejoin: round }
#map .track { stroke-width: 2.5px } #map .track:hover { stroke-width: 6px }
#map .path { stroke-width: 2.5px; stroke-dasharray: 7 4 }
#map polygon { vector-effect: non-scaling-stroke; stroke: #000; stroke-width: 1px }
#map text { font: calc(13px * var(--px)) system-ui, sans-serif; paint-order: stroke; stroke: #fff;
  stroke-width: calc(3px * var(--px)); text-anchor: middle }
@media (max-width: 600px) { #map text { font-size: calc(10px * var(--px)) } }
#map .rule { stroke: #000; stroke-width: 2px; vector-effect: non-scaling-stroke }
"""

# The more, the larger the page.
_PLACES = 20_000  # of all tracks together
_TRACKS = 3000  # those that were seen longest
_POINTS = 3000  # of the path
_EGO = (4.0, 1.8)  # length and width of the vehicle as it is drawn [m]
_REACH = 40.0  # metres around the path that are shown
_STRAY, _MARGIN = 0.01, 2.0  # cells outside the picture, as a share; metres around the others
_CELL = 0.15  # metres; smaller cells stay empty between the beams
_PIXELS = 1400  # of the longer side
_SWEEPS = 150  # at most that many are read, spaced evenly along the path
_SPACING = 1.0  # metres; nearer sweeps show the same
_GROUND_CELL = 2.0  # metres; the ground is flat in such a cell


@dataclass(frozen=True)
class DriveMap:
    """A picture of a drive from above, turned so that the drive goes to the right."""

    # (h, w, 3): grey: white where no beam came, light ground, darker the higher something stands
    picture: Picture
    # angle from the world's x towards y that points to the right in the picture [rad]
    heading: float
    corner: NDArray[np.float64]  # (2,): upper left corner of the picture, in the turned world [m]
    cell: float  # metres a pixel

    def pixels(self, places: NDArray[np.floating]) -> NDArray[np.float64]:
        """Column and row (n, 2) of places in the world (n, 2 or more) [m]."""
        turned = _turned(places, self.heading)
        return (turned - self.corner) * (1, -1) / self.cell


def drive_map(run: RunFolder) -> DriveMap:
    """Draw the static points of a run from above.

    Sweeps are read one at a time, and no more than 150 however long the drive is.
    """
    trajectory = run.trajectory()
    heading = _main_direction(trajectory.poses)
    path = _turned(trajectory.poses[:, :2, 3], heading)
    low, high = path.min(axis=0) - _REACH, path.max(axis=0) + _REACH
    cell = max(_CELL, float((high - low).max()) / _PIXELS)
    columns, rows = np.ceil((high - low) / cell).astype(int)
    empty = DriveMap(
        np.zeros((rows, columns, 3), np.uint8), heading, np.array((low[0], high[1])), cell
    )
    heights = np.full(rows * columns, -1, np.float32)
    for k in _spaced(trajectory):
        record, classid = run.classified_frame(k)
        kept = (classid < DYNAMIC) & usable_points(record.points, 0)
        points = record.points.compress(kept, axis=0)
        above = heights_above_ground(points, classid[kept] < STATIC)
        pose = trajectory.poses[k]
        place = np.floor(empty.pixels(transform_points(pose, points))).astype(np.int64)
        inside = ((place >= 0) & (place < (columns, rows))).all(axis=1) & (above <= _TALL)
        np.maximum.at(heights, place[inside] @ (1, columns), above[inside])
    heights = heights.reshape(rows, columns)
    driven = empty.pixels(trajectory.poses[:, :3, 3])
    across = _filled(heights >= 0, driven[:, 0], 0, cell)
    down = _filled(heights >= 0, driven[:, 1], 1, cell)
    corner = empty.corner + cell * np.array((across.start, -down.start))
    return DriveMap(_toned(heights[down, across]), heading, corner, cell)


def _filled(is_seen: NDArray[np.bool_], path: NDArray[np.float64], axis: int, cell: float) -> slice:
    """The columns (axis 0) or rows (axis 1) that have nearly all seen cells and the path."""
    share = np.cumsum(is_seen.sum(axis=axis)) / max(int(is_seen.sum()), 1)
    low, high = np.searchsorted(share, (_STRAY, 1 - _STRAY))
    low, high = min(int(low), int(path.min())), max(int(high), int(path.max()))
    margin = round(_MARGIN / cell)
    return slice(max(low - margin, 0), min(high + margin, len(share)))


def heights_above_ground(
    points: NDArray[np.float32], is_ground: NDArray[np.bool_]
) -> NDArray[np.float32]:
    """Height of each point of a sweep above the ground below it, or nearest to it [m].

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)
        LiDAR frame [m].

    Returns
    -------
    ndarray of float32, shape (N,)
        0 for ground; all 0 where a sweep has none.
    """
    if not is_ground.any():
        return np.zeros(len(points), np.float32)
    place = np.floor((points[:, :2] - points[:, :2].min(axis=0)) / _GROUND_CELL).astype(np.int64)
    shape = place.max(axis=0) + 1
    flat = place @ (shape[1], 1)
    count = np.bincount(flat[is_ground], minlength=shape.prod())
    total = np.bincount(flat[is_ground], points[is_ground, 2], minlength=shape.prod())
    is_empty = (count == 0).astype(np.uint8).reshape(shape)
    # The label of a cell is that of the nearest cell with ground.
    _, nearest = cv2.distanceTransformWithLabels(
        is_empty, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    level = np.zeros(int(nearest.max()) + 1)
    known = count > 0
    level[nearest.ravel()[known]] = total[known] / count[known]
    above = points[:, 2] - level[nearest.ravel()[flat]]
    return np.where(is_ground, 0, np.maximum(above, 0)).astype(np.float32)


def _spaced(trajectory: Trajectory) -> list[int]:
    """Sweeps to draw, evenly along the path."""
    if len(trajectory) == 1:
        return [0]
    spacing = max(_SPACING, float(trajectory.arc_length[-1]) / (_SWEEPS - 1))
    return [int(k) for k in trajectory.subsample(spacing)][:_SWEEPS]


def _main_direction(poses: NDArray[np.float64]) -> float:
    """Angle of the line along which the path extends most, with the way that was driven [rad]."""
    path = poses[:, :2, 3] - poses[:, :2, 3].mean(axis=0)
    axis = np.linalg.eigh(path.T @ path)[1][:, -1]
    way = path[-1] - path[0]
    if np.ptp(path @ axis) < _SPACING:
        axis = way = poses[0, :2, 0]
    axis = axis if axis @ way >= 0 else -axis
    return float(np.arctan2(axis[1], axis[0]))


def _turned(places: NDArray[np.floating], heading: float) -> NDArray[np.float64]:
    cos, sin = np.cos(heading), np.sin(heading)
    return np.asarray(places[:, :2] @ np.array([(cos, -sin), (sin, cos)]), np.float64)


def _toned(heights: NDArray[np.float32]) -> Picture:
    share = np.clip(heights / _TALL, 0, 1)
    tone = np.rint(_LOW_TONE + (_TALL_TONE - _LOW_TONE) * share)
    tone[heights <= 0] = _GROUND_TONE
    tone[heights < 0] = _UNSEEN_TONE
    return np.repeat(tone.astype(np.uint8)[..., None], 3, axis=2)


def map_section(drawn: DriveMap, trajectory: Trajectory, tracks: Sequence[Track]) -> str:
    """The map with path and tracks, a slider for the time, and a legend."""
    height, width = drawn.picture.shape[:2]
    shown = sorted(sorted(tracks, key=len)[-_TRACKS:], key=lambda track: track.id)
    few = f" (the {len(shown)} of {len(tracks)} that were seen longest)"
    few = few if len(shown) < len(tracks) else ""
    rows = len(trajectory) + sum(len(track) for track in shown)
    times = trajectory.times[:: -(-rows // _PLACES)]  # of every sweep, or fewer in a long drive
    path = _line(drawn.pixels(thinned(trajectory.poses[:, :3, 3], _POINTS)))
    places = max(_PLACES // max(len(shown), 1), 2)
    lines = [
        f'<polyline class=track stroke="{css(track_color(track.id))}" points="'
        f'{_line(drawn.pixels(thinned(track.poses[:, :3, 3], places)))}">'
        f"<title>{escape(_about(track))}</title></polyline>"
        for track in shown
    ]
    return "\n".join([
        f'<svg id=map viewBox="0 0 {width} {height}" role=img aria-label="the drive from above">',
        f'<image width={width} height={height} href="{embedded(drawn.picture, 900_000)}"/>',
        *lines,
        f'<polyline class=path stroke="{css(_PATH_COLOR)}" points="{path}"/>',
        f"<g id=objects></g>{_rule(drawn)}</svg>",
        "<div class=row><button id=play>play</button>",
        f'<input type=range id=time min=0 max={len(times) - 1} value=0 aria-label=time>',
        "<output id=now></output></div>",
        swatches([
            ([(_UNSEEN_TONE,) * 3], "nothing measured"),
            ([(_GROUND_TONE,) * 3], "ground"),
            ([(_LOW_TONE,) * 3], "what stands, low"),
            ([(_TALL_TONE,) * 3], f"{_TALL:g} m high; what is higher is left out"),
            ([_PATH_COLOR], "path of the LiDAR, driven to the right"),
            ([(0, 0, 0)], "the LiDAR"),
            (TRACK_COLORS, f"moving objects, with their numbers{few}"),
        ]),
        "<script type=application/json id=drive>",
        _data(drawn, trajectory, shown, times),
        "</script>",
    ])  # fmt: skip


def thinned(rows: NDArray[Any], most: int) -> NDArray[Any]:
    """No more than so many rows (2 or more), evenly, with the first and the last."""
    if len(rows) <= most:
        return rows
    return rows[np.rint(np.linspace(0, len(rows) - 1, most)).astype(int)]


def _data(
    drawn: DriveMap, trajectory: Trajectory, tracks: Sequence[Track], times: NDArray[np.int64]
) -> str:
    """Where LiDAR and tracks are at each time, in pixels of the picture, as JSON."""
    shown: list[dict[str, object]] = []
    for track in tracks:
        first = int(np.searchsorted(times, track.times[0]))
        after = int(np.searchsorted(times, track.times[-1], side="right"))
        if first < after:
            poses = np.array([track.pose_at(time) for time in times[first:after].tolist()])
            shown.append({
                "id": track.id,
                "color": css(track_color(track.id)),
                "size": [round(float(side) / drawn.cell, 1) for side in track.size[:2]],
                "first": first,
                "places": _places(drawn, poses),
            })  # fmt: skip
    found = {
        "times": [round(float(t) * 1e-9, 2) for t in times - trajectory.times[0]],
        "path": _places(drawn, trajectory.interpolate(times)),
        "ego": [round(side / drawn.cell, 1) for side in _EGO],
        "tracks": shown,
    }
    return json.dumps(found, separators=(",", ":"))


def _places(drawn: DriveMap, poses: NDArray[np.float64]) -> list[list[float]]:
    """Column, row and angle (clockwise, from the picture's right) of each pose."""
    pixels = drawn.pixels(poses[:, :3, 3])
    angles = drawn.heading - np.arctan2(poses[:, 1, 0], poses[:, 0, 0])
    return [
        [round(float(c), 1), round(float(r), 1), round(float(a), 2)]
        for (c, r), a in zip(pixels, angles, strict=True)
    ]


def _about(track: Track) -> str:
    speeds = np.linalg.norm(track.velocities, axis=1)
    seconds = float(track.times[-1] - track.times[0]) * 1e-9
    length, width, height = track.size
    return (
        f"{track.kind} {track.id}: {length:.1f} x {width:.1f} x {height:.1f} m, seen for "
        f"{seconds:.1f} s, {np.median(speeds):.1f} m/s"
    )


def _line(pixels: NDArray[np.float64]) -> str:
    return " ".join(f"{column:.1f},{row:.1f}" for column, row in pixels)


def _rule(drawn: DriveMap) -> str:
    height, width = drawn.picture.shape[:2]
    metres = round_length(width / 4 * drawn.cell)
    x, y, length = width * 0.02, height * 0.96, metres / drawn.cell
    return (
        f'<line class=rule x1="{x:.1f}" y1="{y:.1f}" x2="{x + length:.1f}" y2="{y:.1f}"/>'
        f'<text x="{x + length / 2:.1f}" y="{y:.1f}" dy="-.5em">{metres} m</text>'
    )
