"""A drive of any length along an endless street, which is made while it is read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from docdepth.datasets.base import CameraStream, LidarStream, Sweep
from docdepth.datasets.format import Format
from docdepth.errors import DatasetError
from docdepth.geometry.camera import Camera
from docdepth.synthetic.casting import World
from docdepth.synthetic.drive import Drive
from docdepth.synthetic.mesh import merged
from docdepth.synthetic.sensors import Pattern, Sensor, sensor, sensors
from docdepth.synthetic.street import Scene
from scenes.endless_street import PIECE, SPEED, EndlessStreet, ego_path, passes

WAY_BACK = 40
"""Tiles after which the street of a drive comes back to where it began: 24 km."""

_WORLDS = 2  # that are kept: threads read sweeps at both sides of a border
_MARGIN = 30.0  # metres that are made beyond the range of the sensor: bends shorten the way
_KEPT_PIECES, _KEPT_PASSERS = 8, 32
_MOVING = 40.0  # seconds around a moment in which all passers move


class EndlessDrive(Drive):
    """A drive of any length. Each sweep depends on the seed and its number alone.

    Parameters
    ----------
    sensor : Sensor
    frames : int
    seed : int
    skew : bool
        Leave the points as measured while the ego moved.
    tiles : int
        Tiles of 600 m after which the ego comes back and drives along the same street again, with
        other traffic.
    turn_deg : float, optional
        Of a tile [deg]; 360 over ``tiles`` by default. With another turn the ego comes to a street
        that is built like the first and lies beside it.
    """

    def __init__(
        self,
        sensor: Sensor,
        frames: int,
        seed: int = 0,
        skew: bool = True,
        tiles: int = WAY_BACK,
        turn_deg: float | None = None,
    ) -> None:
        self.street = EndlessStreet(seed, tiles, turn_deg)
        nothing = merged([self.street.road.ground(1.0, (0.0, 1.0))])
        street = Scene("endless", nothing, [], ego_path(self.street.road), np.inf)
        super().__init__(street, sensor, frames, seed, skew)
        self._world = lru_cache(maxsize=_WORLDS)(self._make_world)
        self._static = lru_cache(maxsize=_KEPT_PIECES)(self.street.static)
        self._passers = lru_cache(maxsize=_KEPT_PASSERS)(self.street.passers)
        self._making = Lock()

    def world_at(self, second: float) -> World:
        """The pieces within reach, and those who may be seen while the ego is on its piece."""
        with self._making:
            return self._world(int(self.scene.ego.distance(second) // PIECE))

    def _make_world(self, piece: int) -> World:
        reach = self.sensor.max_range + _MARGIN
        first, last = (int((PIECE * piece + off) // PIECE) for off in (-reach, PIECE + reach))
        static = merged([self._static(k) for k in range(first, last + 1)])
        # The ego's speed varies, so it comes a little before or after.
        begin, end = PIECE * piece / SPEED - 1.0, PIECE * (piece + 1) / SPEED + 1.0
        found = [
            passer
            for k in passes(begin, end)
            for passer in self._passers(k)
            if passer.begin <= end and passer.end >= begin
        ]
        span = (begin - _MOVING, end + _MOVING)
        return World(static, [p.actor for p in found], span, [p.instance for p in found])


class EndlessRecording:
    """An endless drive as a recording, described by a file ``NAME.endless.yaml``.

    Its entries: ``sensor`` and ``frames``; perhaps ``seed`` (0), ``tiles``, ``turn_deg``,
    ``columns`` of a sensor that spins (all), ``image_every`` so many sweeps (1) and ``image_scale``
    (1: as of KITTI).

    Parameters
    ----------
    path : Path

    Raises
    ------
    DatasetError
        The file is none.
    """

    name = "endless"

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        about = _read(self.path)
        lidar = sensor(about["sensor"])
        if about["columns"]:
            lidar = replace(lidar, pattern=_thinned(lidar.pattern(0), about["columns"]))
        street = {name: about[name] for name in ("tiles", "turn_deg")}
        self.drive = EndlessDrive(lidar, about["frames"], about["seed"], **street)
        self.times, self.poses = self.drive.times, self.drive.poses
        every = about["image_every"]
        taken = np.arange(every // 2, len(self) - 1, every)
        rig, scale = self.drive.rig, about["image_scale"]
        K, size = rig.camera.K.copy(), (rig.camera.width, rig.camera.height)
        K[:2] *= scale
        stream = CameraStream(
            "image_2",
            Camera(K, *(round(scale * length) for length in size)),
            rig.T_camera_lidar,
            self.drive.camera_times[taken],
            [f"{k:06d}" for k in taken.tolist()],
        )
        self.cameras = {stream.name: stream}

    def __len__(self) -> int:
        return len(self.times)

    def __reduce__(self) -> tuple[type[EndlessRecording], tuple[Path]]:
        return EndlessRecording, (self.path,)

    @property
    def lidars(self) -> dict[str, LidarStream]:
        """The one LiDAR."""
        name = self.drive.sensor.name
        return {name: LidarStream(name, self.times, [f"{k:06d}" for k in range(len(self))])}

    def sweep(self, index: int) -> Sweep:
        """Make a sweep."""
        true = self.drive.sweep(index)
        return Sweep(
            true.points,
            f"{index:06d}",
            int(self.times[index]),
            true.intensity,
            true.relative_time,
            motion_compensated=not self.drive.skew,
            ring=true.ring.astype(np.uint16),
        )

    def sweep_files(self, index: int) -> list[Path]:
        """The description."""
        return [self.path]

    def labels(self, index: int) -> NDArray[np.uint32]:
        """Exact labels; makes the sweep once more."""
        return self.drive.sweep(index).labels


FORMAT = Format(
    "endless",
    "a file NAME.endless.yaml",
    lambda path: path.name.endswith(".endless.yaml") and path.is_file(),
    lambda path, image_size: EndlessRecording(path),
)
"""For an entry point of a package that wants ``docdepth run`` to read such files."""

_DEFAULTS = {
    "seed": 0,
    "tiles": WAY_BACK,
    "turn_deg": None,
    "columns": 0,
    "image_every": 1,
    "image_scale": 1.0,
}


def _read(path: Path) -> dict[str, Any]:
    try:
        about = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeError, yaml.YAMLError) as error:
        raise DatasetError(f"{path} cannot be read: {error}") from None
    if not isinstance(about, dict) or set(about) - {"sensor", "frames", *_DEFAULTS}:
        raise DatasetError(f"{path}: its entries are sensor, frames, {', '.join(_DEFAULTS)}")
    if not isinstance(about.get("frames"), int) or about.get("sensor") not in sensors():
        raise DatasetError(f"{path}: give frames, and a sensor among {', '.join(sensors())}")
    return _DEFAULTS | about


def _thinned(whole: Pattern, columns: int) -> Callable[[int], Pattern]:
    """Every n-th column of a sensor that spins."""
    step = max(len(whole.relative_times) // columns, 1)
    rows = np.flatnonzero(whole.which % step == 0)
    origins = None if whole.ray_origins is None else whole.ray_origins[rows]
    directions, which, rings = whole.directions[rows], whole.which[rows], whole.rings[rows]
    part = Pattern(directions, whole.relative_times, which, rings, origins)
    return lambda index: part
