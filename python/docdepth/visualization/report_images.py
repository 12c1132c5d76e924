"""The images of a report: some of each camera, with all that is known of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from docdepth.datasets.base import CameraStream
from docdepth.geometry.camera import View, below_horizon
from docdepth.geometry.se3 import transform_points
from docdepth.geometry.track import Track
from docdepth.io.depth import described_maps, maps_in, read_depth
from docdepth.io.run_folder import RunFolder
from docdepth.io.untrusted import read_layers
from docdepth.visualization.image_views import draw_tracks, photo_of, view_of_layer, view_of_points
from docdepth.visualization.page import PageImage, embedded, embedded_depth
from docdepth.visualization.pictures import Picture, colorize, reduced

IMAGES = 12
"""Of a camera within the page, spaced evenly over the drive, fewer where there are many cameras."""

_PICTURES = 72  # on a page
_BYTES = 8_500_000  # of all pictures of a page, before they become text
_LARGEST = 500_000  # pixels of a picture
_LARGEST_BYTES = 150_000
_VALUES = 80_000  # pixels whose depth the page holds, of an image
_LAYERS = ("confidence", "seen", "instance")  # shown where the run has them


class CameraPage(NamedTuple):
    """What the report says of a camera."""

    name: str
    # its images, some of them with the views ``image``, ``depth``, ``class`` and layers, the others
    # as the files beside the page
    images: list[PageImage]
    density: list[tuple[int, float]]  # time [ns] and share of pixels with depth of each map
    # the same share of the pixels below the horizon, mean over the images; NaN without such
    below_horizon: float


def camera_pages(
    run: RunFolder, streams: Mapping[str, CameraStream], tracks: Sequence[Track]
) -> Iterator[CameraPage]:
    """The cameras of a run that have depth maps, each with its images."""
    start = int(run.trajectory().times[0])
    count, most = budget(len(run.cameras))
    for camera, entry in run.cameras.items():
        depths = run.path / "depth" / entry.folder
        maps, files = described_maps(depths), maps_in(depths)
        names = sorted(maps.keys() & files.keys(), key=lambda image: maps[image][0])
        if not names:
            continue
        is_below = below_horizon(*run.calibration(entry.folder)[:2])
        images, shares = [], []
        within = set(np.rint(np.linspace(0, len(names) - 1, min(count, len(names)))).astype(int))
        for k, name in enumerate(names):
            seconds = (maps[name][0] - start) * 1e-9
            image = PageImage(f"image {name} at {seconds:.1f} s", {}, seconds)
            if k not in within:
                file = Path(entry.folder, f"{name}.jpg").as_posix()
                images.append(image._replace(file=file))
                continue
            depth = read_depth(files[name])
            photo = photo_of(streams.get(camera), name)
            pictures = _pictures(run, entry.folder, name, maps[name][0], photo, tracks)
            pictures["depth"] = colorize(depth, bar=False)
            scale = (_LARGEST / depth.size) ** 0.5
            views = {v: embedded(reduced(p, scale), most) for v, p in pictures.items()}
            images.append(image._replace(views=views, values=embedded_depth(depth, _VALUES)))
            if is_below.any():
                shares.append(np.isfinite(depth[is_below]).mean())
        below = float(np.mean(shares or [np.nan]))
        yield CameraPage(camera, images, [maps[name] for name in names], below)


def budget(cameras: int) -> tuple[int, int]:
    """Images of each camera, and bytes of each picture, on a page of so many cameras."""
    views = (3 + len(_LAYERS)) * max(cameras, 1)
    count = int(np.clip(_PICTURES // views, 1, IMAGES))
    return count, min(_BYTES // (views * count), _LARGEST_BYTES)


def _pictures(
    run: RunFolder,
    folder: str,
    name: str,
    time: int,
    photo: Picture | None,
    tracks: Sequence[Track],
) -> dict[str, Picture]:
    """What is known of an image beside its depth."""
    trajectory, (camera, T_camera_lidar, _) = run.trajectory(), run.calibration(folder)
    view = View.at(camera, T_camera_lidar, trajectory, time)
    layers = read_layers(run.path / "layers" / folder / f"{name}.npz", "class", *_LAYERS)
    pictures = {layer: view_of_layer(layer, values, photo) for layer, values in layers.items()}
    if "class" not in pictures:
        k = trajectory.nearest(time)
        record, classid = run.classified_frame(k)
        points = transform_points(view.T_camera_world @ trajectory.poses[k], record.points)
        pictures["class"] = view_of_points(points, classid, camera, photo)
    draw_tracks(pictures["class"], tracks, view)
    return pictures if photo is None else pictures | {"image": photo}
