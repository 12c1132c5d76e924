"""The board in every sweep: searched in a few, then looked for where it is expected."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from docdepth.calibration.board import Board
from docdepth.calibration.bundle import Observation
from docdepth.calibration.consensus import (
    agrees,
    find_extrinsic,
    nearest_turn,
    normals_condition,
    solve_linear,
)
from docdepth.calibration.outline import PAST, crossings
from docdepth.calibration.search import Patch, find_patches, fit_patch
from docdepth.calibration.sweeps import BoardSweep
from docdepth.concurrency import Progress, null_progress
from docdepth.errors import CalibrationError
from docdepth.geometry.se3 import inverse

Floats = NDArray[np.float64]

FEWEST_BOARDS = 4
"""Boards without which nothing is calibrated: three planes fix the extrinsic, one checks it."""

LEAST_CONDITION = 0.1
"""Smallest singular value of the boards' normals by the largest: 0 for parallel boards."""

_LEVER_ARMS = (0.7, 2.5)  # metres between camera and LiDAR; the nearer is tried first
_FIRST_SEARCHED = 6  # sweeps; three that agree are enough
_MOST_SEARCHED = 12  # sweeps; what so many do not hold, more will not
_FEWEST_VOTES = 3
_LEAST_SCORE = 0.6
_EXPECTED = 0.15  # metres between the plane of a board and where it is expected
_ROUNDS = 3


@dataclass(frozen=True)
class SeenBoard:
    """A board found in an image, and the sweep of the same moment."""

    name: str
    corners: Floats  # (n, 2): pixels
    T_camera_board: Floats  # (4, 4)
    sweep: BoardSweep


def check_varied(normals: Floats, where: str) -> None:
    """Refuse boards that are all but parallel; normals (n, 3)."""
    condition = normals_condition(normals)
    if condition < LEAST_CONDITION:
        mean = normals.mean(axis=0) / np.linalg.norm(normals.mean(axis=0))
        widest = np.degrees(np.arccos(np.clip(normals @ mean, -1, 1).min()))
        raise CalibrationError(
            f"the {len(normals)} boards {where} are too parallel (condition {condition:.3f}, at "
            f"least {LEAST_CONDITION}; at most {widest:.0f} degrees from their mean): they do not "
            "fix the extrinsic. Tilt the board by 20 to 40 degrees, in some pairs to the left and "
            "right, in some up and down",
            code="parallel-boards",
        )


def find_boards(
    board: Board, seen: Sequence[SeenBoard], progress: Progress = null_progress
) -> tuple[list[Observation], Floats, dict[str, str]]:
    """Find the board in all sweeps.

    Returns
    -------
    observations : list of Observation
    T_lidar_camera : ndarray of float64, shape (4, 4)
        From planes alone.
    not_used : dict of str to str
        Why the board was not found, by name.
    """
    T_lidar_camera = _first_extrinsic(board, seen, progress)
    for _ in range(_ROUNDS):
        found, not_used = _expected_boards(board, seen, T_lidar_camera)
        if len(found) < FEWEST_BOARDS:
            raise CalibrationError(
                f"the board was found in {len(found)} of {len(seen)} sweeps, at least "
                f"{FEWEST_BOARDS} are needed: {_listed(not_used)}",
                code="few-boards",
            )
        swept = np.stack([o.T_lidar_board for o in found])
        check_varied(swept[:, :3, 2], "found in the sweeps")
        T_lidar_camera = solve_linear(np.stack([o.T_camera_board for o in found]), swept)
    return found, T_lidar_camera, not_used


def _first_extrinsic(board: Board, seen: Sequence[SeenBoard], progress: Progress) -> Floats:
    """``T_lidar_camera`` out of free patches: in some sweeps first, then in all."""
    best = searched = 0
    for lever_arm in _LEVER_ARMS:
        patches: list[list[Patch]] = [[] for _ in seen]
        order = np.argsort(np.arange(len(seen)) * _FIRST_SEARCHED % len(seen), kind="stable")
        for done, k in enumerate(order.tolist()[:_MOST_SEARCHED], 1):
            away = float(np.linalg.norm(seen[k].T_camera_board[:3, 3]))
            limits = (away - lever_arm, away + lever_arm)
            patches[k] = find_patches(seen[k].sweep, board, limits)
            progress("sweeps", done, min(len(seen), _MOST_SEARCHED))
            if done < min(_FIRST_SEARCHED, len(seen)):
                continue
            cameras = [s.T_camera_board for s in seen]
            T, votes = find_extrinsic(cameras, patches, board, lever_arm)
            if T is not None and votes >= max(_FEWEST_VOTES, done // 2):
                return T
            best, searched = max(best, votes), done
    raise CalibrationError(
        f"the board was not found in the sweeps: no extrinsic puts more than {best} of {searched} "
        f"boards on a flat, free patch of {board.width} x {board.height} m. Are the sizes of board "
        "and squares right, in metres, and K? Do columns and width come before rows and height? Do "
        "images and sweeps belong together? The board must stand "
        f"{100 * PAST:.0f} cm or more in front of walls and people; else say where it is (`boxes`)",
        code="board-not-found",
    )


def _expected_boards(
    board: Board, seen: Sequence[SeenBoard], T_lidar_camera: Floats
) -> tuple[list[Observation], dict[str, str]]:
    found: list[Observation] = []
    not_used: dict[str, str] = {}
    for view in seen:
        expected = T_lidar_camera @ view.T_camera_board
        patch = fit_patch(view.sweep, board, expected, _EXPECTED)
        pose = None if patch is None else nearest_turn(patch.T_lidar_board, expected, board)
        if patch is None or pose is None or patch.score < _LEAST_SCORE:
            not_used[view.name] = why_missing(board, view.sweep, expected)
        elif not agrees(pose, expected):
            away = float(np.linalg.norm(pose[:3, 3] - expected[:3, 3]))
            not_used[view.name] = (
                f"its board stands {away:.2f} m from where the others put it; did it move between "
                "image and sweep, or do they not belong together?"
            )
        else:
            near = view.sweep.around(pose[:3, 3], board.diagonal)
            found.append(Observation(view.name, view.corners, view.T_camera_board, pose, near))
    return found, not_used


def why_missing(board: Board, sweep: BoardSweep, expected: Floats) -> str:
    """Why no board is found at its expected ``T_lidar_board``, in words."""
    near = sweep.around(expected[:3, 3], board.diagonal)
    places, height = crossings(near.points, near.origins, inverse(expected))
    distance = np.nan_to_num(board.distance(places), nan=np.inf)
    inside, around = distance < -0.03, (distance > 0.05) & (distance < 0.25)
    if inside.sum() < 25:
        return (
            f"the LiDAR has {inside.sum()} returns where the board should be: it stands outside "
            "its field of view, or too far away"
        )
    if (height[inside] < -_EXPECTED).mean() > 0.3:
        return "something in front of the board hides it from the LiDAR"
    if (np.abs(height[inside]) < _EXPECTED).mean() < 0.5:
        return (
            "no board stands where the others expect it; did it move between image and sweep, or "
            "do they not belong together?"
        )
    if (np.abs(height[around]) < PAST).mean() > 0.3:
        return (
            f"a wall or person less than {100 * PAST:.0f} cm from the board hides its edges; hold "
            "it free, or say where it is (`boxes`)"
        )
    return "what stands there is not of the board's size, or not flat"


def _listed(not_used: dict[str, str]) -> str:
    """Each reason once, with the names."""
    reasons: dict[str, list[str]] = {}
    for name, reason in not_used.items():
        reasons.setdefault(reason, []).append(name)
    return "; ".join(f"{', '.join(names)}: {reason}" for reason, names in reasons.items())
