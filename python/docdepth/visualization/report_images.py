"""The images of a report: some of each camera, with all that is known of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.base import CameraStream
from docdepth.errors import DamagedFileError
from docdepth.geometry.camera import Camera, below_horizon
from docdepth.geometry.se3 import inverse
from docdepth.geometry.track import Track
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.depth import described_maps, maps_in, read_depth
from docdepth.io.npy import ArrayError, read_arrays
from docdepth.io.run_folder import RunFolder
from docdepth.visualization.image_views import draw_tracks, view_of_layer, view_of_points
from docdepth.visualization.page import embedded
from docdepth.visualization.pictures import Picture, colorize

IMAGES = 12
"""Of a camera, spaced evenly over the drive, fewer where there are many cameras."""

_PICTURES = 72  # on a page
_BYTES = 8_500_000  # of all pictures of a page, before they become text
_LARGEST = 500_000  # pixels of a picture
_LARGEST_BYTES = 150_000
_LAYERS = ("confidence", "seen", "instance")  # shown where the run has them


class Moment(NamedTuple):
    """An image and its pictures.

    Attributes
    ----------
    name : str
        Of the image.
    time : int
        [ns]
    views : dict of str to str
        ``image``, ``depth``, ``class`` and layers; each a link that holds the picture.
    """

    name: str
    time: int
    views: dict[str, str]


class CameraPage(NamedTuple):
    """What the report says of a camera.

    Attributes
    ----------
    name : str
    moments : tuple of Moment
    density : list of (int, float)
        Time [ns] and share of pixels with depth of each map.
    below_horizon : float
        The same share of the pixels below the horizon, mean over the moments.
    """

    name: str
    moments: tuple[Moment, ...]
    density: list[tuple[int, float]]
    below_horizon: float


def camera_pages(
    run: RunFolder, streams: Mapping[str, CameraStream], tracks: Sequence[Track]
) -> list[CameraPage]:
    """The cameras of a run, each with a few of its images.

    Parameters
    ----------
    run : RunFolder
        With depth maps.
    streams : mapping of str to CameraStream
        Cameras whose images can be read.
    tracks : sequence of Track

    Raises
    ------
    DatasetError, RunError
        A map, an image or a frame is missing or damaged.
    """
    trajectory = run.trajectory()
    count, most = budget(len(run.cameras))
    pages = []
    for name, entry in run.cameras.items():
        depths = run.path / "depth" / entry.folder
        maps, files = described_maps(depths), maps_in(depths)
        names = sorted(maps.keys() & files.keys(), key=lambda image: maps[image][0])
        reader = _Reader(run, entry.folder, streams.get(name), trajectory, tracks)
        even = np.linspace(0, len(names) - 1, min(count, len(names)))
        moments, shares = [], []
        for k in np.unique(np.rint(even).astype(int)):
            image, time = names[k], maps[names[k]][0]
            depth = read_depth(files[image])
            views = {v: embedded(_reduced(p), most) for v, p in reader.views(image, time, depth)}
            moments.append(Moment(image, time, views))
            if reader.below_horizon.any():
                shares.append(np.isfinite(depth[reader.below_horizon]).mean())
        below = float(np.mean(shares or [np.nan]))
        pages.append(CameraPage(name, tuple(moments), [maps[image] for image in names], below))
    return pages


def budget(cameras: int) -> tuple[int, int]:
    """Images of each camera, and bytes of each picture, on a page of so many cameras."""
    views = (3 + len(_LAYERS)) * max(cameras, 1)
    count = int(np.clip(_PICTURES // views, 1, IMAGES))
    return count, min(_BYTES // (views * count), _LARGEST_BYTES)


@dataclass(frozen=True)
class _Reader:
    """Reads what is known of the images of a camera."""

    run: RunFolder
    folder: str
    stream: CameraStream | None
    trajectory: Trajectory
    tracks: Sequence[Track]

    @cached_property
    def _calibration(self) -> tuple[Camera, NDArray[np.float64]]:
        return self.run.calibration(self.folder)[:2]

    @cached_property
    def below_horizon(self) -> NDArray[np.bool_]:
        """Which pixels lie below the horizon; shape (h, w)."""
        return below_horizon(*self._calibration)

    def views(
        self, name: str, time: int, depth: NDArray[np.float32]
    ) -> Iterator[tuple[str, Picture]]:
        """The pictures of an image, by what they show."""
        camera, T_camera_lidar = self._calibration
        image = self._image(name)
        if image is not None:
            yield "image", image
        yield "depth", colorize(depth, bar=False)
        layers = _layers(self.run.path / "layers" / self.folder / f"{name}.npz")
        T_camera_world = T_camera_lidar @ inverse(self.trajectory.interpolate([time])[0])
        if "class" in layers:
            classes = view_of_layer("class", layers["class"], image)
        else:
            classes = self._sweep(camera, T_camera_world, time, image)
        draw_tracks(classes, self.tracks, time, camera, T_camera_world)
        yield "class", classes
        yield from ((n, view_of_layer(n, layers[n], image)) for n in _LAYERS if n in layers)

    def _image(self, name: str) -> Picture | None:
        if self.stream is None or name not in self.stream.names:
            return None
        return self.stream.rectified_image(self.stream.names.index(name))

    def _sweep(
        self,
        camera: Camera,
        T_camera_world: NDArray[np.float64],
        time: int,
        image: Picture | None,
    ) -> Picture:
        """Classes of the sweep nearest in time."""
        k = self.trajectory.nearest(time)
        record, classid = self.run.classified_frame(k)
        T = T_camera_world @ self.trajectory.poses[k]
        return view_of_points(record.points @ T[:3, :3].T + T[:3, 3], classid, camera, image)


def _layers(path: Path) -> dict[str, NDArray[Any]]:
    try:
        stored = read_arrays(path)
        return {name: stored[name] for name in ("class", *_LAYERS) if name in stored}
    except FileNotFoundError:
        return {}
    except (OSError, ArrayError) as error:
        raise DamagedFileError(path, str(error)) from None


def _reduced(picture: Picture) -> Picture:
    scale = (_LARGEST / (picture.shape[0] * picture.shape[1])) ** 0.5
    if scale >= 1:
        return picture
    return np.asarray(cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))
