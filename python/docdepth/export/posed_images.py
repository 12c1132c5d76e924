"""Layouts of posed images: nerfstudio's and COLMAP's, with the static map in photos' colours."""

from __future__ import annotations

import io
import json
import os
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from docdepth.concurrency import Progress, null_progress
from docdepth.errors import RunError
from docdepth.geometry.camera import pixels_in_image
from docdepth.geometry.se3 import inverse, matrix_to_quaternion, transform_points
from docdepth.io.atomic import write_atomically
from docdepth.io.images import encode_image
from docdepth.io.ply import write_vertices
from docdepth.pipeline.run_reader import Run, RunImage

PIXEL_CENTRE = 0.5
"""These programs have the centre of the first pixel at (0.5, 0.5), docdepth has it at (0, 0)."""

_SAME = 0.02  # of depth: how far a point may be from the map where a pixel shows it
_GREY = 128  # of points that no photo shows
_VIEWS = 9  # of a point, whose median is its colour


class Photo(NamedTuple):
    """A photo of a recorded camera, as it is written."""

    image: RunImage
    name: str  # ``CAMERA/NAME``
    rgb: NDArray[np.uint8]  # (h, w, 3): without lens distortion
    depth: NDArray[np.float32]  # (h, w): metres, NaN without depth
    still: NDArray[np.bool_]  # (h, w): where it shows the world, and nothing that moves


def photos(run: Run, progress: Progress) -> Iterator[Photo]:
    """The photos of all recorded cameras of a run, read one by one."""
    recorded = [n for n, entry in run.folder.cameras.items() if entry.virtual is None]
    images = [image for name in recorded for image in run.cameras[name]]
    count = 0
    for done, image in enumerate(images, 1):
        rgb, mask = image.image, image.of.stream.camera.mask
        if rgb is not None:
            still = ~image.moving if mask is None else ~image.moving & mask
            yield Photo(image, f"{image.of.name}/{image.name}", rgb, image.depth, still)
            count += 1
        progress("convert", done, len(images))
    if not count:
        raise RunError(f"{run.path} has no photos with depth maps")


def write_image(path: Path, pixels: NDArray[np.uint8]) -> None:
    """Write RGB (h, w, 3) or grey (h, w) as PNG."""
    stored = pixels[..., ::-1] if pixels.ndim == 3 else pixels
    write_atomically(path, encode_image(stored, ".png"))


class Colors:
    """Colours of points in the world: the median of the photos whose depth map shows them.

    Of many photos the last nine count, which are the nearest ones where the camera looks ahead.
    """

    def __init__(self, points: NDArray[np.float64]) -> None:
        self.points = points
        self._seen = np.zeros((len(points), _VIEWS, 3), np.uint8)
        self._count = np.zeros(len(points), np.int64)

    def add(self, photo: Photo) -> None:
        """Look at the points in one more photo."""
        points = transform_points(inverse(photo.image.T_world_camera), self.points)
        rows, u, v = pixels_in_image(points, photo.image.camera)
        z = points[rows, 2]
        shown = (np.abs(photo.depth[v, u] - z) < _SAME * z) & photo.still[v, u]
        rows = rows[shown]
        self._seen[rows, self._count[rows] % _VIEWS] = photo.rgb[v[shown], u[shown]]
        self._count[rows] += 1

    def rgb(self) -> NDArray[np.uint8]:
        """The colours (n, 3); grey where no photo shows the point."""
        found = np.full((len(self.points), 3), _GREY, np.uint8)
        views = np.minimum(self._count, _VIEWS)
        for count in range(1, _VIEWS + 1):
            rows = views == count
            found[rows] = np.rint(np.median(self._seen[rows, :count], axis=1))
        return found


_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])  # of OpenCV: x right, y up, z backward
_UNITS = 1000.0  # a metre: nerfstudio takes depth in millimetres unless it is told otherwise
_ROW = np.dtype([*((n, "<f8") for n in "xyz"), *((n, "u1") for n in ("red", "green", "blue"))])


def write_nerfstudio(run: Run, output: Path, progress: Progress = null_progress) -> int:
    """Write ``transforms.json``, ``images``, ``depth``, ``masks`` and ``points.ply``.

    ``ns-train depth-nerfacto --data OUT``, or splatfacto, reads it as it is.

    ``transform_matrix`` is ``T_world_camera`` with OpenGL's axes, in the world of the run. Depth is
    float32 millimetres along the optical axis, 0 = none: 16 bits would end at 65 m. Masks are black
    where something moves.
    """
    frames, colors = [], Colors(run.static_map().points)
    for photo in photos(run, progress):
        camera, K = photo.image.camera, photo.image.K
        paths = {
            "file_path": f"images/{photo.name}.png",
            "depth_file_path": f"depth/{photo.name}.npy",
            "mask_path": f"masks/{photo.name}.png",
        }
        write_image(output / paths["file_path"], photo.rgb)
        write_image(output / paths["mask_path"], np.where(photo.still, 255, 0).astype(np.uint8))
        depth = io.BytesIO()
        np.save(depth, np.nan_to_num(photo.depth * np.float32(_UNITS)))
        write_atomically(output / paths["depth_file_path"], depth.getvalue())
        colors.add(photo)
        frames.append({
            **paths,
            "fl_x": K[0, 0], "fl_y": K[1, 1],
            "cx": K[0, 2] + PIXEL_CENTRE, "cy": K[1, 2] + PIXEL_CENTRE,
            "w": camera.width, "h": camera.height,
            "transform_matrix": (photo.image.T_world_camera @ _OPENGL).tolist(),
        })  # fmt: skip
    rows = np.empty(len(colors.points), _ROW)
    rows["x"], rows["y"], rows["z"] = colors.points.T
    rows["red"], rows["green"], rows["blue"] = colors.rgb().T
    write_vertices(output / "points.ply", rows, ["world [m]"])
    tree = {"camera_model": "PINHOLE", "ply_file_path": "points.ply", "frames": frames}
    write_atomically(output / "transforms.json", json.dumps(tree, indent=1).encode())
    return len(frames)


_PINHOLE = 1  # COLMAP's number of the model
# A point: id, place, colour, error of reprojection, length of its track, which is empty.
_POINT = np.dtype(
    [("id", "<u8"), ("xyz", "<f8", 3), ("rgb", "u1", 3), ("error", "<f8"), ("track", "<u8")]
)


def write_colmap(run: Run, output: Path, progress: Progress = null_progress) -> int:
    """Write ``sparse/0/{cameras,images,points3D}.bin``, ``images`` and ``masks``.

    ``colmap gui --import_path OUT/sparse/0 --image_path OUT/images`` shows it. Gaussian splatting
    reads the folder as it is.

    Images are without lens distortion, so cameras are pinholes. Points are those of the static map,
    in the world of the run, coloured by the photos; they have no tracks. Masks are black where
    something moves.
    """
    cameras: dict[str, int] = {}
    camera_rows, image_rows = [], []
    colors = Colors(run.static_map().points)
    for number, photo in enumerate(photos(run, progress), 1):
        of, K = photo.image.of, photo.image.K
        if of.name not in cameras:
            cameras[of.name] = len(cameras) + 1
            size = of.camera.width, of.camera.height
            centre = K[:2, 2] + PIXEL_CENTRE
            lens = K[0, 0], K[1, 1], *centre
            camera_rows.append(struct.pack("<IiQQ4d", cameras[of.name], _PINHOLE, *size, *lens))
        name = f"{photo.name}.png"
        write_image(output / "images" / name, photo.rgb)
        mask = np.where(photo.still, 255, 0).astype(np.uint8)
        write_image(output / "masks" / f"{name}.png", mask)
        colors.add(photo)
        T = inverse(photo.image.T_world_camera)
        x, y, z, w = matrix_to_quaternion(T[:3, :3])
        pose = struct.pack("<I7dI", number, w, x, y, z, *T[:3, 3], cameras[of.name])
        image_rows.append(pose + os.fsencode(name) + b"\0" + struct.pack("<Q", 0))
    points = np.zeros(len(colors.points), _POINT)
    points["id"] = np.arange(1, len(points) + 1)
    points["xyz"], points["rgb"] = colors.points, colors.rgb()
    tables = {
        "cameras": (len(camera_rows), b"".join(camera_rows)),
        "images": (len(image_rows), b"".join(image_rows)),
        "points3D": (len(points), points.tobytes()),
    }
    for table, (count, content) in tables.items():
        write_atomically(
            output / "sparse" / "0" / f"{table}.bin", struct.pack("<Q", count) + content
        )
    return len(image_rows)
