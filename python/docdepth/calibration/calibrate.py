"""The whole calibration: images and sweeps of a checkerboard to K and ``T_camera_lidar``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from docdepth.calibration.board import Board
from docdepth.calibration.bundle import Observation, Solution, solve_bundle
from docdepth.calibration.corners import board_pose
from docdepth.calibration.find import FEWEST_BOARDS, SeenBoard, check_varied, find_boards
from docdepth.calibration.lens import Lens, estimate_lens
from docdepth.calibration.quality import (
    Halves,
    LeftOutBoard,
    check_size,
    halves,
    leave_one_out,
    uncertainty,
)
from docdepth.calibration.sweeps import BoardSweep
from docdepth.errors import CalibrationError
from docdepth.geometry.se3 import inverse

Floats = NDArray[np.float64]

_DISAGREES = 0.03  # metres at the corners of the outline; less may be noise
_TIMES_MEDIAN = 4.0  # a board that disagrees by so many times what is usual is left out
_MOST_DISAGREE = 1 / 3  # of the boards; if more disagree, nothing tells which are right
_MOST_PIXELS = 3.0  # RMS of the corners of one image; above, they are not of the board


@dataclass(frozen=True)
class BoardPair:
    """An image and a sweep of a still board.

    Attributes
    ----------
    name : str
    corners : ndarray of float64, shape (n, 2), or None
        Pixels of the inner corners; None where they were not found.
    sweep : BoardSweep
    """

    name: str
    corners: Floats | None
    sweep: BoardSweep


@dataclass(frozen=True)
class Calibration:
    """Camera, extrinsic, and what they are worth.

    Attributes
    ----------
    lens : Lens
    T_camera_lidar : ndarray of float64, shape (4, 4)
    observations : list of Observation
        The boards that were used.
    solution : Solution
    boards : list of LeftOutBoard
        What the others say about each board.
    halves : Halves or None
        None for too few boards.
    turn_deg, shift_cm : ndarray of float64, shape (3,)
        Standard deviations about the camera's axes.
    left_out : dict of str to str
        Pairs that were not used, and why.
    """

    lens: Lens
    T_camera_lidar: Floats
    observations: list[Observation]
    solution: Solution
    boards: list[LeftOutBoard]
    halves: Halves | None
    turn_deg: Floats
    shift_cm: Floats
    left_out: dict[str, str]


def calibrate(
    board: Board,
    pairs: Sequence[BoardPair],
    size: tuple[int, int],
    lens: Lens | None = None,
    model: str = "pinhole",
    progress: Callable[[int, int], None] | None = None,
) -> Calibration:
    """Calibrate a camera and a LiDAR.

    Parameters
    ----------
    board : Board
    pairs : sequence of BoardPair
    size : (int, int)
        Width and height of the images in pixels.
    lens : Lens, optional
        Estimated from the same images if left out.
    model : {"pinhole", "fisheye"}
        Of the lens, if it is estimated.
    progress : callable, optional
        Called with the number of sweeps searched and the number of all.

    Raises
    ------
    CalibrationError
        Too few boards, too parallel ones, or another board than the one described.
    """
    solution, observations, left_out = solve(board, pairs, size, lens, model, progress)
    free_lens = lens is None
    dropped = 0
    while True:
        boards = leave_one_out(board, observations, solution)
        worst = max(boards, key=lambda one: one.metres)
        usual = float(np.median([one.metres for one in boards]))
        if worst.metres <= max(_DISAGREES, _TIMES_MEDIAN * usual):
            break
        dropped += 1
        left_out[worst.name] = (
            f"LiDAR and camera disagree by {100 * worst.metres:.0f} cm about its place, usual are "
            f"{100 * usual:.1f} cm; did it move between image and sweep?"
        )
        observations = [o for o in observations if o.name != worst.name]
        _check_count(observations, dropped, left_out)
        start = _start(observations, solution.T_camera_lidar, solution.lens)
        solution = solve_bundle(board, observations, start, free_lens)
    turn, shift = uncertainty(boards)
    return Calibration(
        solution.lens,
        solution.T_camera_lidar,
        observations,
        solution,
        boards,
        halves(board, observations, solution),
        turn,
        shift,
        left_out,
    )


def solve(
    board: Board,
    pairs: Sequence[BoardPair],
    size: tuple[int, int],
    lens: Lens | None = None,
    model: str = "pinhole",
    progress: Callable[[int, int], None] | None = None,
) -> tuple[Solution, list[Observation], dict[str, str]]:
    """Find all boards and solve for K and the extrinsic, without a judgement of the result.

    Returns
    -------
    solution : Solution
    observations : list of Observation
    left_out : dict of str to str
        Pairs that were not used, and why.
    """
    left_out = {
        pair.name: f"no whole checkerboard of {board.columns}x{board.rows} inner corners in the "
        "image: it is partly out of the picture, blurred or hidden"
        for pair in pairs
        if pair.corners is None
    }
    in_image = [(pair, pair.corners) for pair in pairs if pair.corners is not None]
    if len(in_image) < FEWEST_BOARDS:
        names = f": not in {', '.join(left_out)}" if left_out else ""
        raise CalibrationError(
            f"too few boards: the checkerboard was found in {len(in_image)} of {len(pairs)} images, "
            f"at least {FEWEST_BOARDS} are needed, 10 or more are better{names}"
        )
    known = lens or estimate_lens(board, [corners for _, corners in in_image], size, model)[0]
    seen = []
    for pair, corners in in_image:
        pose, error = board_pose(corners, board, known)
        if error > _MOST_PIXELS:
            left_out[pair.name] = (
                f"its corners miss the checkerboard by {error:.1f} px (RMS): another board, or the "
                "wrong K"
            )
            continue
        seen.append(SeenBoard(pair.name, corners, pose, pair.sweep))
    if len(seen) < FEWEST_BOARDS:
        raise CalibrationError(
            f"the corners of {len(in_image) - len(seen)} of {len(in_image)} images do not fit a "
            f"checkerboard seen through this lens (more than {_MOST_PIXELS:.0f} px): K, the lens "
            "model or the number of corners is wrong"
        )
    check_varied(np.stack([s.T_camera_board[:3, 2] for s in seen]), "in the images")
    observations, T_lidar_camera, missing = find_boards(board, seen, progress)
    check_size(board, observations, T_lidar_camera)
    start = _start(observations, inverse(T_lidar_camera), known)
    solution = solve_bundle(board, observations, start, lens is None)
    return solution, observations, left_out | missing


def _start(observations: Sequence[Observation], T_camera_lidar: Floats, lens: Lens) -> Solution:
    return Solution(T_camera_lidar, np.stack([o.T_camera_board for o in observations]), lens)


def _check_count(
    observations: Sequence[Observation], dropped: int, left_out: dict[str, str]
) -> None:
    if len(observations) < FEWEST_BOARDS or dropped > _MOST_DISAGREE * (
        len(observations) + dropped
    ):
        raise CalibrationError(
            f"the boards disagree with each other, and leaving out {dropped} does not help: "
            + "; ".join(f"{name}: {reason}" for name, reason in left_out.items())
        )
