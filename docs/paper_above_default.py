"""Draw the picture of both presets, docs/paper_above_default.jpg, from a synthetic street."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import matplotlib.pyplot as plt
import numpy as np

import docdepth
from docdepth.synthetic import write_drive
from docdepth.visualization import pictures

FRAMES, SHOWN = 24, 12


def draw(folder: Path, file: Path) -> None:
    """A photo, and its depth map by each preset, with one scale of colours."""
    drive = docdepth.open_dataset(write_drive(folder, "crossing", "HDL-64", FRAMES))
    odometry = docdepth.register_drive(drive)
    sweeps, trajectory = odometry.sweeps, odometry.trajectory
    stream = drive.cameras["image_2"]
    shown = {"Photo": stream.rectified_image(SHOWN)}
    titles = {
        "paper": "Depth by --preset paper: each point a disc",
        "default": "Depth by default: each sweep a mesh, edges decided by other sweeps",
    }
    for preset, title in titles.items():
        chosen = docdepth.parameters(preset)
        labels = docdepth.classify_drive(sweeps, trajectory, chosen)
        scene = docdepth.Scene(sweeps, trajectory, labels, chosen)
        depth = docdepth.render_depth(scene, stream, index=SHOWN)
        shown[title] = pictures.colorize(depth, bar=False)
    figure, axes = plt.subplots(4, 1, figsize=(11, 11), layout="constrained",
                                gridspec_kw={"height_ratios": (1, 1, 1, 0.06)})  # fmt: skip
    for place, (title, picture) in zip(axes, shown.items(), strict=False):
        place.imshow(picture[..., ::-1])
        place.set_title(title, fontsize=14)
        place.axis("off")
    ramp = np.geomspace(pictures.NEAR, pictures.FAR, 600)[None]
    axes[3].imshow(pictures.colorize(ramp, bar=False)[..., ::-1], aspect="auto")
    ticks = np.array([3, 5, 10, 20, 40, 80])
    places = np.log(ticks / pictures.NEAR) / np.log(pictures.FAR / pictures.NEAR) * 599
    axes[3].set_xticks(places, [f"{tick} m" for tick in ticks], fontsize=13)
    axes[3].set_yticks([])
    axes[3].set_title("dark: no depth", fontsize=13)
    figure.canvas.draw()
    image = np.asarray(figure.canvas.buffer_rgba())[..., 2::-1]
    cv2.imwrite(str(file), image, [cv2.IMWRITE_JPEG_QUALITY, 85])


if __name__ == "__main__":
    plt.switch_backend("Agg")
    with TemporaryDirectory() as folder:
        draw(Path(folder), Path(__file__).with_suffix(".jpg"))
