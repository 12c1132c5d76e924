"""The board in images: corners to a fraction of a pixel, and the board's pose."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from docdepth.calibration.board import Board
from docdepth.calibration.lens import Lens
from docdepth.geometry.se3 import rigid, transform_points

Floats = NDArray[np.float64]
_SUBPIXEL = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
# Columns and rows more than told, the largest first: it has the smaller ones as parts.
_MORE = ((2, 2), (1, 1), (0, 1), (1, 0))
_LESS = ((0, -1), (-1, 0), (-1, -1), (-2, -2))
_SMOOTH = 1.0  # pixels, standard deviation; shifts corners by 0.05 px
_FEWEST = 3  # corners to each side of the smallest board that OpenCV looks for

_MARKERS = (
    cv2.aruco.DICT_APRILTAG_36H11, cv2.aruco.DICT_4X4_1000, cv2.aruco.DICT_5X5_1000,
    cv2.aruco.DICT_6X6_1000,
)  # fmt: skip
_MARKER_SIDE = 0.75  # of a square; boards of 0.5 to 0.8 are found
_FEWEST_MARKERS = 4  # a stain may look like one


def find_corners(image: NDArray[np.uint8], board: Board, thorough: bool = True) -> Floats | None:
    """Inner corners of the board in an image (h, w, 3), pixels (n, 2); None if it is not there.

    ``thorough`` takes seconds for an image without a board.

    The corners run along the rows of the board. They begin at either end: a board looks the same
    after half a turn.
    """
    gray = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
    find = {"charuco": _charuco_corners, "circles": _circles}.get(board.pattern)
    corners = find(gray, board) if find else _checkerboard_corners(gray, board, thorough)
    if corners is None:
        return None
    grid = np.asarray(corners, np.float64).reshape(board.rows, board.columns, 2)
    return (grid if _right_handed(grid) else grid[:, ::-1]).reshape(-1, 2)


def _circles(gray: NDArray[np.uint8], board: Board) -> NDArray[np.float32] | None:
    """Centres of a grid of circles."""
    found, centres = cv2.findCirclesGrid(gray, (board.columns, board.rows))
    return centres if found else None


def _charuco_corners(gray: NDArray[np.uint8], board: Board) -> NDArray[np.float32] | None:
    """Corners of a ChArUco board of one of ``_MARKERS``, if all are seen."""
    squares = (board.columns + 1, board.rows + 1)
    for known in _MARKERS:
        for is_old in (False, True):  # before OpenCV 4.6 boards of even rows began with a marker
            dictionary = cv2.aruco.getPredefinedDictionary(known)
            charuco = cv2.aruco.CharucoBoard(squares, 1.0, _MARKER_SIDE, dictionary)
            charuco.setLegacyPattern(is_old)
            corners, ids, _, _ = cv2.aruco.CharucoDetector(charuco).detectBoard(gray)
            if ids is not None and len(ids) == board.columns * board.rows:
                return np.asarray(corners, np.float32)[np.argsort(ids.ravel())]
    return None


def _checkerboard_corners(
    gray: NDArray[np.uint8], board: Board, thorough: bool
) -> NDArray[np.float32] | None:
    found, corners = cv2.findChessboardCornersSB(
        gray, (board.columns, board.rows), _SUBPIXEL if thorough else cv2.CALIB_CB_ACCURACY
    )
    if not found and not thorough:
        return None
    if not found:
        # Noise and sharpening hide corners from this search.
        smooth = cv2.GaussianBlur(gray, (0, 0), _SMOOTH)
        found, corners = cv2.findChessboardCornersSB(smooth, (board.columns, board.rows), _SUBPIXEL)
    return np.asarray(corners, np.float32) if found else None


def counted_corners(image: NDArray[np.uint8], board: Board, found: bool) -> tuple[int, int] | None:
    """Inner corners of the checkerboard in an image, if they are miscounted by one or two.

    Parameters
    ----------
    found : bool
        It was found, but it may be a part of a larger one.

    Returns
    -------
    (int, int) or None
        None where there is no such checkerboard.
    """
    gray = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
    for columns, rows in _MORE if found else _MORE + _LESS:
        counts = (board.columns + columns, board.rows + rows)
        if min(counts) >= _FEWEST and cv2.findChessboardCornersSB(gray, counts, _SUBPIXEL)[0]:
            return counts
    return None


def shows_markers(image: NDArray[np.uint8]) -> bool:
    """Whether an image shows the markers of an AprilGrid or a ChArUco board."""
    gray = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
    for known in _MARKERS:
        detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(known))
        if len(detector.detectMarkers(gray)[0]) >= _FEWEST_MARKERS:
            return True
    return False


def board_pose(corners: Floats, board: Board, lens: Lens) -> tuple[Floats, float]:
    """``T_camera_board`` (4, 4) from the corners in an image, and their error, RMS in pixels."""
    places, rays = board.corners, lens.rays(corners)
    _, vectors, shifts, _ = cv2.solvePnPGeneric(
        places, rays, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE
    )
    candidates = []
    for vector, shift in zip(vectors, shifts, strict=True):
        _, vector, shift = cv2.solvePnP(
            places, rays, np.eye(3), None, vector.copy(), shift.copy(), useExtrinsicGuess=True
        )
        pose = rigid(cv2.Rodrigues(vector)[0], np.ravel(shift))
        seen = lens.project(transform_points(pose, places))
        error = float(np.sqrt(np.mean(np.sum((seen - corners) ** 2, axis=1))))
        candidates.append((np.inf if np.isnan(error) else error, pose))
    error, pose = min(candidates, key=lambda candidate: candidate[0])
    return pose, error


def _right_handed(grid: Floats) -> bool:
    """Whether rows follow columns clockwise in the image, as they do on the front of a board."""
    along, down = grid[:, -1] - grid[:, 0], grid[-1] - grid[0]
    along, down = along.mean(axis=0), down.mean(axis=0)
    return bool(along[0] * down[1] - along[1] * down[0] > 0)
