"""One robust bundle over the extrinsic, the pose of every board, and K where it is not given.

It minimises, in standard deviations,

* corners in the images: reprojection,
* returns on the board: distance from its plane,
* rays at its outline: those that it stopped lie inside, those that went past lie outside. The
  chance that a ray at distance s from the outline is stopped is Phi((growth - s) / blur): a beam
  has a width, so the board looks larger to the LiDAR than it is, by one free number for all boards.
  A few rays meet hands and other things, wherever the outline is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.special import ndtr

from docdepth.calibration.board import Board
from docdepth.calibration.lens import Lens
from docdepth.calibration.outline import crossings, rays_near
from docdepth.calibration.sweeps import BoardSweep
from docdepth.geometry.points import evenly
from docdepth.geometry.se3 import inverse, rotation_exp, rotation_log, transform_points

Floats = NDArray[np.float64]

_BLURS = (0.002, 0.003, 0.004, 0.006, 0.009, 0.013, 0.02)
"""Standard deviations of the place where a beam stops seeing a board [m]; the data tell which."""

_SHARED = 7  # unknowns before those of lens and boards: turn, shift, growth
_LENS = 8  # fx, fy, cx, cy and four of the distortion

TANGENTIAL = 3e-4
"""Standard deviation of Brown's p1 and p2 of lenses. Free, they trade against the principal point,
and this against the rotation."""

AT_EDGE = (0.08, 0.04, 0.04)
"""Distance from the outline within which rays count [m], in each round of the bundle."""

_STRAY = 0.02  # chance that a ray at the outline met something else, such as a hand
_AROUND = 0.15  # metres around the board whose rays are kept
_BEHIND = 1e3  # pixels; error of a corner behind the camera
_INSIDE = 0.03  # metres; returns at the edge may be of what is behind, so they tell no plane
_OUTLIER = 3.0  # standard deviations, from which on errors count less
_LEAST_NOISE = (0.05, 0.003)  # pixels, metres; nothing is better
_MOST_RETURNS = 2000  # on a board for its plane; more take time and tell no more
_LEFT_OPEN = 0.1  # metres; how uncertain the place of a board is that a sweep tells nothing of
_STEP = 1e-6  # radians and metres, of derivatives
_MOST_STEPS = 25
_CONVERGED = 1e-6  # of the cost


@dataclass(frozen=True)
class Observation:
    """One board, seen by camera and LiDAR."""

    name: str
    corners: Floats  # (n, 2): pixels
    T_camera_board: Floats  # (4, 4): from the image alone
    # (4, 4): from the sweep alone; its x axis points as that of ``T_camera_board``
    T_lidar_board: Floats
    sweep: BoardSweep  # the returns around the board


@dataclass(frozen=True)
class Solution:
    """Unknowns of the bundle, and what they leave."""

    T_camera_lidar: Floats  # (4, 4)
    T_camera_board: Floats  # (n, 4, 4)
    lens: Lens
    growth: float = 0.0  # how far the board seems to reach beyond its edge [m]
    # standard deviation of the place where a beam stops seeing a board [m]
    blur: float = _BLURS[-2]
    corner_noise: float = 0.0  # standard deviation of corners [px]
    range_noise: float = 0.0  # standard deviation of returns from the plane [m]

    def moved(self, step: Floats) -> Solution:
        """Other unknowns: turn and shift of the extrinsic, growth, lens, boards (n, 6)."""
        boards = 6 * len(self.T_camera_board)
        common = len(step) - boards
        return replace(
            self,
            T_camera_lidar=_motion(step[:6]) @ self.T_camera_lidar,
            growth=self.growth + float(step[6]),
            lens=self.lens.moved(step[_SHARED:common]) if common > _SHARED else self.lens,
            T_camera_board=self.T_camera_board @ _motion(step[common:].reshape(-1, 6)),
        )

    def of(self, rows: Sequence[int]) -> Solution:
        """The same with some of the boards."""
        return replace(self, T_camera_board=self.T_camera_board[list(rows)])


def solve_bundle(
    board: Board,
    observations: Sequence[Observation],
    start: Solution,
    free_lens: bool,
    reaches: Sequence[float] = AT_EDGE,
) -> Solution:
    """Refine the extrinsic and the poses of all boards.

    Parameters
    ----------
    free_lens : bool
        Refine K and distortion, too. What the LiDAR tells of distances makes K several times more
        certain than the images alone.
    reaches : sequence of float
        Rays at most this far from the outline count [m], in each round.
    """
    now = start
    for reach in reaches:
        views = [
            _View(board, o, now.T_camera_lidar, pose, reach)
            for o, pose in zip(observations, now.T_camera_board, strict=True)
        ]
        poses = list(zip(views, now.T_camera_board, strict=True))
        corners = np.concatenate([v.corner_errors(now.lens, p).ravel() for v, p in poses])
        heights = np.concatenate([v.heights(now, p) for v, p in poses])
        now = replace(
            now,
            corner_noise=max(_spread(corners), _LEAST_NOISE[0]),
            range_noise=max(_spread(heights), _LEAST_NOISE[1]),
        )
        if reach < AT_EDGE[0]:
            blurs = [replace(now, blur=blur) for blur in _BLURS]
            now = min(blurs, key=lambda at: sum(v.edge_cost(at, p) for v, p in poses))
        now = _descend(views, now, _SHARED + (_LENS if free_lens else 0))
    return now


class _View:
    """Residuals of one observation."""

    def __init__(
        self,
        board: Board,
        observation: Observation,
        T_camera_lidar: Floats,
        T_camera_board: Floats,
        reach: float,
    ) -> None:
        self._board, self._corners = board, observation.corners
        rays = rays_near(
            observation.sweep, board, inverse(T_camera_board) @ T_camera_lidar, _AROUND
        )
        distance = board.distance(rays.places)
        flat = rays.points[rays.on & (distance < -_INSIDE)]
        self._flat = flat[evenly(len(flat), _MOST_RETURNS)]
        edge = np.abs(distance) < reach
        self._ends, self._starts = rays.points[edge], rays.origins[edge]
        self._side = np.where(rays.on[edge], 1.0, -1.0)

    def residuals(self, at: Solution, T_camera_board: Floats) -> Floats:
        """Corners, returns and rays at the outline, in standard deviations."""
        corners = self.corner_errors(at.lens, T_camera_board).ravel() / at.corner_noise
        return np.concatenate([corners, self.lidar_part(at, T_camera_board)])

    def corner_errors(self, lens: Lens, T_camera_board: Floats) -> Floats:
        """Pixels (n, 2) from the corners found."""
        places = transform_points(T_camera_board, self._board.corners)
        return np.nan_to_num(lens.project(places) - self._corners, nan=_BEHIND)

    def heights(self, at: Solution, T_camera_board: Floats) -> Floats:
        """Distance of the returns from the plane of the board [m]."""
        T = inverse(T_camera_board) @ at.T_camera_lidar
        return np.asarray(self._flat @ T[2, :3] + T[2, 3])

    def jacobian(self, at: Solution, pose: Floats, before: Floats, common: int) -> Floats:
        """By differences, shape (n, common + 6): what all share, then the pose of the board."""
        J = np.zeros((common + 6, len(before)))
        corners = self._corners.size
        alone = replace(at, T_camera_board=pose[None])
        for k in range(_SHARED):
            moved = alone.moved(_STEP * np.eye(_SHARED + 6)[k])
            J[k, corners:] = self.lidar_part(moved, pose) - before[corners:]
        for k in range(common - _SHARED):
            lens = at.lens.moved(_STEP * np.eye(_LENS)[k])
            J[_SHARED + k, :corners] = self.corner_errors(lens, pose).ravel() / at.corner_noise
            J[_SHARED + k, :corners] -= before[:corners]
        for k in range(6):
            J[common + k] = self.residuals(at, pose @ _motion(_STEP * np.eye(6)[k])) - before
        return (J / _STEP).T

    def edge_cost(self, at: Solution, T_camera_board: Floats) -> float:
        """Minus twice the logarithm of the chance of the rays at the outline."""
        errors = self._edge_part(at, T_camera_board)
        return float(errors @ errors)

    def lidar_part(self, at: Solution, T_camera_board: Floats) -> Floats:
        """Returns and rays at the outline, in standard deviations."""
        heights = self.heights(at, T_camera_board) / at.range_noise
        return np.concatenate([heights, self._edge_part(at, T_camera_board)])

    def _edge_part(self, at: Solution, T_camera_board: Floats) -> Floats:
        T_board_lidar = inverse(T_camera_board) @ at.T_camera_lidar
        places, _ = crossings(self._ends, self._starts, T_board_lidar)
        distance = np.nan_to_num(self._board.distance(places))
        chance = ndtr(self._side * (at.growth - distance) / at.blur)
        return np.asarray(np.sqrt(-2.0 * np.log(_STRAY + (1 - _STRAY) * chance)))


def residuals(
    board: Board, observations: Sequence[Observation], at: Solution
) -> list[tuple[float, float]]:
    """What each board leaves: RMS of its corners [px], and of its returns from the plane [m]."""
    found = []
    for observation, pose in zip(observations, at.T_camera_board, strict=True):
        view = _View(board, observation, at.T_camera_lidar, pose, AT_EDGE[-1])
        errors, heights = view.corner_errors(at.lens, pose), view.heights(at, pose)
        pixels = float(np.sqrt(np.mean(np.sum(errors**2, axis=1))))
        metres = float(np.sqrt(np.mean(heights**2))) if len(heights) else float("nan")
        found.append((pixels, metres))
    return found


def covariance(
    board: Board, observations: Sequence[Observation], at: Solution, free_lens: bool
) -> Floats:
    """How far noise alone moves the extrinsic: the bound of Cramér and Rao.

    Parameters
    ----------
    free_lens : bool
        K and distortion are not known, either.

    Returns
    -------
    ndarray of float64, shape (6, 6)
        Of turn [rad] and shift [m] about the camera's axes.
    """
    common = _SHARED + (_LENS if free_lens else 0)
    views = [
        _View(board, o, at.T_camera_lidar, pose, AT_EDGE[-1])
        for o, pose in zip(observations, at.T_camera_board, strict=True)
    ]
    H, _ = _normal_equations(views, at, _values(views, at), common)
    return np.asarray(np.linalg.inv(H)[:6, :6])


def pose_by_sweep(
    board: Board, observation: Observation, at: Solution, T_camera_board: Floats
) -> Floats:
    """Where the sweep alone has a board, told in the camera's frame by a calibration.

    Parameters
    ----------
    at : Solution
        Of other boards.
    T_camera_board : ndarray of float64, shape (4, 4)
        Where the camera has it. What few rays leave open, stays as here.
    """
    lever = _LEFT_OPEN / np.array((*[0.5 * board.diagonal] * 3, 1.0, 1.0, 1.0))
    best: tuple[float, Floats] = (np.inf, T_camera_board)
    for start in (T_camera_board, at.T_camera_lidar @ observation.T_lidar_board):
        view = _View(board, observation, at.T_camera_lidar, start, _AROUND)

        def errors(step: Floats, start: Floats = start, view: _View = view) -> Floats:
            pose = start @ _motion(step)
            away = inverse(T_camera_board) @ pose
            moved = np.concatenate([rotation_log(away[:3, :3]), away[:3, 3]])
            found = view.lidar_part(at, pose)
            robust = _OUTLIER * np.sqrt(np.log1p((found / _OUTLIER) ** 2))
            return np.concatenate([robust, moved / lever])

        fit = least_squares(errors, np.zeros(6), method="lm", x_scale=lever, xtol=1e-4)
        # The rays of both starts are not the same, so their number counts, too.
        cost = 2.0 * fit.cost / len(fit.fun)
        if cost < best[0]:
            best = (cost, start @ _motion(fit.x))
    return best[1]


def _descend(views: Sequence[_View], now: Solution, common: int) -> Solution:
    """Levenberg and Marquardt with Cauchy's loss.

    Each board has residuals of its own, so the normal equations are summed board by board.
    """
    damping = 1e-4
    values = _values(views, now)
    for _ in range(_MOST_STEPS):
        H, g = _normal_equations(views, now, values, common)
        before = _cost(values, now)
        for _ in range(8):
            step = np.linalg.solve(H + damping * np.diag(np.diag(H) + 1e-9), -g)
            moved = now.moved(np.asarray(step, np.float64))
            values = _values(views, moved)
            if _cost(values, moved) < before:
                break
            damping *= 10.0
        else:
            return now
        now, damping = moved, 0.1 * damping
        if before - _cost(values, now) < _CONVERGED * before:
            break
    return now


def _values(views: Sequence[_View], at: Solution) -> list[Floats]:
    return [v.residuals(at, pose) for v, pose in zip(views, at.T_camera_board, strict=True)]


def _normal_equations(
    views: Sequence[_View], at: Solution, values: Sequence[Floats], common: int
) -> tuple[Floats, Floats]:
    size = common + 6 * len(views)
    H, g = np.zeros((size, size)), np.zeros(size)
    for k, (view, pose, value) in enumerate(zip(views, at.T_camera_board, values, strict=True)):
        J = view.jacobian(at, pose, value, common)
        weighted = J / (1.0 + (value / _OUTLIER) ** 2)[:, None]
        first = common + 6 * k
        rows = np.r_[0:common, first : first + 6]
        H[np.ix_(rows, rows)] += J.T @ weighted
        g[rows] += weighted.T @ value
    if common > _SHARED and at.lens.model == "pinhole":
        rows = np.arange(common - 2, common)
        H[rows, rows] += 1.0 / TANGENTIAL**2
        g[rows] += at.lens.distortion[2:4] / TANGENTIAL**2
    return H, g


def _cost(values: Sequence[Floats], at: Solution) -> float:
    """Half of minus the logarithm of the probability, but for a constant factor."""
    cost = sum(float(np.log1p((v / _OUTLIER) ** 2).sum()) for v in values) * _OUTLIER**2
    if at.lens.model == "pinhole":
        cost += float(((at.lens.distortion[2:4] / TANGENTIAL) ** 2).sum())
    return cost


def _spread(errors: Floats) -> float:
    """Standard deviation, robust."""
    return 1.4826 * float(np.median(np.abs(errors))) if len(errors) else 0.0


def _motion(vectors: Floats) -> Floats:
    """Rigid motions (..., 4, 4) of a turn and a shift (..., 6)."""
    T = np.zeros((*vectors.shape[:-1], 4, 4))
    T[..., :3, :3], T[..., :3, 3] = rotation_exp(vectors[..., :3]), vectors[..., 3:]
    T[..., 3, 3] = 1.0
    return T
