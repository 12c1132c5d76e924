"""Boards in a bare hall, seen by a LiDAR and a camera without any noise.

Rays are cut with planes here, by nothing that the code under test uses.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from docdepth.calibration.board import Board
from docdepth.calibration.calibrate import BoardPair
from docdepth.calibration.lens import Lens
from docdepth.calibration.sweeps import board_sweep
from docdepth.geometry.se3 import inverse, rotation_exp

Floats = NDArray[np.float64]

BOARD = Board(4, 6, 0.12, 0.68, 0.96)
LENS = Lens(
    "pinhole",
    np.array([(420.0, 0.0, 318.0), (0.0, 421.0, 203.0), (0.0, 0.0, 1.0)]),
    np.array((-0.1, 0.04, 0.0, 0.0, 0.0)),
    640,
    400,
)
STRAIGHT = Lens(
    "pinhole", np.array([(900.0, 0, 480), (0, 900, 360), (0, 0, 1)]), np.zeros(5), 960, 720
)
T_CAMERA_LIDAR = np.eye(4)
T_CAMERA_LIDAR[:3, :3] = rotation_exp((0.03, -0.05, 0.02)) @ np.array(
    [(0.0, -1.0, 0.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0)]
)
T_CAMERA_LIDAR[:3, 3] = (0.06, -0.12, -0.2)

# Away, azimuth, height; tilt to the side, up, in the plane; metres and degrees.
POSES = [
    (2.6, 12, -0.3, 25, 5, 10),
    (3.1, -15, -0.1, -28, 8, -20),
    (3.6, 3, 0.2, 6, 27, 35),
    (2.9, -5, -0.5, -8, -26, -8),
    (4.2, 16, -0.2, 22, 18, 50),
    (3.4, -18, 0.0, -18, -20, 15),
    (3.9, 8, -0.4, 26, -14, -40),
    (2.7, -1, -0.2, -24, 16, 70),
]


def pose(away: float, azimuth: float, z: float, side: float, up: float, turn: float) -> Floats:
    """``T_lidar_board`` of a board whose front looks at the LiDAR but for its tilt."""
    angle = np.radians(azimuth)
    ahead = np.array((np.cos(angle), np.sin(angle), 0.0))
    right, down = np.array((np.sin(angle), -np.cos(angle), 0.0)), np.array((0.0, 0.0, -1.0))
    T = np.eye(4)
    level = np.stack([right, down, ahead], axis=1)
    tilt = rotation_exp(np.radians((0.0, side, 0.0))) @ rotation_exp(np.radians((up, 0.0, 0.0)))
    T[:3, :3] = level @ tilt @ rotation_exp(np.radians((0.0, 0.0, turn)))
    T[:3, 3] = away * ahead + (0.0, 0.0, z)
    return T


def all_poses() -> list[Floats]:
    return [pose(*numbers) for numbers in POSES]


def corners_of(T_lidar_board: Floats, board: Board = BOARD) -> Floats:
    """Exact pixels of the inner corners."""
    T = T_CAMERA_LIDAR @ T_lidar_board
    return LENS.project(board.corners @ T[:3, :3].T + T[:3, 3])


def sweep_of(T_lidar_board: Floats, board: Board = BOARD, wall: float | None = None) -> Floats:
    """Points (N, 3) of a LiDAR of 56 rings, which looks ahead; ``wall`` is metres behind the board,
    parallel to it, 3 m wide."""
    azimuth, elevation = np.radians(np.arange(-32, 32, 0.5)), np.radians(np.linspace(16, -27, 56))
    a, e = (x.ravel() for x in np.meshgrid(azimuth, elevation))
    rays = np.stack([np.cos(a) * np.cos(e), np.sin(a) * np.cos(e), np.sin(e)], axis=1)
    reach = np.full(len(rays), np.inf)
    # Floor, and walls ahead and on both sides.
    planes = [((0, 0, -1), 1.6), ((1, 0, 0), 9.0), ((0, 1, 0), 6.0), ((0, -1, 0), 6.0)]
    for normal, distance in planes:
        with np.errstate(divide="ignore"):
            away = distance / (rays @ np.array(normal, float))
        reach = np.where(away > 0, np.minimum(reach, away), reach)
    half = np.array((board.width, board.height)) / 2
    _stop(rays, reach, T_lidar_board, half)
    if wall is not None:
        behind = T_lidar_board.copy()
        behind[:3, 3] += wall * behind[:3, 2]
        _stop(rays, reach, behind, np.array((1.5, 1.5)))
    return rays * reach[:, None]


def _stop(rays: Floats, reach: Floats, T: Floats, half: Floats) -> None:
    """End rays at a rectangle, in place."""
    away = (T[:3, 3] @ T[:3, 2]) / (rays @ T[:3, 2])
    places = (away[:, None] * rays - T[:3, 3]) @ T[:3, :2]
    hit = (away > 0) & (away < reach) & (np.abs(places) < half).all(axis=1)
    reach[hit] = away[hit]


def pair(
    name: str,
    T_lidar_board: Floats,
    swept: Floats | None = None,
    board: Board = BOARD,
    wall: float | None = None,
    box: Floats | None = None,
) -> BoardPair:
    """Image and sweep of a board; in the sweep it may be elsewhere."""
    points = sweep_of(T_lidar_board if swept is None else swept, board, wall).astype(np.float32)
    return BoardPair(name, corners_of(T_lidar_board, board), board_sweep(points, None, box))


def pairs(poses: Sequence[Floats] | None = None) -> list[BoardPair]:
    """All pairs, every second with its corners from the other end, as detectors give them."""
    found = [pair(f"pose{k}", T) for k, T in enumerate(poses or all_poses())]
    return [
        BoardPair(p.name, p.corners[::-1] if k % 2 else p.corners, p.sweep)
        for k, p in enumerate(found)
    ]


def picture(
    board: Board, lens: Lens, T_camera_board: NDArray[np.float64], rng: np.random.Generator
) -> NDArray[np.uint8]:
    """An image of the board before a gray background, (height, width, 3)."""
    v, u = np.indices((lens.height, lens.width), dtype=np.float64).reshape(2, -1)
    rays = lens.rays(np.stack([u, v], axis=1))
    directions = np.column_stack([rays, np.ones(len(rays))])
    T = inverse(T_camera_board)
    way, start = directions @ T[:3, :3].T, T[:3, 3]
    share = -start[2] / way[:, 2]
    places = start[:2] + share[:, None] * way[:, :2]
    # Edges as soft as a pixel is wide.
    pixel = (share / lens.K[0, 0])[:, None]
    cell = places / board.square + 0.5 * np.array((board.columns + 1, board.rows + 1))
    wave = np.sin(np.pi * cell) * board.square / np.pi / np.abs(pixel)
    check = np.prod(np.clip(wave, -0.5, 0.5) * 2, axis=1)
    inside = ((cell > 0) & (cell < (board.columns + 1, board.rows + 1))).all(axis=1)
    tone = np.where(inside, 0.5 - 0.45 * check, 0.95)
    shown = (board.distance(places) < 0) & (share > 0)
    gray = np.where(shown, tone, 0.35) * 220 + rng.normal(0, 2, len(tone))
    image = np.clip(gray, 0, 255).astype(np.uint8).reshape(lens.height, lens.width)
    return np.repeat(image[..., None], 3, axis=2)


def held(rng: np.random.Generator, near: float, far: float) -> Floats:
    """``T_camera_board`` of a board in the picture, tilted by up to 30 degrees."""
    T = np.eye(4)
    tilt, turn = np.radians(rng.uniform(-30, 30, 2)), np.radians(rng.uniform(-15, 15))
    T[:3, :3] = rotation_exp((*tilt, 0)) @ rotation_exp((0, 0, turn))
    T[:3, 3] = *rng.uniform(-0.15, 0.15, 2), rng.uniform(near, far)
    return T


def printed(board: Board, T_camera_board: Floats) -> NDArray[np.uint8]:
    """An image of a flat board by :data:`STRAIGHT`, by the homography of its plane."""
    size = STRAIGHT.width, STRAIGHT.height
    scale, margin = 100, 60  # pixels of a square, and around the squares
    squares = board.columns + 1, board.rows + 1
    width, height = (n * scale + 2 * margin for n in squares)
    page = np.full((height, width), 235, np.uint8)
    if board.pattern == "circles":
        for y in range(board.rows):
            for x in range(board.columns):
                place = tuple(16 * (margin + scale * (n + 1)) - 8 for n in (x, y))
                cv2.circle(page, place, 16 * 30, 20, -1, cv2.LINE_AA, 4)
    elif board.pattern == "charuco":
        known = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_1000)
        markers = cv2.aruco.CharucoBoard(squares, 1.0, 0.7, known)
        inner = markers.generateImage((width - 2 * margin, height - 2 * margin))
        page[margin:-margin, margin:-margin] = inner
    else:
        dark = (np.indices((squares[1], squares[0])).sum(axis=0) % 2).astype(np.uint8)
        inner = np.kron(235 - 215 * dark, np.ones((scale, scale), np.uint8))
        page[margin:-margin, margin:-margin] = inner
    side = board.square / scale  # a pixel of the page in metres, and that of its first one
    begin = [-side * (margin + scale * n / 2 - 0.5) for n in squares]
    to_board = np.array([(side, 0, begin[0]), (0, side, begin[1]), (0, 0, 1)])
    T = T_camera_board
    homography = STRAIGHT.K @ np.stack([T[:3, 0], T[:3, 1], T[:3, 3]], axis=1) @ to_board
    large = np.diag([4.0, 4.0, 1.0]) @ np.array([(1, 0, 0.375), (0, 1, 0.375), (0, 0, 1)])
    image = cv2.warpPerspective(
        page, large @ homography, (4 * size[0], 4 * size[1]), borderValue=120
    )
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA)
