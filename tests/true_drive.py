"""A short drive through a street of boxes, with its truth, in the layout of SemanticKITTI."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from docdepth.geometry.se3 import inverse, se3_exp
from docdepth.geometry.track import Track
from docdepth.io.tracks import write_tracks
from exact_drive import Street, nearest_box
from lidar_rays import scan_rays
from motion import moving_track, straight
from small_drive import HEIGHT, TR, WIDTH, write_sweep

SHUTTER = 0.37
"""Time of an image as a share of the time between two sweeps."""

ROAD, BUILDING, PARKED, MOVING = 40, 50, 10, 252
_MOVERS = np.array([(14.0, -1.2, 9.0), (24.0, 1.6, -8.0), (-12.0, 1.6, -8.0)])
"""x and y of cars at the first sweep [m], and their speed along x [m/s]."""
_CAR = np.array([4.2, 1.8, 1.5])
_PERIOD = 0.1


class TrueStreet(Street):
    """The street, where cars drive: what a ray hits, and how far away."""

    def __init__(self) -> None:
        super().__init__()
        cars = np.flatnonzero(self.high[:, 2] == 1.5)
        self.classes = np.full(len(self.low) + len(_MOVERS), BUILDING, np.uint32)
        self.classes[0] = ROAD
        self.classes[cars] = PARKED | np.arange(100, 100 + len(cars)) << 16
        self.classes[len(self.low) :] = MOVING | np.arange(1, 1 + len(_MOVERS)) << 16

    def cast(
        self, T: np.ndarray, rays: np.ndarray, moment: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Distance along rays of a frame (NaN: none), class and instance, and speed [m/s]."""
        low = np.column_stack([_MOVERS[:, :2], np.zeros(len(_MOVERS))])
        low[:, 0] += _MOVERS[:, 2] * _PERIOD * moment
        low[:, :2] -= _CAR[:2] / 2
        boxes = np.vstack([self.low, low]), np.vstack([self.high, low + _CAR])
        best, what = nearest_box(T[:3, 3], rays @ T[:3, :3].T, *boxes)
        speeds = np.zeros(len(self.classes))
        speeds[-len(_MOVERS) :] = np.abs(_MOVERS[:, 2])
        classes = np.where(np.isfinite(best), self.classes[what], 0).astype(np.uint32)
        return np.where(np.isfinite(best), best, np.nan), classes, speeds[what]


def write_true_drive(folder: Path, sweeps: int = 5) -> Path:
    """Write the drive with one camera, whose images are taken between the sweeps."""
    for name in ("labels", "speeds", "image_2", "depth_2", "class_2"):
        (folder / name).mkdir(parents=True)
    street, Tr = TrueStreet(), np.vstack([np.reshape(TR.split(), (3, 4)), [0, 0, 0, 1]])
    Tr, start, motion = Tr.astype(float), np.eye(4), np.array([0, 0, 0.01, 1.0, 0, 0])
    start[:3, 3] = 0, -1, 1.73

    def pose(moment: float) -> np.ndarray:
        return start @ se3_exp(moment * motion[:3], moment * motion[3:])

    poses = inverse(start) @ np.stack([pose(k) for k in range(sweeps)])
    rows = (Tr @ poses @ inverse(Tr))[:, :3].reshape(sweeps, 12)
    _write_table(folder / "poses.txt", rows)
    _write_table(folder / "times.txt", _PERIOD * np.arange(sweeps)[:, None])
    cameras = [f"P{n}: 60 0 48 {-30 * (n - 2)} 0 60 20 0 0 0 1 0" for n in range(4)]
    (folder / "calib.txt").write_text("\n".join([*cameras, f"Tr: {TR}\n"]))
    columns = np.linspace(np.pi, -np.pi, 540, endpoint=False)
    beams = scan_rays(np.radians(np.linspace(-20, 6, 26)), columns).reshape(-1, 3)
    for k in range(sweeps):
        distance, classes, speed = street.cast(pose(k), beams, k)
        seen = np.isfinite(distance) & (distance < 80)
        write_sweep(folder, k, beams[seen] * distance[seen, None])
        classes[seen].tofile(folder / "labels" / f"{k:06d}.label")
        np.save(folder / "speeds" / f"{k:06d}.npy", speed[seen].astype(np.float16))
    moments = np.arange(sweeps - 1) + SHUTTER
    _write_table(folder / "image_2" / "times.txt", _PERIOD * moments[:, None])
    v, u = np.mgrid[:HEIGHT, :WIDTH].reshape(2, -1)
    rays = np.stack([(u - 48) / 60, (v - 20) / 60, np.ones(u.shape)], axis=1)
    for k, moment in enumerate(moments):
        depth, classes, _ = street.cast(pose(moment) @ inverse(Tr), rays, moment)
        shape = HEIGHT, WIDTH
        np.save(folder / "depth_2" / f"{k:06d}.npy", depth.astype(np.float32).reshape(shape))
        np.save(folder / "class_2" / f"{k:06d}.npy", classes.reshape(shape))
        grey = np.nan_to_num(255 - 4 * depth).clip(0, 255).reshape(shape).astype(np.uint8)
        cv2.imwrite(str(folder / "image_2" / f"{k:06d}.png"), cv2.merge([grey] * 3))
    write_tracks(
        folder / "tracks.csv",
        [_track(k, sweeps, start) for k in range(len(_MOVERS))],
        _times(sweeps),
    )
    return folder


def _times(sweeps: int) -> np.ndarray:
    return round(_PERIOD * 1e9) * np.arange(sweeps, dtype=np.int64)


def _track(k: int, sweeps: int, start: np.ndarray) -> Track:
    """The exact track of a car in the frame of the first sweep."""
    x, y, speed = _MOVERS[k]
    place = (x, y, 0) - start[:3, 3]
    return moving_track(straight(sweeps), place, (speed, 0, 0), _CAR, of=k + 1)


def _write_table(path: Path, rows: np.ndarray) -> None:
    path.write_text("".join(" ".join(map(repr, row)) + "\n" for row in rows.tolist()))
