"""A made-up drive of five sweeps that tests write in every format and read back."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from docdepth.datasets.point_times import median_period
from docdepth.geometry.se3 import poses_from, rotation_exp

START = 1_700_000_000_000_000_000  # ns since 1970
SIZE = (64, 48)
K = np.array([[50.0, 0, 31.5], [0, 51.0, 24.25], [0, 0, 1]])
DISTORTION = np.array([-0.1, 0.02, 0.001, -0.002, 0.003])
EMPTY = 12  # rows at the end that are no returns: NaN, then zeros


def _extrinsic() -> np.ndarray:
    axes = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])  # camera x = -y, y = -z, z = x
    return poses_from([rotation_exp([0.01, -0.02, 0.005]) @ axes], [[0.05, -0.1, -0.2]])[0]


@dataclass(frozen=True)
class MadeUp:
    """Sweeps of a LiDAR of eight lasers in a room, at 10 Hz with a jitter, and a camera.

    Each sweep has 400 rows or a few more; the last ``EMPTY`` of them are no returns.
    """

    count: int = 5
    images_count: int = 4
    seed: int = 0

    @cached_property
    def times(self) -> np.ndarray:
        jitter = np.array([0, 137_001, -90_002, 55_003, 11_004, -7_005, 3_006])
        return START + 100_000_000 * np.arange(self.count) + jitter[: self.count]

    @cached_property
    def image_times(self) -> np.ndarray:
        return START + 100_000_000 * np.arange(self.images_count) + 31_000_123

    @property
    def period(self) -> int:
        found = median_period(self.times)
        assert found is not None
        return found

    @cached_property
    def poses(self) -> np.ndarray:
        turns = rotation_exp(np.linspace([0, 0, 0], [0.01, -0.02, 0.2], self.count))
        return poses_from(list(turns), np.linspace([0, 0, 0], [4, 0.5, 0.1], self.count))

    @property
    def T_camera_lidar(self) -> np.ndarray:
        return _extrinsic()

    def rows(self, k: int) -> np.ndarray:
        """Structured rows x y z intensity ring time of sweep k; time is a share of the period."""
        rng = np.random.default_rng((self.seed, k))
        n = 400 + k
        azimuth = -2 * np.pi * (np.arange(n) / n) + 0.001 * rng.normal(size=n)
        ring = (np.arange(n) % 8).astype("<u2")
        distance = rng.uniform(4, 9, n)
        floats = [(name, "<f4") for name in ("x", "y", "z", "intensity", "share")]
        rows = np.zeros(n, [*floats, ("ring", "<u2")])
        rows["x"], rows["y"] = distance * np.cos(azimuth), distance * np.sin(azimuth)
        rows["z"] = distance * np.tan(np.radians(3.0 * ring - 12))
        rows["intensity"] = rng.integers(0, 255, n)
        rows["ring"] = ring
        rows["share"] = (np.arange(n) + 0.5) / n - 0.5
        for axis in "xyz":
            rows[axis][-EMPTY : -EMPTY // 2] = np.nan
            rows[axis][-EMPTY // 2 :] = 0
        return rows

    def points(self, k: int) -> np.ndarray:
        rows = self.rows(k)
        return np.stack([rows[axis] for axis in "xyz"], axis=1)

    def usable(self, k: int) -> np.ndarray:
        kept = np.ones(len(self.rows(k)), bool)
        kept[-EMPTY:] = False
        return kept

    def seconds(self, k: int) -> np.ndarray:
        """Seconds of each point after the stamp, doubles."""
        return self.rows(k)["share"].astype("f8") * self.period * 1e-9

    def image(self, k: int) -> np.ndarray:
        rng = np.random.default_rng((self.seed, 100 + k))
        return rng.integers(0, 255, (SIZE[1], SIZE[0], 3), np.uint8)


DRIVE = MadeUp()
