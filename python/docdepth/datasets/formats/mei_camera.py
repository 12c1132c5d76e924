"""Fisheyes of Mei's model, which see more than half a sphere: a pinhole camera of their middle.

C. Mei and P. Rives, "Single View Point Omnidirectional Camera Calibration from Planar Grids", 2007.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.files import StoredImage, read_image, read_lines
from docdepth.errors import CalibrationError, DatasetError
from docdepth.geometry.camera import Camera

_SECTIONS = {
    "mirror_parameters": ("xi",),
    "distortion_parameters": ("k1", "k2", "p1", "p2"),
    "projection_parameters": ("gamma1", "gamma2", "u0", "v0"),
}


@dataclass(frozen=True)
class MeiCamera:
    """A fisheye, and the pinhole camera to which its images are rectified."""

    xi: float  # of the mirror
    k1: float  # radial and tangential distortion
    k2: float
    p1: float
    p2: float
    gamma1: float  # focal lengths and principal point, pixels
    gamma2: float
    u0: float
    v0: float
    width: int  # of the images, pixels
    height: int

    @property
    def pinhole(self) -> Camera:
        """Same size and principal point, and as large in the middle as the fisheye."""
        f, g = self.gamma1 / (1 + self.xi), self.gamma2 / (1 + self.xi)
        K = np.array([[f, 0, self.u0], [0, g, self.v0], [0, 0, 1]])
        return Camera(K, self.width, self.height)

    def project(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Pixels (..., 2) of points (..., 3) in the frame of the camera."""
        x, y, z = np.moveaxis(points / np.linalg.norm(points, axis=-1, keepdims=True), -1, 0)
        x, y = x / (z + self.xi), y / (z + self.xi)
        r2, xy = x * x + y * y, x * y
        radial = 1 + self.k1 * r2 + self.k2 * r2 * r2
        u = x * radial + 2 * self.p1 * xy + self.p2 * (r2 + 2 * x * x)
        v = y * radial + 2 * self.p2 * xy + self.p1 * (r2 + 2 * y * y)
        return np.stack([self.gamma1 * u + self.u0, self.gamma2 * v + self.v0], axis=-1)

    def rectified(self, file: Path) -> StoredImage:
        """An image of the fisheye as the pinhole camera sees it."""
        return StoredImage(file, "rectified", partial(read_rectified, self, file))


def read_rectified(camera: MeiCamera, file: Path) -> NDArray[np.uint8]:
    """Read an image of a fisheye and rectify it."""
    image = read_image(file)
    if image.shape[:2] != (camera.height, camera.width):
        raise DatasetError(
            f"{file} is {image.shape[1]}x{image.shape[0]} pixels, its calibration is of "
            f"{camera.width}x{camera.height}; replace or remove it"
        )
    return np.asarray(cv2.remap(image, _places(camera), None, cv2.INTER_LINEAR), np.uint8)


def read_mei(file: Path, remedy: str) -> MeiCamera:
    """Read a calibration that camodocal wrote."""
    try:
        text = "\n".join(read_lines(file, remedy)) + "\n"
        root = cv2.FileStorage()
        root.open(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        numbers = {
            name: _number(root.getNode(section).getNode(name), file, name, remedy)
            for section, names in _SECTIONS.items()
            for name in names
        }
        width, height = (
            round(_number(root.getNode(name), file, name, remedy))
            for name in ("image_width", "image_height")
        )
    except DatasetError as error:
        raise CalibrationError(str(error)) from None
    except cv2.error:
        raise CalibrationError(f"{file} is no YAML of OpenCV; {remedy}") from None
    return MeiCamera(**numbers, width=width, height=height)


def _number(node: cv2.FileNode, file: Path, name: str, remedy: str) -> float:
    if not (node.isReal() or node.isInt()):
        raise CalibrationError(f"{file} has no number {name}; {remedy}")
    return float(node.real())


@lru_cache(maxsize=4)
def _places(camera: MeiCamera) -> NDArray[np.float32]:
    """Where in the fisheye's image each pixel of the pinhole camera lies, (height, width, 2)."""
    K = camera.pinhole.K
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(u.shape)], axis=-1)
    return camera.project(rays).astype(np.float32)
