"""Where outlines of depth maps lie beside the edges of the photos.

    python benchmarks/outlines.py RUN --every 3
    python benchmarks/outlines.py RUN --exact DRIVE/depth_2

The second is of a synthetic drive: its exact maps tell how far the measure itself is off.

A sweep shows a silhouette where the range jumps along a ring, in at least four rings one above the
other. It counts where these returns lie on a straight line, and the photo's strongest edge along 17
rows of that line is three times as strong as any other within ten pixels: leaves and fences have
many. Each row's jump of depth nearest to the line is compared with the photo's edge.

By exact maps 85 % of the static and 94 % of the moving outlines lie within a pixel, and are 0.02
and 0.05 pixels too wide (city, HDL-64). Runs of KITTI's LiDAR and of the synthetic one like it.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from results import parser_of, publish, script

from docdepth.evaluation import Table
from docdepth.evaluation.camera_error import images_and_maps
from docdepth.geometry.camera import View
from docdepth.geometry.lidar_frame import LidarFrame
from docdepth.geometry.points import DYNAMIC
from docdepth.geometry.se3 import inverse
from docdepth.geometry.track import Tracks
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.depth import read_depth
from docdepth.io.run_folder import RunFolder
from docdepth.io.tracks import tracks_in

Floats = NDArray[np.float64]
Map = NDArray[np.float32]

JUMP = (0.5, 0.15)  # metres, and share of the range, that the farther return lies behind
RANGES = (3.0, 40.0)  # metres of the near return
GAP = np.radians(2.0)  # between two returns of a ring
NEXT = 0.008  # radians to the left or right from ring to ring, which are 0.007 apart
SAME = 0.05  # share of the range by which the near returns of two rings may differ
RINGS = 4  # of a silhouette
REACH = 10  # pixels to either side of a silhouette
HALF = 8  # rows of a window above and below its middle
STRAIGHT = 0.7  # pixels, RMS, by which returns lie beside a straight line; they are 1 to 2 apart
CLEAR = 3.0  # times the edge is stronger than any that is three pixels away or more
PEAK = 3.0  # pixels within which the median is taken: farther off is another edge


def silhouettes(frame: LidarFrame) -> Iterator[tuple[NDArray[np.int64], int]]:
    """Rows of near returns from ring to ring, and 1 where their surface lies to the left, or -1."""
    points = frame.points.astype(np.float64)
    assert frame.sensor_rig is not None
    ring = frame.sensor_rig.index.astype(np.int64)
    azimuth, ranges = np.arctan2(points[:, 1], points[:, 0]), np.linalg.norm(points, axis=1)
    order = np.lexsort((-azimuth, ring))  # from left to right
    left, right = order[:-1], order[1:]
    near = np.minimum(ranges[left], ranges[right])
    jump = np.abs(ranges[left] - ranges[right]) > np.maximum(JUMP[0], JUMP[1] * near)
    jump &= (ring[left] == ring[right]) & (azimuth[left] - azimuth[right] < GAP)
    jump &= (near > RANGES[0]) & (near < RANGES[1])
    left, right = left[jump], right[jump]
    for side in (-1, 1):
        own = (left if side > 0 else right)[(ranges[left] < ranges[right]) == (side > 0)]
        chains: list[list[int]] = []
        ends: dict[int, list[int]] = {}  # the chain that ends at a return
        for below, above in pairwise(own[ring[own] == k] for k in range(64)):
            following: dict[int, list[int]] = {}
            for k in above.tolist() if len(below) else ():
                apart = np.abs(azimuth[below] - azimuth[k]) / NEXT
                apart = np.maximum(apart, np.abs(np.log(ranges[below] / ranges[k])) / SAME)
                best = int(below[apart.argmin()])
                if apart.min() < 1:
                    following[k] = ends.pop(best, [best])
                    chains += [following[k]] if len(following[k]) == 1 else []
                    following[k].append(k)
            ends = following
        yield from ((np.array(chain), side) for chain in chains if len(chain) >= RINGS)


def pixels_of(
    frame: LidarFrame,
    rows: NDArray[np.int64],
    sweep: int,
    view: View,
    at: Trajectory,
    tracks: Tracks,
) -> Floats | None:
    """Where a view sees returns of a sweep, (n, 2); None where it cannot be told."""
    pose, stamp = at.poses[sweep], int(at.times[sweep])
    world = frame.points[rows] @ pose[:3, :3].T + pose[:3, 3]
    if frame.classes[rows[0]] >= DYNAMIC:
        ids = set() if frame.instance is None else set(frame.instance[rows].tolist())
        if len(ids) != 1 or not ids <= set(tracks):
            return None
        track = tracks[ids.pop()]
        late = 0.0 if frame.time_offset is None else float(frame.time_offset[rows].mean())
        moved = track.pose_at(view.time) @ inverse(track.pose_at(stamp + round(1e9 * late)))
        world = world @ moved[:3, :3].T + moved[:3, 3]
    T = view.T_camera_world
    points = (world @ T[:3, :3].T + T[:3, 3]) @ view.camera.K.T
    return points[:, :2] / points[:, 2:] if (points[:, 2] > 1).all() else None


def offsets(pixels: Floats, near: float, side: int, depth: Map, change: Map) -> Floats:
    """By how much outlines are too far out, in each row where the photo has a clear edge [px]."""
    (height, width), (u, v), found = depth.shape, pixels.T, []
    for row in range(max(int(v.min()), HALF), min(int(v.max()) + 1, height - HALF)):
        own = np.abs(v - row) <= 2 * HALF
        if own.sum() < RINGS:
            continue
        (lean, place), error, *_ = np.polyfit(v[own] - row, u[own], 1, full=True)
        inside = 2 * REACH < place < width - 2 * REACH - 1
        if not inside or error.sum() > STRAIGHT**2 * own.sum():
            continue
        edge = _edge(change, row, float(place), float(lean))
        if np.isfinite(edge):
            found.append((_outline(depth[row], float(place), near, side) - edge) * side)
    return np.array(found)


def _edge(change: Map, row: int, place: float, lean: float) -> float:
    """Column of the photo's edge in a row, beside a line that leans; NaN where none is clear."""
    beside, across = np.arange(-HALF, HALF + 1)[:, None], np.arange(-REACH, REACH + 1)
    u, v = np.broadcast_arrays(place + lean * beside + across, row + beside)
    sampled = cv2.remap(change, u.astype(np.float32), v.astype(np.float32), cv2.INTER_LINEAR)
    line = np.abs(sampled.mean(axis=0))
    k = int(np.clip(line.argmax(), 1, len(line) - 2))
    if line[k] < CLEAR * line[np.abs(np.arange(len(line)) - k) > 2].max():
        return np.nan
    a, b, c = line[k - 1 : k + 2].tolist()
    bend = a - 2 * b + c
    return float(place + across[k] + (np.clip((a - c) / bend / 2, -1, 1) if bend else 0))


def _outline(row: Map, place: float, near: float, side: int) -> float:
    """The jump of a row of a depth map that is nearest to a place; NaN without one."""
    first = int(place) - REACH
    part = row[first : first + 2 * REACH + 2].astype(np.float64)
    one, other = (part[:-1], part[1:]) if side > 0 else (part[1:], part[:-1])
    beyond = np.where(np.isfinite(other), other, np.inf)
    jump = (beyond - one > np.maximum(JUMP[0], JUMP[1] * one)) & (one < 1.1 * near)
    at = first + 0.5 + np.flatnonzero(jump)
    return float(at[np.abs(at - place).argmin()]) if len(at) else np.nan


def figures(rows: list[tuple[int, Floats]]) -> tuple[str, ...]:
    """Rows with a clear edge, shares near it, and how much too wide and too far right they peak."""
    every = np.concatenate([np.zeros(0), *(part for _, part in rows)])
    sides = [np.concatenate([np.zeros(0), *(p for s, p in rows if s == side)]) for side in (1, -1)]
    right, left = (np.median(part[np.abs(part) < PEAK]) if len(part) else np.nan for part in sides)
    near = [np.mean(np.abs(every) <= most) for most in (1, 2)]
    shown = f"{near[0]:.3f}", f"{near[1]:.3f}", f"{(right + left) / 2:+.2f}"
    return str(len(every)), *shown, f"{(right - left) / 2:+.2f}", f"{np.isnan(every).mean():.3f}"


def measure(
    path: Path, camera: str | None, every: int, exact: Path | None
) -> Iterator[tuple[bool, int, Floats]]:
    """Of each silhouette whether it moves, its side, and the offsets of its outline."""
    run = RunFolder.open(path)
    stream, maps = images_and_maps(run, camera, "compare depth with")
    trajectory, tracks = run.trajectory(), tracks_in(path)
    for image in [k for k, name in enumerate(stream.names) if name in maps][::every]:
        name, time, picture = (
            stream.names[image],
            int(stream.times[image]),
            stream.rectified_image(image),
        )
        assert picture is not None
        bright = np.sqrt(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY).astype(np.float32))
        change = cv2.Sobel(cv2.GaussianBlur(bright, (0, 0), 1.0), cv2.CV_32F, 1, 0)
        depth = read_depth(maps[name]) if exact is None else np.load(exact / f"{name}.npy")
        view, sweep = (
            View.at(stream.camera, stream.T_camera_lidar, trajectory, time),
            trajectory.nearest(time),
        )
        frame = run.classified_frame(sweep)[0]
        for rows, side in silhouettes(frame):
            moving = frame.classes[rows] >= DYNAMIC
            if moving.any() == moving.all():
                pixels = pixels_of(frame, rows, sweep, view, trajectory, tracks)
                if pixels is not None:
                    near = float(np.linalg.norm(frame.points[rows], axis=1).max())
                    yield bool(moving.all()), side, offsets(pixels, near, side, depth, change)


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("runs", nargs="+", type=Path, help="with maps, of recordings with images")
    parser.add_argument("--camera", help="its name; needed if a run has several")
    parser.add_argument("--every", type=int, default=3, help="images from one to the next")
    parser.add_argument("--exact", type=Path, help="a folder of exact maps NAME.npy instead")
    args = parser.parse_args()
    lines = []
    for path in args.runs:
        found = list(measure(path, args.camera, args.every, args.exact))
        for what, moves in (("static", False), ("moving", True)):
            lines.append((path.name, what, *figures([(s, p) for m, s, p in found if m == moves])))
    header = "run", "", "rows", "<= 1 px", "<= 2 px", "too wide px", "to the right px", "no outline"
    publish([Table("Outlines beside the edges of photos", header, tuple(lines))], args.results)


if __name__ == "__main__":
    script(main)
