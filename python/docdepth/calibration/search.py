"""Boards in a whole sweep, without knowing where the camera is: flat patches that stand free.

A patch of the board's size is flat up to the board's edge and ends there. So around its centre
there are returns in its plane up to half a diagonal, and next to none beyond. Walls and ground go
on, furniture and people are not flat.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from docdepth.calibration.board import Board
from docdepth.calibration.outline import NEAR_PLANE, BoardRays, rays_near
from docdepth.calibration.sweeps import BoardSweep
from docdepth.geometry.se3 import inverse, rigid

Floats = NDArray[np.float64]

_THINNING = 0.06  # metres; returns nearer to each other tell the same about a plane
_SEED_SPACING = 0.2  # metres; several seeds fall on every board
_FEWEST = 10  # returns around a seed
_LEAST_WIDTH = 0.04  # metres; narrower sets of returns are of a single ring
_FLAT = 0.035  # metres, RMS around a seed: the noise, and not more
_BEYOND = 0.35  # share of returns beyond the edge of a patch that stands free
_LARGE = 0.9  # share beyond the edge, however the place is moved, of a wall or the ground
_LEAST_SCORE = 0.6  # of a patch that may be the board
_SAME_PLACE = 0.25  # metres between patches that are one
_MARGIN = 0.3  # metres around the board that are looked at
_TOLERANCE = 0.03  # metres; returns nearer to the edge do not count
_FEWEST_ON = 25  # returns on the board
_MOST_RAYS = 500  # of a board while a rectangle is fitted; more take time and tell no more
_BLUR = 0.02  # metres of the edge while a rectangle is fitted
_FINE_BLUR = 0.006  # metres, where the board is known to be
_FURTHEST = 3.0  # standard deviations; returns farther on the wrong side pull no more


@dataclass(frozen=True)
class Patch:
    """A place where the board may be."""

    # (4, 4): a board looks the same after half a turn, so this is one of two poses
    T_lidar_board: Floats
    score: float  # share of rays at the outline that agree with it: on it inside, past it outside


def find_patches(sweep: BoardSweep, board: Board, distance: tuple[float, float]) -> list[Patch]:
    """Flat patches of about the size of the board that stand free, best first.

    Parameters
    ----------
    distance : (float, float)
        Least and greatest distance from the LiDAR [m].
    """
    wanted = (sweep.ranges > distance[0]) & (sweep.ranges < distance[1])
    if sweep.may_be_board is not None:
        wanted &= sweep.may_be_board
    points = sweep.points[wanted]
    points = points[_first_of_each(points, _THINNING)]
    if len(points) < _FEWEST:
        return []
    tree = cKDTree(points)
    seeds = _flat_seeds(points, tree, board)
    kept: list[Patch] = []
    for centre, normal in zip(*_free_standing(points, tree, *seeds, board), strict=True):
        if any(np.linalg.norm(centre - k.T_lidar_board[:3, 3]) < _SAME_PLACE for k in kept):
            continue
        patch = fit_patch(sweep, board, _facing(centre, normal))
        if patch is not None and patch.score >= _LEAST_SCORE:
            kept.append(patch)
    return _distinct(kept)


def fit_patch(
    sweep: BoardSweep, board: Board, T_lidar_board: Floats, near: float = NEAR_PLANE
) -> Patch | None:
    """Fit plane and rectangle near a pose; None where no board can be.

    Parameters
    ----------
    T_lidar_board : ndarray of float64, shape (4, 4)
    near : float
        How far the plane may be from the pose [m]. If more than that of a patch that was found
        already, the board is expected here, and fitted finely.
    """
    pose = T_lidar_board
    sweep = sweep.around(pose[:3, 3], board.diagonal + _MARGIN)
    for limit in (near, NEAR_PLANE):
        rays = rays_near(sweep, board, inverse(pose), _MARGIN, limit)
        inside = rays.on & (board.distance(rays.places) < 0.0)
        if inside.sum() < _FEWEST_ON:
            return None
        pose = _on_plane(rays.points[inside], pose)
        rays = rays_near(sweep, board, inverse(pose), _MARGIN)
        if not (rays.on & (board.distance(rays.places) < _MARGIN)).any():
            return None
        pose = _fit_rectangle(rays, board, pose)
    rays = rays_near(sweep, board, inverse(pose), _MARGIN)
    if near > NEAR_PLANE:
        pose = _fit_rectangle(rays, board, pose, _FINE_BLUR)
    return Patch(pose, outline_score(rays, board))


def outline_score(rays: BoardRays, board: Board) -> float:
    """Share of the rays on a board or through it that agree with its outline; 0 for too few."""
    distance = board.distance(rays.places)
    hits = int((rays.on & (distance < _TOLERANCE)).sum())
    wrong = int((rays.on & (distance > _TOLERANCE)).sum())
    wrong += int((~rays.on & (distance < -_TOLERANCE)).sum())
    inside = rays.places[rays.on & (distance < _TOLERANCE)]
    if hits < _FEWEST_ON:
        return 0.0
    # A strip of the board's length is no board: returns reach near all four edges.
    reach = np.minimum(inside.max(axis=0), -inside.min(axis=0)) / board.half_size
    covered = float(np.clip((reach.min() - 0.3) / 0.3, 0.0, 1.0))
    return covered * hits / (hits + wrong)


def _flat_seeds(points: Floats, tree: cKDTree, board: Board) -> tuple[Floats, Floats]:
    """Centres and normals of flat places, (n, 3) each."""
    seeds = points[_first_of_each(points, _SEED_SPACING)]
    near = tree.query_ball_point(seeds, 0.45 * min(board.width, board.height))
    counts = np.array([len(rows) for rows in near])
    near, seeds = near[counts >= _FEWEST], seeds[counts >= _FEWEST]
    counts = counts[counts >= _FEWEST]
    if not len(seeds):
        return np.zeros((0, 3)), np.zeros((0, 3))
    flat = np.concatenate([np.asarray(rows) for rows in near])
    group = np.repeat(np.arange(len(counts)), counts)
    weight = np.ones(len(flat))
    for _ in range(4):
        centres, normals, spread = _planes(points[flat], group, weight, len(counts))
        height = np.einsum("ij,ij->i", points[flat] - centres[group], normals[group])
        limit = np.maximum(NEAR_PLANE, 1.5 * spread[group, 0])
        weight = (np.abs(height) < limit).astype(np.float64)
    inliers = np.bincount(group, np.abs(height) < NEAR_PLANE, len(counts))
    good = (spread[:, 0] < _FLAT) & (spread[:, 1] > _LEAST_WIDTH) & (inliers > 0.5 * counts)
    return centres[good], normals[good]


def _planes(
    points: Floats, group: NDArray[np.int64], weight: Floats, groups: int
) -> tuple[Floats, Floats, Floats]:
    """Centre, normal and spread (g, 3) along the axes, smallest first, of groups of points."""
    total = np.maximum(np.bincount(group, weight, groups), 1.0)
    centres = np.stack(
        [np.bincount(group, weight * points[:, k], groups) / total for k in range(3)], axis=1
    )
    offset = points - centres[group]
    covariance = np.empty((groups, 3, 3))
    for a in range(3):
        for b in range(a, 3):
            value = np.bincount(group, weight * offset[:, a] * offset[:, b], groups) / total
            covariance[:, a, b] = covariance[:, b, a] = value
    values, vectors = np.linalg.eigh(covariance)
    return centres, vectors[:, :, 0], np.sqrt(np.maximum(values, 0.0))


def _free_standing(
    points: Floats, tree: cKDTree, centres: Floats, normals: Floats, board: Board
) -> tuple[Floats, Floats]:
    """Move each place to the middle of its patch; keep those with next to nothing around it."""
    kept_centres: list[Floats] = []
    kept_normals: list[Floats] = []
    half = 0.5 * board.diagonal
    for centre, normal in zip(centres, normals, strict=True):
        for _ in range(3):
            near = points[tree.query_ball_point(centre, 1.5 * half)]
            near = near[np.abs((near - centre) @ normal) < NEAR_PLANE]
            away = np.linalg.norm(near - centre, axis=1)
            inside = int((away < half).sum())
            if inside < _FEWEST or len(near) > (1 + _LARGE) * inside:
                break
            centre = near[away < half].mean(axis=0)
        away = np.linalg.norm(near - centre, axis=1)
        beyond, inside = (away > 1.1 * half).sum(), (away < 1.1 * half).sum()
        if inside < _FEWEST or beyond > _BEYOND * inside:
            continue
        known = any(
            np.linalg.norm(centre - c) < 0.5 * _SAME_PLACE and abs(normal @ n) > 0.97
            for c, n in zip(kept_centres, kept_normals, strict=True)
        )
        if not known:
            kept_centres.append(centre)
            kept_normals.append(normal)
    return np.array(kept_centres).reshape(-1, 3), np.array(kept_normals).reshape(-1, 3)


def _facing(centre: Floats, normal: Floats) -> Floats:
    """A board at a place, its front towards the LiDAR, its x axis level."""
    z = normal if normal @ centre > 0 else -normal
    x = np.cross(z, (0.0, 0.0, 1.0) if abs(z[2]) < 0.9 else (0.0, 1.0, 0.0))
    x /= np.linalg.norm(x)
    return rigid(np.stack([x, np.cross(z, x), z], axis=1), centre)


def _on_plane(points: Floats, pose: Floats) -> Floats:
    """Turn and shift a pose onto the plane of points, as little as can be."""
    centre = points.mean(axis=0)
    normal = np.linalg.svd(points - centre, full_matrices=False)[2][2]
    z = normal if normal @ pose[:3, 2] > 0 else -normal
    x = pose[:3, 0] - (pose[:3, 0] @ z) * z
    x /= np.linalg.norm(x)
    shift = ((pose[:3, 3] - centre) @ z) * z
    return rigid(np.stack([x, np.cross(z, x), z], axis=1), pose[:3, 3] - shift)


def _fit_rectangle(rays: BoardRays, board: Board, pose: Floats, blur: float = _BLUR) -> Floats:
    """Shift and turn a board in its plane, so that its outline parts the rays on it and past it."""
    few = slice(None, None, max(len(rays) // _MOST_RAYS, 1) if blur == _BLUR else 1)
    places, side = rays.places[few], np.where(rays.on[few], 1.0, -1.0)

    def misfit(move: Floats) -> Floats:
        wrong = side * board.distance(_moved(places, move)) / blur
        return np.clip(wrong, 0.0, _FURTHEST)

    starts = [np.zeros(3)]
    on = places[(side > 0) & (board.distance(places) < 0.5 * _MARGIN)]
    if len(on) >= _FEWEST_ON:
        (x, y), _, degrees = cv2.minAreaRect(on.astype(np.float32))
        starts += [np.array((x, y, np.radians(degrees + turn))) for turn in (0, 90)]
        starts += [np.array((*on.mean(axis=0), angle)) for angle in np.radians((0, 45, 90, 135))]
    # The sum of clipped misfits has many minima, so several starts are tried, the best two refined.
    costs = [float(misfit(start).sum()) for start in starts]
    found = [_descend(misfit, starts[k]) for k in np.argsort(costs)[:2]]
    x, y, angle = min(found, key=lambda move: float(misfit(move).sum()))
    angle = (angle + np.pi / 2) % np.pi - np.pi / 2  # half a turn changes nothing
    cos, sin = np.cos(angle), np.sin(angle)
    move = np.eye(4)
    move[:2, :2], move[:2, 3] = ((cos, -sin), (sin, cos)), (x, y)
    return np.asarray(pose @ move)


def _descend(misfit: Callable[[Floats], Floats], move: Floats) -> Floats:
    """A few steps of Levenberg and Marquardt over three numbers."""
    value, damping = misfit(move), 1e-3
    for _ in range(10):
        columns = [(misfit(move + step) - value) / 1e-3 for step in 1e-3 * np.eye(3)]
        J = np.stack(columns, axis=1)
        H = J.T @ J
        step = np.linalg.solve(H + damping * (np.diag(np.diag(H)) + np.eye(3)), -J.T @ value)
        tried = misfit(move + step)
        if tried @ tried < value @ value:
            move, value, damping = move + step, tried, 0.3 * damping
            if np.abs(step).max() < 1e-4:
                break
        else:
            damping *= 10.0
    return move


def _moved(places: Floats, move: Floats) -> Floats:
    """Places in the frame of a board that was moved by (x, y, angle)."""
    cos, sin = np.cos(move[2]), np.sin(move[2])
    return np.asarray((places - move[:2]) @ np.array(((cos, -sin), (sin, cos))))


def _distinct(patches: list[Patch]) -> list[Patch]:
    """The best patch at each place, best first."""
    kept: list[Patch] = []
    for patch in sorted(patches, key=lambda p: -p.score):
        place = patch.T_lidar_board[:3, 3]
        if all(np.linalg.norm(place - k.T_lidar_board[:3, 3]) > _SAME_PLACE for k in kept):
            kept.append(patch)
    return kept


def _first_of_each(points: Floats, size: float) -> NDArray[np.int64]:
    """Row of the first point in each cube of a grid."""
    cells = np.floor(points / size).astype(np.int64)
    keys = (cells[:, 0] * 73_856_093) ^ (cells[:, 1] * 19_349_663) ^ (cells[:, 2] * 83_492_791)
    return np.sort(np.unique(keys, return_index=True)[1])
