"""Draw the picture of the stages, docs/stages.jpg, from a synthetic street."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import matplotlib.pyplot as plt
import numpy as np

import docdepth
from docdepth.synthetic import write_drive
from docdepth.visualization import pictures
from docdepth.visualization.drive_scene import class_colors, vote_colors

FRAMES, SHOWN = 20, 5
WIDTH, LENGTH = 26.0, 34.0  # of the street from above [m]


def draw(folder: Path, file: Path) -> None:
    """Ground, votes and classes of one sweep from above, and the depth map of its image."""
    drive = docdepth.open_dataset(write_drive(folder, "city", "HDL-64", FRAMES))
    odometry = docdepth.register_drive(drive)
    sweeps, trajectory = odometry.sweeps, odometry.trajectory
    labels = docdepth.classify_drive(sweeps, trajectory)
    k, stream = SHOWN, drive.cameras["image_2"]
    depth = docdepth.render_depth(docdepth.Scene(sweeps, trajectory, labels), stream, index=k)

    points, classid, votes = sweeps[k].points, labels[k].classid, labels[k].votes
    shown = {
        "Ground (blue), IV-A": class_colors(np.where(classid < 50, 0, 50).astype(np.uint16)),
        "Votes, IV-C: orange looked through": vote_colors(votes.static, votes.dynamic),
        "Classes, IV-C: orange moves": class_colors(np.where(classid < 100, 50, classid)),
    }
    size = np.where(classid >= 100, 3.0, 0.6)
    figure = plt.figure(figsize=(11, 8.2), layout="constrained")
    grid = figure.add_gridspec(2, 3, height_ratios=(1, 0.72))
    for column, (title, colour) in enumerate(shown.items()):
        axes = figure.add_subplot(grid[0, column])
        axes.scatter(-points[:, 1], points[:, 0], c=colour, s=size, linewidths=0)
        axes.set(xlim=(-WIDTH / 2, WIDTH / 2), ylim=(-LENGTH / 2, LENGTH / 2), xticks=[], yticks=[])
        axes.set(title=title, aspect="equal")
    axes = figure.add_subplot(grid[1, :])
    axes.imshow(pictures.overlay(depth, stream.rectified_image(k))[..., ::-1])
    axes.set_title("Composite depth map, V-B: near is yellow, far is violet")
    axes.axis("off")
    figure.canvas.draw()
    image = np.asarray(figure.canvas.buffer_rgba())[..., 2::-1]
    cv2.imwrite(str(file), image, [cv2.IMWRITE_JPEG_QUALITY, 85])


if __name__ == "__main__":
    plt.switch_backend("Agg")
    with TemporaryDirectory() as folder:
        draw(Path(folder), Path(__file__).with_suffix(".jpg"))
