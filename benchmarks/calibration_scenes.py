"""Simulated calibration scenes: a board in a room or a street, seen by a LiDAR and a camera.

The board stands on a tripod or is held by a person, wholly in view of both sensors. The room has
walls and boxes, the street houses and parked cars. The LiDAR models are those of
``docdepth synth``. Nothing here uses the code that finds boards.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from docdepth.calibration.board import Board
from docdepth.calibration.lens import Lens
from docdepth.calibration.sweeps import BoardSweep, board_sweep
from docdepth.datasets import kitti_lidar
from docdepth.geometry.se3 import inverse, rotation_exp
from docdepth.synthetic import Mesh, Paint, Sensor, box, pose_of
from docdepth.synthetic.casting import Rays, World
from docdepth.synthetic.houses import wall
from docdepth.synthetic.mesh import ball, merged, quads, tube
from docdepth.synthetic.road_users import car, pedestrian

Floats = NDArray[np.float64]
Rng = np.random.Generator

A0 = Board(7, 10, 0.1, 0.841, 1.189)
CAMERA = Lens(
    "pinhole",
    np.array([(1000.0, 0.0, 955.0), (0.0, 1002.0, 603.0), (0.0, 0.0, 1.0)]),
    np.array((-0.12, 0.06, 0.0005, -0.0003, 0.0)),
    1920,
    1200,
)

_PLAIN = Paint(50, (0.7, 0.7, 0.68), 0.35)
_FLOOR = Paint(40, (0.5, 0.5, 0.5), 0.25)
_WOOD = Paint(52, (0.5, 0.35, 0.2), 0.3)
_BOARD = Paint(99, (0.9, 0.9, 0.9), 0.5)
_HEIGHT = 1.73  # of the LiDAR above the ground
_SPACING = np.radians(0.7)  # of rays, at most, in the field of view
_FRONT = 0.004  # metres; half the thickness of the board


@dataclass(frozen=True)
class Shot:
    """One still board, as LiDAR and camera see it.

    Attributes
    ----------
    sweep : BoardSweep
    corners : ndarray of float64, shape (n, 2)
        Pixels with noise.
    T_lidar_board : ndarray of float64, shape (4, 4)
        The truth.
    """

    sweep: BoardSweep
    corners: Floats
    T_lidar_board: Floats


def random_extrinsic(rng: Rng) -> Floats:
    """``T_camera_lidar`` of a camera beside the LiDAR that looks ahead."""
    axes = np.array([(0.0, -1.0, 0.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0)])
    T = np.eye(4)
    T[:3, :3] = rotation_exp(np.radians(rng.uniform(-5, 5, 3))) @ axes
    T[:3, 3] = -T[:3, :3] @ rng.uniform((-0.1, -0.4, -0.4), (0.4, 0.4, 0.1))
    return T


def random_pose(
    board: Board,
    lens: Lens,
    sensor: Sensor,
    T_camera_lidar: Floats,
    rng: Rng,
    tilt_deg: float = 40.0,
) -> Floats:
    """``T_lidar_board``, 2.5 to 6 m away and wholly in view of both, its front towards them."""
    directions = cKDTree(sensor.pattern(0).directions)
    for _ in range(10_000):
        away, azimuth = rng.uniform(2.5, 6.0), np.radians(rng.uniform(-60, 60))
        z = rng.uniform(-_HEIGHT + 0.5, 0.6)
        centre = np.array((away * np.cos(azimuth), away * np.sin(azimuth), z))
        towards = centre / np.linalg.norm(centre)
        x = np.cross(towards, (0.0, 0.0, 1.0))
        x /= np.linalg.norm(x)
        level = np.stack([x, np.cross(towards, x), towards], axis=1)
        lean = rng.uniform(0.15, 1.0) * tilt_deg
        heading = rng.uniform(0, 2 * np.pi)
        tilt = rotation_exp(np.radians(lean) * np.array((np.cos(heading), np.sin(heading), 0)))
        turn = rotation_exp((0, 0, np.radians(rng.uniform(-45, 45)) + np.pi / 2 * rng.integers(2)))
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = level @ tilt @ turn, centre
        edge = board.outline @ T[:3, :3].T + T[:3, 3]
        rays = edge / np.linalg.norm(edge, axis=1, keepdims=True)
        seen = lens.project(edge @ T_camera_lidar[:3, :3].T + T_camera_lidar[:3, 3])
        if (
            edge[:, 2].min() > -_HEIGHT + 0.1
            and (directions.query(rays)[0] < _SPACING).all()
            and not np.isnan(seen).any()
            and lens.in_image(seen).all()
        ):
            return T
    raise ValueError(f"no place for the board in view of {sensor.name}")


def shoot(
    board: Board,
    lens: Lens,
    sensor: Sensor,
    T_camera_lidar: Floats,
    T_lidar_board: Floats,
    rng: Rng,
    pixels: float = 0.3,
    surroundings: Mesh | None = None,
) -> Shot:
    """Sweep and corners of one board; ``pixels`` is the noise of the corners.

    ``surroundings`` replaces the random room or street, in the LiDAR frame.
    """
    if surroundings is None:
        surroundings = merged(
            [_room(rng) if rng.random() < 0.5 else _street(rng), _holder(board, T_lidar_board, rng)]
        )
    slab = box((board.width, board.height, 2 * _FRONT), (0, 0, _FRONT), _BOARD).moved(T_lidar_board)
    points = _sweep(sensor, merged([surroundings, slab]), rng)
    T = T_camera_lidar @ T_lidar_board
    corners = lens.project(board.corners @ T[:3, :3].T + T[:3, 3])
    if rng.random() < 0.5:
        corners = corners[::-1]  # a detector begins at either end
    noisy = corners + pixels * rng.normal(size=corners.shape)
    rig = kitti_lidar.sensor_rig(points) if kitti_lidar.is_kitti_lidar([points]) else None
    return Shot(board_sweep(points, rig), noisy, T_lidar_board)


def picture(board: Board, lens: Lens, T_camera_board: Floats, rng: Rng) -> NDArray[np.uint8]:
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


def floor() -> Mesh:
    """The ground below the LiDAR."""
    return quads(
        np.array([(-60, -60, 0), (60, -60, 0), (60, 60, 0), (-60, 60, 0)])[None], _FLOOR
    ).moved(pose_of(0, 0, -_HEIGHT))


def _room(rng: Rng) -> Mesh:
    """A hall with boxes in it, the LiDAR in its middle."""
    ahead, behind, side, height = rng.uniform((7, 3, 4, 3), (12, 6, 8, 5))
    parts = [floor()]
    middle = (0.5 * (ahead - behind), 0.0, 0.5 * height - _HEIGHT)
    hall = box((ahead + behind, 2 * side, height), middle, _PLAIN)
    parts.append(hall)
    for _ in range(10):
        size = rng.uniform((0.3, 0.3, 0.4), (1.2, 1.2, 1.8))
        x, y = rng.uniform(-behind, ahead), rng.uniform(1.5, side) * rng.choice((-1, 1))
        crate = box(size, (0, 0, 0.5 * size[2]), _WOOD)
        parts.append(crate.moved(pose_of(x, y, -_HEIGHT, rng.uniform(0, np.pi))))
    return merged(parts)


def _street(rng: Rng) -> Mesh:
    """A street with houses and parked cars on both sides."""
    parts = [floor()]
    for side in (-1, 1):
        away = rng.uniform(6, 12)
        front = wall(60.0, rng.uniform(6, 14), _PLAIN)
        parts.append(
            front.moved(pose_of(-20 * side, side * away, -_HEIGHT, 0 if side > 0 else np.pi))
        )
        for x in np.arange(-8, 25, 6.0):
            if rng.random() < 0.6:
                place = pose_of(x + rng.uniform(-0.5, 0.5), side * (away - 2.2), -_HEIGHT, 0)
                parts.append(car(rng).moved(place))
    return merged(parts)


def _holder(board: Board, T_lidar_board: Floats, rng: Rng) -> Mesh:
    """A tripod, or a person behind the board whose hands grip its edges."""
    centre, normal = T_lidar_board[:3, 3], T_lidar_board[:3, 2]
    ground = np.array((0.0, 0.0, -_HEIGHT))
    if rng.random() < 0.4:
        back = centre + 0.05 * normal
        foot = back * (1, 1, 0) + ground
        legs = [tube([back, foot + (0, 0, 0.6)], 0.02, _WOOD, 6)]
        for angle in rng.uniform(0, 2) + np.arange(3) * 2.1:
            spread = 0.4 * np.array((np.cos(angle), np.sin(angle), 0))
            legs.append(tube([foot + (0, 0, 0.7), foot + spread], 0.015, _WOOD, 6))
        return merged(legs)
    lateral = rng.uniform(-0.4, 0.4)
    spot = centre + rng.uniform(0.35, 0.6) * normal + lateral * T_lidar_board[:3, 0]
    yaw = np.arctan2(-centre[1], -centre[0])
    body = [part.mesh for part in pedestrian(rng)]
    stand = pose_of(spot[0], spot[1], -_HEIGHT, yaw)
    parts = [mesh.moved(stand) for mesh in body]
    for side in (-1, 1):
        grip = np.array((side * 0.5 * board.width, rng.uniform(-0.3, 0.3), 0.0, 1.0))
        parts.append(ball((T_lidar_board @ grip)[:3], (0.05, 0.05, 0.05), _WOOD, 8))
        shoulder = spot * (1, 1, 0) + ground + (0, 0, 1.4) + 0.2 * side * T_lidar_board[:3, 0]
        parts.append(tube([shoulder, (T_lidar_board @ grip)[:3]], 0.04, _WOOD, 6))
    return merged(parts)


def _sweep(sensor: Sensor, scene: Mesh, rng: Rng) -> NDArray[np.float32]:
    """Returns (N, 3) of a still LiDAR, LiDAR frame [m]."""
    pattern = sensor.pattern(int(rng.integers(1000)))
    origins = pattern.ray_origins
    if origins is None:
        origins = np.zeros_like(pattern.directions)
    world = World(scene, [], (0.0, 1.0))
    which = np.zeros(len(origins), np.int64)
    hits = world.cast(Rays(origins, pattern.directions, np.zeros(1), which), sensor.max_range)
    kept = sensor.returned(hits.range, world.reflectivity[hits.face], hits.cosine, rng)
    measured = hits.range[kept] + sensor.noise * rng.normal(size=int(kept.sum()))
    points = origins[kept] + measured[:, None] * pattern.directions[kept]
    return points.astype(np.float32)
