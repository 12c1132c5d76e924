"""Draw README's picture and films, docs/kitti_*, from a real drive.

    python docs/kitti.py 2011_09_26/2011_09_26_drive_0013_sync

The photos are KITTI's (Geiger et al., IJRR 2013), CC BY-NC-SA 3.0, and so are these files: they are
in docs only, and in no wheel.
"""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray
from PIL import Image

import docdepth
from docdepth.export import export
from docdepth.io.ply import read_vertices
from docdepth.visualization import pictures

FRAMES, SHOWN = "0:90", 40
FILM, SIZE, PERIOD = range(15, 75), (720, 218), 30  # images, pixels, images of a wipe to and fro
CAMERA = "image_02"
# What the map is looked at: its middle in the world and the distance to it [m], angles [rad].
MIDDLE, DISTANCE, ABOVE, AROUND, SWING = (34, 4, -1.5), 34, 0.5, 3.5, 0.6
FOCAL = 960  # pixels
MAP_SIZE, MAP_IMAGES, POINT = (600, 270), 40, 4  # POINT is a side in pixels of twice the size


def colours(depth: NDArray[np.float32]) -> NDArray[np.uint8]:
    """RGB of a depth map."""
    return np.ascontiguousarray(pictures.colorize(depth, bar=False)[..., ::-1])


def draw_presets(paper: docdepth.RunImage, ours: docdepth.RunImage, file: Path) -> None:
    """Photo, depth of discs as in the paper, and docdepth's, one above the other."""
    shown = {
        "Photo": ours.image,
        "Depth as in the paper: each point a disc": colours(paper.depth),
        "Depth by docdepth: each sweep a mesh, edges decided by other sweeps": colours(ours.depth),
    }
    figure, axes = plt.subplots(3, 1, figsize=(9.5, 9.4), layout="constrained")
    for place, (title, picture) in zip(axes, shown.items(), strict=True):
        place.imshow(picture)
        place.set_title(title, fontsize=13)
        place.axis("off")
    figure.savefig(file, dpi=110, pil_kwargs={"quality": 85})


def draw_film(images: list[docdepth.RunImage], file: Path) -> None:
    """Depth wipes over the photo, to and fro, while the vehicle drives."""
    film = []
    for k, one in enumerate(images):
        photo, depth = (Image.fromarray(a).resize(SIZE) for a in (one.image, colours(one.depth)))
        border = round(SIZE[0] * (0.5 + 0.42 * np.sin(2 * np.pi * k / PERIOD)))
        photo.paste(depth.crop((0, 0, border, SIZE[1])), (0, 0))
        photo.paste((255, 255, 255), (border, 0, border + 2, SIZE[1]))
        film.append(photo)
    film[0].save(
        file, save_all=True, append_images=film[1:], duration=100, loop=0, quality=45, method=6
    )


def draw_map(map_file: Path, file: Path) -> None:
    """The map in the colours of the photos, while the viewer goes to and fro around it."""
    rows, _ = read_vertices(map_file)
    colors = np.stack([rows[name] for name in ("red", "green", "blue")], axis=1)
    seen = (colors != 128).any(axis=1)  # the others are in no photo
    points = np.stack([rows[name] for name in "xyz"], axis=1)[seen]
    swing = SWING * np.sin(2 * np.pi * np.arange(MAP_IMAGES) / MAP_IMAGES)
    film = [view_of_map(points, colors[seen], AROUND + angle) for angle in swing]
    film[0].save(
        file, save_all=True, append_images=film[1:], duration=120, loop=0, quality=35, method=6
    )


def view_of_map(
    points: NDArray[np.float64], colors: NDArray[np.uint8], around: float
) -> Image.Image:
    """Points (n, 3) [m] from above, near ones over far ones; drawn twice as large, then reduced."""
    width, height = np.multiply(2, MAP_SIZE)
    to_viewer = np.cos(around) * np.cos(ABOVE), np.sin(around) * np.cos(ABOVE), np.sin(ABOVE)
    ahead = -np.array(to_viewer)
    right = np.cross(ahead, (0, 0, 1)) / np.cos(ABOVE)
    axes = np.stack([right, np.cross(ahead, right), ahead], axis=1)
    placed = (points - MIDDLE + DISTANCE * ahead) @ axes
    order = np.argsort(-placed[:, 2])
    order = order[placed[order, 2] > 3]
    u, v = (FOCAL * placed[order, :2] / placed[order, 2:] + (width / 2, height / 2)).T
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    u, v, order = u[inside].astype(int), v[inside].astype(int), order[inside]
    picture = np.full((height + POINT, width + POINT, 3), pictures.BACKGROUND, np.uint8)
    down, along = np.indices((POINT, POINT)).reshape(2, -1)
    picture[(v[:, None] + down).ravel(), (u[:, None] + along).ravel()] = np.repeat(
        colors[order], POINT**2, axis=0
    )
    return Image.fromarray(picture[:height, :width]).resize(MAP_SIZE)


def main(drive: Path, folder: Path, docs: Path) -> None:
    """All three, of runs in the folder."""
    made = {
        name: docdepth.run(
            drive, folder / name, docdepth.parameters(name), frames=FRAMES, camera=CAMERA
        ).cameras[CAMERA]
        for name in ("paper", "default")
    }
    draw_presets(made["paper"][SHOWN], made["default"][SHOWN], docs / "kitti_depth.jpg")
    draw_film([made["default"][k] for k in FILM], docs / "kitti_wipe.webp")
    export(folder / "default", folder / "map", "map")
    draw_map(folder / "map" / "map.ply", docs / "kitti_map.webp")


if __name__ == "__main__":
    plt.switch_backend("Agg")
    with TemporaryDirectory() as runs:
        main(Path(sys.argv[1]), Path(runs), Path(__file__).parent)
