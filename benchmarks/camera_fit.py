"""What is left of made-up errors of a camera, once it is fitted to its images.

    python benchmarks/camera_fit.py RUN... --trials 20

Of runs whose camera is right, such as those of synthetic drives: up to 0.5 degrees, 5 cm and 20 ms
of error. Depth edges are moved to where the wrong camera would have them, so nothing is drawn
again. Of a real drive, whose camera is never quite right, `--relative` counts from what is found
without a made-up error.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from results import parser_of, publish, script

from docdepth.diagnostics.calibration import RunEdges, edges_of_images
from docdepth.diagnostics.depth_edges import Edges
from docdepth.evaluation import Table
from docdepth.evaluation.camera_error import images_and_maps
from docdepth.geometry.se3 import rotation_exp
from docdepth.io.depth import read_depth
from docdepth.io.run_folder import RunFolder
from docdepth.io.tracks import tracks_in
from docdepth.pipeline.camera_fit import fit_camera

Floats = NDArray[np.float64]

MOST = np.radians(0.5), 0.05, 0.02  # turn [rad], shift [m] and time [s]
IMAGES = 40


def edges_of(path: Path, camera: str | None) -> tuple[RunEdges, float]:
    """Depth edges of a run, and the path along which its images were taken [m]."""
    run = RunFolder.open(path)
    stream, maps = images_and_maps(run, camera, "compare depth with")
    drawn = [k for k, name in enumerate(stream.names) if name in maps]
    trajectory = run.trajectory()
    found = edges_of_images(
        path, stream, drawn, lambda k: read_depth(maps[stream.names[k]]),
        trajectory, tracks_in(path), most=IMAGES,
    )  # fmt: skip
    return found, float(np.ptp(trajectory.arc_length_at(stream.times[drawn])))


def made_up(rng: np.random.Generator) -> Floats:
    """Turn, shift and time (7,), of which the fit has to find all."""
    turn, shift = rng.normal(size=(2, 3))
    parts = [
        most * rng.uniform(0.3, 1) * way / np.linalg.norm(way)
        for most, way in zip(MOST, (turn, shift), strict=False)
    ]
    return np.concatenate([*parts, [rng.uniform(-MOST[2], MOST[2])]])


def with_error(found: RunEdges, change: Floats) -> RunEdges:
    """Depth edges where a camera has them that has to be changed by this to be right."""
    camera, edges = found.stream.camera, []
    for one, motion in zip(found.edges, found.motions, strict=True):
        turn, shift = np.split(change[:6] + change[6] * motion, 2)
        rays = np.concatenate([one.pixels, np.ones((len(one), 1))], 1) @ np.linalg.inv(camera.K).T
        points = (rays * one.depth[:, None] - shift) @ rotation_exp(turn)
        pixels = points @ camera.K.T
        pixels = pixels[:, :2] / pixels[:, 2:]
        seen = (points[:, 2] > 1) & (pixels >= 0).all(1)
        seen &= (pixels < [camera.width, camera.height]).all(1)
        across = one.across @ rotation_exp([0, 0, turn[2]])[:2, :2]
        edges.append(Edges(pixels, across, points[:, 2]).rows(seen))
    return replace(found, edges=edges)


def trials(found: RunEdges, path: float, count: int, relative: bool) -> tuple[str, ...]:
    """A row: the given camera, then how many were changed, and RMS pixels of its edges."""
    rng = np.random.default_rng(0)
    given = fit_camera(found, path)
    right = given.fit.change if relative and given is not None else np.zeros(7)
    before, left, refused = [], [], []
    for _ in range(count):
        change = made_up(rng)
        wrong = with_error(found, change)
        fit = fit_camera(wrong, path)
        off = wrong.seen.moved(change + right)
        if fit is None or not fit.is_sure:
            refused.append(off)
            continue
        before.append(off)
        left.append(wrong.seen.moved(change + right - fit.fit.change))
    applied = given is not None and given.is_sure
    pixels = 0.0 if given is None else found.seen.moved(given.fit.change)
    return (
        f"{pixels:.2f} {'applied' if applied else 'left'}",
        f"{len(left)}/{count}",
        *(f"{f(v):.2f}" if v else "-" for f, v in ((np.median, before), (np.median, left))),
        f"{max(left):.2f}" if left else "-",
        f"{np.median(refused):.2f}" if refused else "-",
    )


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("runs", nargs="+", type=Path, help="runs with maps, of drives with images")
    parser.add_argument("--camera", help="its name; needed if a run has several")
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--relative", action="store_true", help="the given camera is not right")
    args = parser.parse_args()
    rows = []
    for path in args.runs:
        found = edges_of(path, args.camera)
        rows.append((path.name, *trials(*found, args.trials, args.relative)))
    header = "run", "as given, px", "changed", "px before", "left", "most", "px where refused"
    publish([Table("Cameras with made-up errors", header, tuple(rows))], args.results)


if __name__ == "__main__":
    script(main)
