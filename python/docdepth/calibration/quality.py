"""How good a calibration is: boards left out one by one, independent halves, size of the board.

K is estimated anew each time where it is not given, so that these measures include what it costs.
The residual of the boards that were used tells little: planes fit to millimetres where halves of
the same boards differ by centimetres.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from docdepth.calibration.board import Board
from docdepth.calibration.bundle import AT_EDGE, Observation, Solution, pose_by_sweep, solve_bundle
from docdepth.calibration.consensus import solve_scale
from docdepth.calibration.corners import board_pose
from docdepth.calibration.find import FEWEST_BOARDS
from docdepth.calibration.outline import rays_near
from docdepth.concurrency import Progress, null_progress
from docdepth.errors import CalibrationError
from docdepth.geometry.se3 import inverse, rotation_log, transform_points

Floats = NDArray[np.float64]

_SPLITS = 30  # the median of 10 is uncertain by 0.07 degrees with 20 boards, of 30 by 0.02
_LEAST_SCALE = 0.03  # of the size; smaller differences may be range errors of the LiDAR
_LEAST_SIZE = 0.04  # metres
_LOOKED_AROUND = 0.3  # metres outside the board


@dataclass(frozen=True)
class LeftOutBoard:
    """What the calibration without one board says about it."""

    name: str
    # distance of the corners of its outline, as the LiDAR has them, from those of the camera, RMS
    # in the image
    pixels: float
    metres: float  # the same distance in space
    T_camera_lidar: Floats  # (4, 4)


@dataclass(frozen=True)
class Halves:
    """Differences of the extrinsic between halves of the boards that share none."""

    # degrees, centimetres: (n,): one for each random split; of the LiDAR's place as the camera has
    # it
    degrees: Floats
    centimetres: Floats


def leave_one_out(
    board: Board,
    observations: Sequence[Observation],
    solution: Solution,
    free_lens: bool,
    progress: Progress = null_progress,
) -> list[LeftOutBoard]:
    """Calibrate without each board in turn, and compare what LiDAR and camera say of it."""
    left_out = []
    for k, observation in enumerate(observations):
        progress("each left out", k + 1, len(observations))
        rest = [j for j in range(len(observations)) if j != k]
        others = solve_bundle(
            board, [observations[j] for j in rest], solution.of(rest), free_lens, AT_EDGE[-1:]
        )
        pose, lens = board_pose(observation.corners, board, others.lens)[0], others.lens
        seen = transform_points(pose, board.outline)
        pose = pose_by_sweep(board, observation, others, pose)
        swept = transform_points(pose, board.outline)
        left_out.append(
            LeftOutBoard(
                observation.name,
                _rms(lens.project(swept) - lens.project(seen)),
                _rms(swept - seen),
                others.T_camera_lidar,
            )
        )
    return left_out


def halves(
    board: Board,
    observations: Sequence[Observation],
    solution: Solution,
    free_lens: bool,
    progress: Progress = null_progress,
) -> Halves | None:
    """Compare calibrations of random halves; None for too few boards."""
    count, rng = len(observations), np.random.default_rng(0)
    if count < 2 * FEWEST_BOARDS:
        return None
    found = []
    for k in range(_SPLITS):
        progress("halves", k + 1, _SPLITS)
        order = rng.permutation(count)
        pair = []
        for rows in (np.sort(order[: count // 2]), np.sort(order[count // 2 :])):
            part = [observations[j] for j in rows.tolist()]
            start = solution.of(rows.tolist())
            half = solve_bundle(board, part, start, free_lens, AT_EDGE[-1:])
            pair.append(half.T_camera_lidar)
        found.append(difference(*pair))
    degrees, centimetres = np.array(found).T
    return Halves(degrees, centimetres)


def uncertainty(left_out: Sequence[LeftOutBoard]) -> tuple[Floats, Floats]:
    """Standard deviations of the turn [deg] and the shift [cm] about the camera's axes, (3,) each.

    By the jackknife: of how much the extrinsic changes when one board is left out.
    """
    moves = []
    for one in left_out:
        D = one.T_camera_lidar @ inverse(left_out[0].T_camera_lidar)
        shift = one.T_camera_lidar[:3, 3] - left_out[0].T_camera_lidar[:3, 3]
        moves.append(np.concatenate([np.degrees(rotation_log(D[:3, :3])), 100.0 * shift]))
    spread = np.std(np.array(moves), axis=0) * np.sqrt(len(left_out) - 1)
    return spread[:3], spread[3:]


def difference(a: Floats, b: Floats) -> tuple[float, float]:
    """Angle [deg] of two ``T_camera_lidar`` and distance [cm] of the cameras they place."""
    turn = rotation_log(a[:3, :3] @ b[:3, :3].T)
    shift = inverse(a)[:3, 3] - inverse(b)[:3, 3]
    return float(np.degrees(np.linalg.norm(turn))), 100.0 * float(np.linalg.norm(shift))


def check_size(board: Board, observations: Sequence[Observation], T_lidar_camera: Floats) -> None:
    """Refuse a board that is not as large as it was said to be."""
    width, height = measured_size(board, observations)
    if max(abs(width - board.width), abs(height - board.height)) > _LEAST_SIZE:
        raise CalibrationError(
            f"the board measures about {width:.2f} x {height:.2f} m in the sweeps, not "
            f"{board.width} x {board.height} m; measure it, and mind the order of width and height",
            code="size-of-board",
        )
    seen = np.stack([o.T_camera_board for o in observations])
    swept = np.stack([o.T_lidar_board for o in observations])
    scale, spread = solve_scale(seen, swept, T_lidar_camera)
    if abs(scale - 1.0) > _LEAST_SCALE + 3.0 * spread:
        raise CalibrationError(
            f"the distances of the LiDAR say that squares measure {board.square * scale:.4f} m, "
            f"not {board.square} m; measure them. If they are right, K is wrong by "
            f"{100 * abs(scale - 1):.0f} %",
            code="size-of-squares",
        )


def measured_size(board: Board, observations: Sequence[Observation]) -> tuple[float, float]:
    """Width and height [m] for which most rays agree with the outline."""
    places, on = [], []
    for o in observations:
        rays = rays_near(o.sweep, board, inverse(o.T_lidar_board), _LOOKED_AROUND)
        places.append(rays.places)
        on.append(rays.on)
    place, hit = np.abs(np.concatenate(places)), np.concatenate(on)
    sizes = []
    for axis in (0, 1):
        rows = place[:, 1 - axis] < 0.35 * 2 * board.half_size[1 - axis]
        halves = np.arange(0.5 * board.half_size[axis], board.half_size[axis] + 0.25, 0.005)
        agreed = [float(((place[rows, axis] < half) == hit[rows]).mean()) for half in halves]
        sizes.append(2.0 * float(halves[int(np.argmax(agreed))]))
    return sizes[0], sizes[1]


def _rms(offsets: Floats) -> float:
    return float(np.sqrt(np.mean(np.sum(offsets**2, axis=1))))
