"""Draw README's picture and film, docs/kitti_depth.jpg and docs/kitti_wipe.webp, from a real drive.

    python docs/kitti.py 2011_09_26/2011_09_26_drive_0013_sync

The photos are KITTI's (Geiger et al., IJRR 2013), CC BY-NC-SA 3.0, and so are both files: they are
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
from docdepth.visualization import pictures

FRAMES, SHOWN = "0:90", 40
FILM, SIZE, PERIOD = range(15, 75), (720, 218), 30  # images, pixels, images of a wipe to and fro
CAMERA = "image_02"


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


def main(drive: Path, folder: Path, docs: Path) -> None:
    """Both pictures, of runs in the folder."""
    made = {
        name: docdepth.run(
            drive, folder / name, docdepth.parameters(name), frames=FRAMES, camera=CAMERA
        ).cameras[CAMERA]
        for name in ("paper", "default")
    }
    draw_presets(made["paper"][SHOWN], made["default"][SHOWN], docs / "kitti_depth.jpg")
    draw_film([made["default"][k] for k in FILM], docs / "kitti_wipe.webp")


if __name__ == "__main__":
    plt.switch_backend("Agg")
    with TemporaryDirectory() as runs:
        main(Path(sys.argv[1]), Path(runs), Path(__file__).parent)
