"""Boards of each kind in made-up images: how many are found, and how far off their corners are.

    python benchmarks/board_corners.py --trials 50

They are those of the tests, tilted by up to 30 degrees, 1.5 to 3.5 m away, with noise and a blur.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np
from results import parser_of, publish, script

from docdepth.calibration.board import PATTERNS, Board
from docdepth.calibration.corners import find_corners
from docdepth.evaluation import Table

NOISE, BLUR = 4.0, 0.8  # standard deviations of brightness [of 255] and in pixels


def trials(pattern: str, count: int) -> tuple[str, ...]:
    """A row: boards found, median and 95th percentile of their corners' errors."""
    from boards import STRAIGHT, held, printed

    rng, board, errors = np.random.default_rng(0), Board(6, 5, 0.1, 0.9, 0.8, pattern), []
    for _ in range(count):
        T = held(rng, 1.5, 3.5)
        image = cv2.GaussianBlur(printed(board, T).astype(np.float32), None, BLUR)
        image += rng.normal(0, NOISE, image.shape).astype(np.float32)
        found = find_corners(np.clip(image, 0, 255).astype(np.uint8), board)
        if found is not None:
            exact = STRAIGHT.project(board.corners @ T[:3, :3].T + T[:3, 3])
            ways = (np.linalg.norm(found - way, axis=1) for way in (exact, exact[::-1]))
            errors.append(min(ways, key=np.median))
    off = np.concatenate(errors)
    return (
        pattern,
        f"{len(errors)}/{count}",
        f"{np.median(off):.3f}",
        f"{np.quantile(off, 0.95):.2f}",
    )


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--trials", type=int, default=50)
    args = parser.parse_args()
    sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "calibration"))
    rows = [trials(pattern, args.trials) for pattern in PATTERNS]
    header = "board", "found", "median px", "95 % px"
    publish([Table("Corners of boards in made-up images", header, tuple(rows))], args.results)


if __name__ == "__main__":
    script(main)
