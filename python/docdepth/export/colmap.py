"""COLMAP's layout: a sparse model in its binary files, images and masks.

``colmap gui --import_path OUT/sparse/0 --image_path OUT/images`` shows it. Gaussian splatting reads
the folder as it is.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from docdepth.concurrency import Progress
from docdepth.export.photos import PIXEL_CENTRE, Colors, photos, write_bytes, write_image
from docdepth.geometry.se3 import inverse, matrix_to_quaternion
from docdepth.pipeline.run_reader import Run

_PINHOLE = 1  # COLMAP's number of the model
# A point: id, place, colour, error of reprojection, length of its track, which is empty.
_POINT = np.dtype(
    [("id", "<u8"), ("xyz", "<f8", 3), ("rgb", "u1", 3), ("error", "<f8"), ("track", "<u8")]
)


def write_colmap(run: Run, output: Path, progress: Progress | None = None) -> int:
    """Write ``sparse/0/{cameras,images,points3D}.bin``, ``images`` and ``masks``.

    Images are without lens distortion, so cameras are pinholes. Points are those of the static map,
    in the world of the run, coloured by the photos; they have no tracks. Masks are black where
    something moves.

    Returns
    -------
    int
        Images.
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
        image_rows.append(pose + name.encode() + b"\0" + struct.pack("<Q", 0))
    points = np.zeros(len(colors.points), _POINT)
    points["id"] = np.arange(1, len(points) + 1)
    points["xyz"], points["rgb"] = colors.points, colors.rgb()
    tables = {
        "cameras": (len(camera_rows), b"".join(camera_rows)),
        "images": (len(image_rows), b"".join(image_rows)),
        "points3D": (len(points), points.tobytes()),
    }
    for table, (count, content) in tables.items():
        write_bytes(output / "sparse" / "0" / f"{table}.bin", struct.pack("<Q", count) + content)
    return len(image_rows)
