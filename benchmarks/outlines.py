"""Where outlines of depth maps lie beside the edges of the photos.

    python benchmarks/outlines.py RUN --every 3
    python benchmarks/outlines.py RUN --exact DRIVE/depth_2

The second is of a synthetic drive: its exact maps tell how far the measure itself is off.


An outline is measured where a sweep shows one: where the range jumps along a ring, in at least four
neighbouring rings one above the other. In each row of pixels between these rings, the nearest jump
of the depth map is compared with the strongest edge of the image within ten pixels. Edges of the
image are smoothed along the outline, and where two are nearly as strong the row does not count. So
a texture beside the outline seldom wins. By exact maps 72 % of the static and 74 % of the moving
outlines lie within a pixel, and the median is 0.00 and 0.02 pixels (city, HDL-64).

Runs of KITTI's LiDAR and of the synthetic one like it, with images.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from results import parser_of, publish, script

from docdepth.datasets import CameraStream
from docdepth.datasets.kitti_lidar import sensor_rig
from docdepth.evaluation import Table
from docdepth.evaluation.camera_error import images_and_maps
from docdepth.geometry.lidar_frame import LidarFrame
from docdepth.geometry.points import DYNAMIC
from docdepth.geometry.se3 import inverse
from docdepth.geometry.track import Tracks
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.depth import read_depth
from docdepth.io.run_folder import RunFolder
from docdepth.io.tracks import tracks_in

Floats = NDArray[np.float64]

JUMP = (0.5, 0.15)  # metres, and share of the range, that the farther return lies behind
RANGES = (3.0, 40.0)  # metres of the near return
GAP = np.radians(2.0)  # between two returns of a ring
NEXT = 0.008  # radians to the left or right from ring to ring, which are 0.007 apart
SAME = 0.05  # share of the range by which the near returns of two rings may differ
RINGS = 4  # of a silhouette
REACH = 10  # pixels to either side of the silhouette or the outline
CLEAR = 1.5  # times the strongest edge is stronger than any that is three pixels away or more
ALONG = 4  # rows up and down over which an edge of the image is smoothed


@dataclass(frozen=True)
class Silhouette:
    """A side of an object, from ring to ring.

    Attributes
    ----------
    points : ndarray of float64, shape (n, 3)
        The near returns, in the LiDAR frame at the stamp, metres.
    rows : ndarray of int64, shape (n,)
        Of these in the frame.
    side : int
        1 where the near surface lies to the left, -1 where it lies to the right.
    """

    points: Floats
    rows: NDArray[np.int64]
    side: int


def silhouettes(frame: LidarFrame) -> list[Silhouette]:
    """Jumps along rings that are chained over at least four rings."""
    points = frame.points.astype(np.float64)
    ring = sensor_rig(frame.points).index.astype(np.int64)
    azimuth, ranges = np.arctan2(points[:, 1], points[:, 0]), np.linalg.norm(points, axis=1)
    order = np.lexsort((-azimuth, ring))  # from left to right
    left, right = order[:-1], order[1:]
    near = np.minimum(ranges[left], ranges[right])
    jump = np.abs(ranges[left] - ranges[right]) > np.maximum(JUMP[0], JUMP[1] * near)
    jump &= (ring[left] == ring[right]) & (azimuth[left] - azimuth[right] < GAP)
    jump &= (near > RANGES[0]) & (near < RANGES[1])
    left, right = left[jump], right[jump]
    side = np.where(ranges[left] < ranges[right], 1, -1)
    own = np.where(side > 0, left, right)
    places = points[own]
    found = []
    for one in (-1, 1):
        for chain in _chains(places[side == one], ring[left][side == one]):
            found.append(Silhouette(places[side == one][chain], own[side == one][chain], one))
    return found


def _chains(places: Floats, ring: NDArray[np.int64]) -> list[list[int]]:
    """Rows of places that follow each other from ring to ring."""
    azimuth, ranges = np.arctan2(places[:, 1], places[:, 0]), np.linalg.norm(places, axis=1)
    of_ring = [np.flatnonzero(ring == k) for k in range(64)]
    chains: list[list[int]] = []
    ends: dict[int, list[int]] = {}  # the chain that ends at a place
    for below, above in pairwise(of_ring):
        following: dict[int, list[int]] = {}
        for k in above.tolist():
            if not len(below):
                continue
            apart = np.abs(azimuth[below] - azimuth[k]) / NEXT
            apart = np.maximum(apart, np.abs(np.log(ranges[below] / ranges[k])) / SAME)
            best = int(below[apart.argmin()])
            if apart.min() < 1:
                chain = ends.get(best)
                if chain is None or chain[-1] != best:
                    chain = [best]
                    chains.append(chain)
                chain.append(k)
                following[k] = chain
        ends = following
    return [chain for chain in chains if len(chain) >= RINGS]


@dataclass
class Offsets:
    """Pixels from the edge of the image to the outline, to the far side."""

    static: list[Floats] = field(default_factory=list)
    moving: list[Floats] = field(default_factory=list)

    def rows(self) -> dict[str, tuple[str, ...]]:
        """How many rows of pixels tell, shares near the edge, and the share that tells nothing."""
        return {"static": _row(self.static), "moving": _row(self.moving)}


def _row(parts: list[Floats]) -> tuple[str, ...]:
    every = np.concatenate([np.zeros(0), *parts])
    found = every[np.isfinite(every)]
    if not len(found):
        return "0", *["-"] * 5
    figures = [
        f"{(np.abs(found) <= 1).mean():.3f}",
        f"{(np.abs(found) <= 2).mean():.3f}",
        f"{np.median(found):+.2f}",
        f"{np.median(np.abs(found)):.2f}",
        f"{1 - len(found) / len(every):.3f}",
    ]
    return str(len(found)), *figures


@dataclass(frozen=True)
class Sight:
    """What an image is compared with."""

    stream: CameraStream
    trajectory: Trajectory
    tracks: Tracks

    def lines(
        self, frame: LidarFrame, index: int, image: int
    ) -> Iterator[tuple[Floats, Silhouette, bool]]:
        """Pixels of each silhouette at the time of an image, (n, 2); whether it moves."""
        time = int(self.stream.times[image])
        T_camera_world = self.stream.T_camera_lidar @ inverse(self.trajectory.interpolate(time)[0])
        pose, stamp = self.trajectory.poses[index], int(self.trajectory.times[index])
        for one in silhouettes(frame):
            moving = frame.classes[one.rows] >= DYNAMIC
            if moving.any() and not moving.all():
                continue
            world = one.points @ pose[:3, :3].T + pose[:3, 3]
            if moving.all():
                ids = np.zeros(len(world)) if frame.instance is None else frame.instance[one.rows]
                if len(set(ids.tolist())) != 1 or int(ids[0]) not in self.tracks:
                    continue
                track = self.tracks[int(ids[0])]
                late = 0.0 if frame.time_offset is None else frame.time_offset[one.rows].mean()
                seen = stamp + round(1e9 * float(late))
                moved = track.pose_at(time) @ inverse(track.pose_at(seen))
                world = world @ moved[:3, :3].T + moved[:3, 3]
            points = world @ T_camera_world[:3, :3].T + T_camera_world[:3, 3]
            if (points[:, 2] > 1).all():
                pixels = points @ self.stream.camera.K.T
                yield pixels[:, :2] / pixels[:, 2:], one, bool(moving.all())


def offsets(
    pixels: Floats, one: Silhouette, depth: NDArray[np.float32], change: NDArray[np.float32]
) -> Floats:
    """Pixels from the image's edge to the outline in each row, (n,); NaN without a clear edge."""
    height, width = depth.shape
    order = np.argsort(pixels[:, 1])
    rows = np.arange(int(np.ceil(pixels[:, 1].min())), int(pixels[:, 1].max()) + 1)
    rows = rows[(rows >= 0) & (rows < height)]
    places = np.interp(rows, pixels[order, 1], pixels[order, 0])
    inside = (places > 2 * REACH + 1) & (places < width - 2 * REACH - 2)
    rows, places = rows[inside], places[inside]
    ranges = np.interp(rows, pixels[order, 1], np.linalg.norm(one.points[order], axis=1))
    outline = np.array([
        _outline(depth[v], u, near, one.side)
        for v, u, near in zip(rows.tolist(), places.tolist(), ranges.tolist(), strict=True)
    ])  # fmt: skip
    edges = np.full(len(rows), np.nan)
    known = np.flatnonzero(np.isfinite(outline))
    for k in known.tolist():
        around = known[np.abs(rows[known] - rows[k]) <= ALONG]
        # Beside the same line of the outline in each of these rows.
        slope = np.polyfit(rows[around], outline[around], 1)[0] if len(around) > 2 else 0.0
        near = [v for v in range(rows[k] - ALONG, rows[k] + ALONG + 1) if 0 <= v < height]
        u = outline[k] + slope * (np.array(near) - rows[k])[:, None]
        u = u + np.arange(-REACH, REACH + 1)[None]
        v = np.repeat(np.array(near)[:, None], u.shape[1], axis=1)
        found = cv2.remap(change, u.astype(np.float32), v.astype(np.float32), cv2.INTER_LINEAR)
        edges[k] = outline[k] + _peak(np.abs(found.mean(axis=0)))
    return (outline - edges) * one.side


def _outline(depth: NDArray[np.float32], place: float, near: float, side: int) -> float:
    """The jump of a row of a depth map that is nearest to a place; NaN if there is none."""
    first = int(place) - REACH
    part = depth[first : first + 2 * REACH + 2].astype(np.float64)
    one, other = (part[:-1], part[1:]) if side > 0 else (part[1:], part[:-1])
    beyond = np.where(np.isfinite(other), other, np.inf)
    jump = (beyond - one > np.maximum(JUMP[0], JUMP[1] * one)) & (one < 1.1 * near)
    at = first + 0.5 + np.flatnonzero(jump)
    return float(at[np.abs(at - place).argmin()]) if len(at) else np.nan


def _peak(strength: NDArray[np.float32]) -> float:
    """Offset of the strongest sample from their middle, by a parabola; NaN if two are strong."""
    k = int(np.clip(strength.argmax(), 1, len(strength) - 2))
    others = np.abs(np.arange(len(strength)) - k) > 2
    if strength[k] < CLEAR * strength[others].max():
        return np.nan
    a, b, c = (float(s) for s in strength[k - 1 : k + 2])
    bend = a - 2 * b + c
    return k - len(strength) // 2 + (float(np.clip(0.5 * (a - c) / bend, -1, 1)) if bend else 0.0)


def change_of(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Change of brightness along rows."""
    bright = np.sqrt(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY).astype(np.float32))
    bright = cv2.GaussianBlur(bright, (0, 0), 1.0)
    return np.asarray(cv2.Sobel(bright, cv2.CV_32F, 1, 0), np.float32)


def measure(path: Path, camera: str | None, every: int, exact: Path | None = None) -> Offsets:
    """Offsets of some images of a run; of the exact maps in a folder where one is given."""
    run = RunFolder.open(path)
    stream, maps = images_and_maps(run, camera, "compare depth with")
    trajectory, found = run.trajectory(), Offsets()
    sight = Sight(stream, trajectory, tracks_in(run.path))
    chosen = [k for k, name in enumerate(stream.names) if name in maps][::every]
    for image in chosen:
        name, time = stream.names[image], stream.times[image]
        index = int(np.abs(trajectory.times - time).argmin())
        depth = read_depth(maps[name]) if exact is None else np.load(exact / f"{name}.npy")
        picture = stream.rectified_image(image)
        assert picture is not None
        change = change_of(picture)
        for pixels, one, moving in sight.lines(run.classified_frame(index)[0], index, image):
            away = offsets(pixels, one, depth, change)
            (found.moving if moving else found.static).append(away)
    return found


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument(
        "runs", nargs="+", type=Path, help="runs with maps, of recordings with images"
    )
    parser.add_argument("--camera", help="its name; needed if a run has several")
    parser.add_argument("--every", type=int, default=3, help="images from one to the next")
    parser.add_argument("--exact", type=Path, help="a folder of exact maps NAME.npy instead")
    args = parser.parse_args()
    rows = []
    for path in args.runs:
        found = measure(path, args.camera, args.every, args.exact)
        rows += [(path.name, name, *row) for name, row in found.rows().items()]
    header = "run", "", "rows", "<= 1 px", "<= 2 px", "median px", "median size", "no clear edge"
    publish([Table("Outlines beside the edges of photos", header, tuple(rows))], args.results)


if __name__ == "__main__":
    script(main)
