"""The checkerboard: its inner corners and its outline."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import ConfigError

PATTERNS = ("checkerboard", "charuco", "circles")
"""What is on a board: circles lie in rows and columns, and are dark on a light ground."""

_SQUARE_BOARD = 0.03  # of its side; sides that differ by less cannot be told apart in a sweep


@dataclass(frozen=True)
class Board:
    """A flat rectangle with a checkerboard, or another pattern, in its middle.

    The frame of the board has its origin in the centre of the front, x along the columns of
    corners, y along the rows, z away from the viewer.
    """

    # columns, rows: inner corners along x and along y; of circles their centres
    columns: int
    rows: int
    square: float  # side of a square, or distance of the centres of circles [m]
    # width, height: outline along x and along y [m]
    width: float
    height: float
    pattern: str = PATTERNS[0]  # one of :data:`PATTERNS`

    def __post_init__(self) -> None:
        if min(self.columns, self.rows) < 3 or self.square <= 0:
            raise ConfigError(
                f"a board of {self.columns}x{self.rows} inner corners and squares of "
                f"{self.square} m cannot be used; it needs at least 3x3 corners"
            )
        pattern = ((self.columns - 1) * self.square, (self.rows - 1) * self.square)
        if pattern[0] >= self.width or pattern[1] >= self.height:
            raise ConfigError(
                f"{self.columns}x{self.rows} corners with squares of {self.square} m measure "
                f"{pattern[0]:.3f} x {pattern[1]:.3f} m and do not fit on a board of "
                f"{self.width} x {self.height} m; give columns x rows, then width x height, in the "
                "same order and in metres"
            )
        if self.columns == self.rows and not self.is_square:
            raise ConfigError(
                f"a pattern of {self.columns}x{self.rows} corners looks the same after a quarter "
                f"turn, a board of {self.width} x {self.height} m does not; use another board"
            )

    @property
    def corners(self) -> NDArray[np.float64]:
        """Inner corners row by row, board frame, shape (rows * columns, 3) [m]."""
        y, x = np.indices((self.rows, self.columns), dtype=np.float64).reshape(2, -1)
        middle = 0.5 * (np.array((self.columns, self.rows)) - 1)
        corners = np.zeros((len(x), 3))
        corners[:, :2] = (np.stack([x, y], axis=1) - middle) * self.square
        return corners

    @property
    def outline(self) -> NDArray[np.float64]:
        """Corners of the outline, board frame, shape (4, 3) [m]."""
        signs = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)])
        return signs * (0.5 * self.width, 0.5 * self.height, 0.0)

    @property
    def half_size(self) -> NDArray[np.float64]:
        """Half of width and height, shape (2,) [m]."""
        return np.array((0.5 * self.width, 0.5 * self.height))

    @property
    def diagonal(self) -> float:
        return float(np.hypot(self.width, self.height))

    @property
    def is_square(self) -> bool:
        return abs(self.width - self.height) < _SQUARE_BOARD * max(self.width, self.height)

    def distance(self, places: NDArray[np.float64]) -> NDArray[np.float64]:
        """Signed distance of places (N, 2) on the board from the outline, positive outside [m]."""
        x = np.abs(places[:, 0]) - 0.5 * self.width
        y = np.abs(places[:, 1]) - 0.5 * self.height
        outside = np.hypot(np.maximum(x, 0.0), np.maximum(y, 0.0))
        return np.asarray(outside + np.minimum(np.maximum(x, y), 0.0))


def parse_board(corners: str, square: float, size: str, pattern: str = PATTERNS[0]) -> Board:
    """A board from ``COLUMNSxROWS`` and ``WIDTHxHEIGHT`` in metres."""
    counts = re.fullmatch(r"(\d{1,3})x(\d{1,3})", corners.strip().lower())
    sides = re.fullmatch(r"(\d*\.?\d+)x(\d*\.?\d+)", size.strip().lower())
    if counts is None:
        raise ConfigError(f"corners {corners!r} must be COLUMNSxROWS inner corners, such as 5x7")
    if sides is None:
        raise ConfigError(f"board {size!r} must be WIDTHxHEIGHT in metres, such as 0.841x1.189")
    return Board(int(counts[1]), int(counts[2]), square, float(sides[1]), float(sides[2]), pattern)
