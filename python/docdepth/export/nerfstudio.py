"""nerfstudio's layout: ``transforms.json`` with images, depth, masks and a point cloud.

``ns-train depth-nerfacto --data OUT``, or splatfacto, reads it as it is.
"""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np

from docdepth.concurrency import Progress
from docdepth.export.photos import PIXEL_CENTRE, Colors, photos, write_bytes, write_image
from docdepth.io.ply import write_vertices
from docdepth.pipeline.run_reader import Run

_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])  # of OpenCV: x right, y up, z backward
_UNITS = 1000.0  # a metre: nerfstudio takes depth in millimetres unless it is told otherwise
_ROW = np.dtype([*((n, "<f8") for n in "xyz"), *((n, "u1") for n in ("red", "green", "blue"))])


def write_nerfstudio(run: Run, output: Path, progress: Progress | None = None) -> int:
    """Write ``transforms.json``, ``images``, ``depth``, ``masks`` and ``points.ply``.

    ``transform_matrix`` is ``T_world_camera`` with OpenGL's axes, in the world of the run. Depth is
    float32 millimetres along the optical axis, 0 = none: 16 bits would end at 65 m. Masks are black
    where something moves.

    Returns
    -------
    int
        Images.
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
        write_bytes(output / paths["depth_file_path"], depth.getvalue())
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
    write_bytes(output / "transforms.json", json.dumps(tree, indent=1).encode())
    return len(frames)
