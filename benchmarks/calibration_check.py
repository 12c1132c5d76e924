"""Wrong extrinsics of known size, and what ``docdepth calibrate --check`` finds of them.

    python benchmarks/calibration_check.py RUN [RUN ...]

Each RUN has depth maps and images. Its depth edges are moved to where a camera would have them that
is turned or moved, by their depth, and compared with the images again. A row tells what was done,
what was found more than without a change, and whether the check warns, for both signs.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docdepth.geometry.se3 import rotation_exp
from docdepth.pipeline.calibration_check import CalibrationCheck, RunEdges, compare, edges_of_run
from docdepth.pipeline.edge_fit import Edges

Floats = NDArray[np.float64]
AXES = ("pitch", "yaw", "roll", "right", "down", "ahead")
DEGREES, METRES = (0.1, 0.2, 0.3, 0.5, 1.0), (0.05, 0.1)


def changes() -> Iterator[tuple[int, float]]:
    """Axis and size: degrees about x, y, z, then metres along them."""
    for axis in range(6):
        yield from ((axis, size) for size in (DEGREES if axis < 3 else METRES))


def moved(edges: Edges, change: Floats, found: RunEdges) -> Edges:
    """Edges of the same points where the camera's frame is another one."""
    K = found.stream.camera.K
    rays = np.column_stack([edges.pixels, np.ones(len(edges))]) @ np.linalg.inv(K).T
    points = rays * edges.depth[:, None] @ rotation_exp(change[:3]).T + change[3:]
    pixels = points @ K.T
    return Edges(pixels[:, :2] / pixels[:, 2:], edges.across, points[:, 2])


def check(found: RunEdges, axis: int, size: float) -> tuple[CalibrationCheck, float]:
    """The check after a change, and what it finds about its axis, in degrees or metres."""
    change = np.zeros(6)
    change[axis] = np.radians(size) if axis < 3 else size
    edges = [moved(one, change, found) for one in found.edges]
    result = compare(replace(found, edges=edges))
    value = -result.fit.change[axis]
    return result, float(np.degrees(value) if axis < 3 else value)


def main(arguments: list[str]) -> None:
    """Print a table for each run."""
    for argument in arguments:
        found = edges_of_run(Path(argument))
        given = compare(found)
        print(f"\n{argument}\n\nas given: {given.verdict}")
        print("\n".join(given.lines[1:]))
        print("\n| axis | change | found | says it is off |")
        print("| --- | --- | --- | --- |")
        for axis, size in changes():
            start = -given.fit.change[axis] * (np.degrees(1) if axis < 3 else 1)
            results = [check(found, axis, sign * size) for sign in (1, -1)]
            values = [f"{value - start:+.3f}" for _, value in results]
            said = sum(not one.agrees for one, _ in results)
            unit = "deg" if axis < 3 else "m"
            row = f"| {AXES[axis]} | +-{size:g} {unit} | {', '.join(values)} | {said} of 2 |"
            print(row, flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
