"""What layouts of posed images share: photos, masks, and the static map in the photos' colours."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from docdepth.concurrency import Progress, null_progress
from docdepth.errors import RunError
from docdepth.geometry.se3 import inverse
from docdepth.io.atomic import write_atomically
from docdepth.pipeline.run_reader import Run, RunImage

PIXEL_CENTRE = 0.5
"""These programs have the centre of the first pixel at (0.5, 0.5), docdepth has it at (0, 0)."""

_SAME = 0.02  # of depth: how far a point may be from the map where a pixel shows it
_GREY = 128  # of points that no photo shows


class Photo(NamedTuple):
    """A photo of a recorded camera, as it is written.

    Attributes
    ----------
    image : RunImage
    name : str
        ``CAMERA/NAME``.
    rgb : ndarray of uint8, shape (h, w, 3)
        Without lens distortion.
    depth : ndarray of float32, shape (h, w)
        Metres, NaN without depth.
    still : ndarray of bool, shape (h, w)
        Where it shows the world, and nothing that moves.
    """

    image: RunImage
    name: str
    rgb: NDArray[np.uint8]
    depth: NDArray[np.float32]
    still: NDArray[np.bool_]


def photos(run: Run, progress: Progress | None) -> Iterator[Photo]:
    """The photos of all recorded cameras of a run, read one by one.

    Raises
    ------
    RunError
        There is none.
    """
    recorded = [n for n, entry in run.folder.cameras.items() if entry.virtual is None]
    images = [image for name in recorded for image in run.cameras[name]]
    count = 0
    for done, image in enumerate(images, 1):
        rgb, mask = image.image, image.of.stream.camera.mask
        if rgb is not None:
            still = ~image.moving if mask is None else ~image.moving & mask
            yield Photo(image, f"{image.of.name}/{image.name}", rgb, image.depth, still)
            count += 1
        (progress or null_progress)("convert", done, len(images))
    if not count:
        raise RunError(f"{run.path} has no photos with depth maps")


def write_image(path: Path, pixels: NDArray[np.uint8]) -> None:
    """Write RGB (h, w, 3) or grey (h, w) as PNG."""
    stored = pixels[..., ::-1] if pixels.ndim == 3 else pixels
    write_bytes(path, cv2.imencode(".png", np.ascontiguousarray(stored))[1].tobytes())


def write_bytes(path: Path, content: bytes) -> None:
    """Write a whole file."""
    write_atomically(path, lambda stream: stream.write(content))


class Colors:
    """Colours of points in the world: the mean over the photos whose depth map shows them.

    Parameters
    ----------
    points : ndarray of float64, shape (n, 3)
        Metres.
    """

    def __init__(self, points: NDArray[np.float64]) -> None:
        self.points = points
        self._sum = np.zeros((len(points), 3))
        self._count = np.zeros(len(points))

    def add(self, photo: Photo) -> None:
        """Look at the points in one more photo."""
        T = inverse(photo.image.T_world_camera)
        x, y, z = (self.points @ T[:3, :3].T + T[:3, 3]).T
        ahead = np.flatnonzero(z > 0.1)
        K = photo.image.K
        u = np.rint(K[0, 0] * x[ahead] / z[ahead] + K[0, 2])
        v = np.rint(K[1, 1] * y[ahead] / z[ahead] + K[1, 2])
        height, width = photo.depth.shape
        inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
        rows, u, v = ahead[inside], u[inside].astype(int), v[inside].astype(int)
        shown = (np.abs(photo.depth[v, u] - z[rows]) < _SAME * z[rows]) & photo.still[v, u]
        self._sum[rows[shown]] += photo.rgb[v[shown], u[shown]]
        self._count[rows[shown]] += 1

    def rgb(self) -> NDArray[np.uint8]:
        """The colours (n, 3); grey where no photo shows the point."""
        known = self._count > 0
        found = np.full((len(self.points), 3), _GREY, np.uint8)
        found[known] = np.rint(self._sum[known] / self._count[known, None])
        return found
