"""The drive from above on the page of a report: map, path, tracks, and where all is at a time."""

from __future__ import annotations

import json
from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.geometry.track import Track
from docdepth.geometry.trajectory import Trajectory
from docdepth.visualization.drive_map import (
    GROUND_TONE,
    LOW_TONE,
    TALL,
    TALL_TONE,
    UNSEEN_TONE,
    DriveMap,
)
from docdepth.visualization.image_views import track_color
from docdepth.visualization.page import css, embedded, swatches
from docdepth.visualization.pictures import TRACK_COLORS

PATH_COLOR = (150, 60, 0)
"""Of the path of the LiDAR: dark blue."""

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
_RULES = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000)  # metres


def map_section(drawn: DriveMap, trajectory: Trajectory, tracks: Sequence[Track]) -> str:
    """The map with path and tracks, a slider for the time, and a legend."""
    height, width = drawn.picture.shape[:2]
    shown = sorted(sorted(tracks, key=len)[-_TRACKS:], key=lambda track: track.id)
    times = _times(trajectory, shown)
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
        f'<polyline class=path stroke="{css(PATH_COLOR)}" points="{path}"/>',
        f"<g id=objects></g>{_rule(drawn)}</svg>",
        "<div class=row><button id=play>play</button>",
        f'<input type=range id=time min=0 max={len(times) - 1} value=0 aria-label=time>',
        "<output id=now></output></div>",
        swatches([
            ([(UNSEEN_TONE,) * 3], "nothing measured"),
            ([(GROUND_TONE,) * 3], "ground"),
            ([(LOW_TONE,) * 3], "what stands, low"),
            ([(TALL_TONE,) * 3], f"{TALL:g} m high; what is higher is left out"),
            ([PATH_COLOR], "path of the LiDAR, driven to the right"),
            ([(0, 0, 0)], "the LiDAR"),
            (TRACK_COLORS, "moving objects, with their numbers" + _of(len(shown), len(tracks))),
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


def _of(shown: int, count: int) -> str:
    return f" (the {shown} of {count} that were seen longest)" if shown < count else ""


def _times(trajectory: Trajectory, tracks: Sequence[Track]) -> NDArray[np.int64]:
    """Stamps at which the map can be looked at: every sweep, or fewer in a long drive."""
    rows = len(trajectory) + sum(len(track) for track in tracks)
    return trajectory.times[:: -(-rows // _PLACES)]


def _data(
    drawn: DriveMap, trajectory: Trajectory, tracks: Sequence[Track], times: NDArray[np.int64]
) -> str:
    """Where LiDAR and tracks are at each time, in pixels of the picture, as JSON."""
    found: dict[str, Any] = {
        "times": [round(float(t) * 1e-9, 2) for t in times - trajectory.times[0]],
        "path": _places(drawn, trajectory.interpolate(times)),
        "ego": [round(side / drawn.cell, 1) for side in _EGO],
        "tracks": [],
    }
    for track in tracks:
        first = int(np.searchsorted(times, track.times[0]))
        after = int(np.searchsorted(times, track.times[-1], side="right"))
        if first < after:
            poses = np.array([track.pose_at(time) for time in times[first:after].tolist()])
            found["tracks"].append({
                "id": track.id,
                "color": css(track_color(track.id)),
                "size": [round(float(side) / drawn.cell, 1) for side in track.size[:2]],
                "first": first,
                "places": _places(drawn, poses),
            })  # fmt: skip
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
    metres = max((m for m in _RULES if m / drawn.cell < width / 4), default=1)
    x, y, length = width * 0.02, height * 0.96, metres / drawn.cell
    return (
        f'<line class=rule x1="{x:.1f}" y1="{y:.1f}" x2="{x + length:.1f}" y2="{y:.1f}"/>'
        f'<text x="{x + length / 2:.1f}" y="{y:.1f}" dy="-.5em">{metres} m</text>'
    )
