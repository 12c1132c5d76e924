"""The files of a camera's depth maps in a run folder."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth._core import __version__
from docdepth.config import OutputParameters, Parameters
from docdepth.datasets.base import CameraStream
from docdepth.datasets.files import ImageSource, suggest_skipping
from docdepth.errors import Finding
from docdepth.geometry.se3 import inverse
from docdepth.geometry.track import Track
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.atomic import npz_bytes
from docdepth.io.calibration import EXTRINSICS, INTRINSICS, write_calibration
from docdepth.io.depth import DESCRIPTION, FORMATS, encode_depth, read_depth
from docdepth.io.frames import write_trajectory
from docdepth.io.images import PICTURE, encode_image
from docdepth.io.run_folder import RunFolder
from docdepth.io.tracks import KITTI_TRACKS, write_kitti_tracking
from docdepth.render.depth_map import NEAR
from docdepth.visualization.pictures import overlay

_LEAST_DENSITY = 0.05  # mean share of pixels with depth: 0.5 to 0.8


def files_of_image(
    run: RunFolder, folder: str, name: str, output: OutputParameters
) -> dict[str, Path]:
    """All files of an image: ``report``, ``layers``, and a depth map of each format.

    Depth maps come last, so that they mark the image as done.
    """
    places = {"report": ("report", ".jpg"), "layers": ("layers", ".npz")}
    if not output.layers:
        del places["layers"]
    places |= {format: ("depth", FORMATS[format]) for format in output.format}
    return {what: run.path / kind / folder / f"{name}{end}" for what, (kind, end) in places.items()}


@dataclass(frozen=True)
class DepthFiles:
    """The files of one camera: depth maps, layers, pictures and their description."""

    camera: CameraStream  # without its images, of which there may be many
    # its folder in ``depth/``, ``layers/`` and ``report/``; empty for the first camera of a run
    folder: str
    parameters: Parameters
    key: str = ""  # hash of all that the maps are made of; needed to write

    @property
    def layers_key(self) -> dict[str, str]:
        """What the records of layers and of the description name beside."""
        return {"layers": ",".join(self.parameters.output.layers)}

    def once(self, run: RunFolder) -> list[Path]:
        """The files of the camera itself: description, calibration, trajectory and tracks."""
        folder = run.calibration_folder(self.folder)
        names = (INTRINSICS, EXTRINSICS, "traj_camera.ply", KITTI_TRACKS)
        description = run.path / "depth" / self.folder / DESCRIPTION
        return [description, *(folder / name for name in names)]

    def write_camera(
        self,
        run: RunFolder,
        images: Sequence[DepthImage],
        trajectory: Trajectory,
        tracks: Iterable[Track],
    ) -> None:
        """Write the calibration, the LiDAR's poses at the times of the images (paper V-A), and
        where the images, in order of time, show tracks."""
        indices = np.array([image.index for image in images])
        times = np.array([image.time for image in images])
        poses = Trajectory(times, trajectory.interpolate(times))
        camera, write = self.camera, run.writer({"render": self.key})
        folder = run.calibration_folder(self.folder)
        distortion = camera.distortion_coefficients
        write_calibration(
            folder, camera.camera, camera.T_camera_lidar, distortion, camera.model, write
        )
        write_trajectory(folder / "traj_camera.ply", poses, indices, write)
        T_world_camera = Trajectory(poses.times, poses.poses @ inverse(camera.T_camera_lidar))
        path = folder / KITTI_TRACKS
        write_kitti_tracking(path, tracks, camera.camera, T_world_camera, indices, write)

    def describe(self, run: RunFolder, maps: Mapping[DepthImage, float], complete: bool) -> None:
        """Write ``depth.json``: unit, camera, parameters, and time and coverage of each map.

        Parameters
        ----------
        maps : dict of DepthImage to float
            Share of pixels with depth of each image that is done.
        complete : bool
            All maps are there. Otherwise the description is written again later.
        """
        camera, output = self.camera, self.parameters.output
        description = {
            "depth": "z along the optical axis of the rectified camera; file = metres x scale",
            "unit": "m",
            "scale": {f: output.scale if f == "png" else 1 for f in output.format},
            "none": {f: 0 if f == "png" else "NaN" for f in output.format},
            "range": [NEAR, self.parameters.render.max_depth],
            "camera": {
                "name": camera.name,
                **camera.camera.as_dict(),
                "T_camera_lidar": camera.T_camera_lidar.tolist(),
                "distortion_of_images": camera.distortion_coefficients,
            },
            "layers": list(output.layers),
            "pixels": "integer coordinates are pixel centres (OpenCV)",
            "docdepth": __version__,
            "parameters": self.parameters.model_dump(mode="json"),
            "maps": {
                image.name: {"time_ns": image.time, "coverage": round(share, 6)}
                for image, share in sorted(maps.items(), key=lambda one: one[0].index)
            },
        }
        content = json.dumps(description, indent=1).encode()
        key = {"render": self.key, **self.layers_key} if complete else {"incomplete": self.key}
        run.write(run.path / "depth" / self.folder / DESCRIPTION, content, key)


@dataclass(frozen=True, eq=False)
class DepthImage:
    """One image and its files: all that a worker needs to know of it."""

    of: DepthFiles  # of its camera
    index: int  # in its camera
    time: int  # nanoseconds
    name: str
    source: ImageSource | None  # None if the image is not on disk
    identity: str  # of the image, which the picture shows

    def files(self, run: RunFolder) -> dict[str, Path]:
        """All files, as :func:`files_of_image` names them."""
        return files_of_image(run, self.of.folder, self.name, self.of.parameters.output)

    def left(self, run: RunFolder) -> dict[str, dict[str, str]]:
        """Those of :meth:`files` that are not up to date, and what they are to be made of."""
        key = {"render": self.of.key, "image": self.identity}
        keys = {what: key for what in self.files(run)}
        if "layers" in keys:
            keys["layers"] = key | self.of.layers_key
        return {k: keys[k] for k, path in self.files(run).items() if run.key(path) != keys[k]}

    @property
    def exact(self) -> str:
        """Of several formats the most exact, which :meth:`depth` reads."""
        return max(self.of.parameters.output.format, key=list(FORMATS).index)

    def depth(self, run: RunFolder) -> NDArray[np.float32]:
        """Read the depth map."""
        return read_depth(self.files(run)[self.exact], self.of.parameters.output.scale)

    def write(
        self, run: RunFolder, depth: NDArray[np.float32], layers: dict[str, NDArray[Any]]
    ) -> None:
        """Write all files that are not up to date."""
        files = self.files(run)
        for what, key in self.left(run).items():
            if what == "report":
                images = [] if self.source is None else [self.source]
                times = np.array([self.time])
                alone = replace(self.of.camera, times=times, names=[self.name], images=images)
                with suggest_skipping():
                    image = alone.rectified_image(0)
                content = encode_image(overlay(depth, image), ".jpg", *PICTURE)
            elif what == "layers":
                content = npz_bytes(compressed=True, **layers)
            else:
                content = encode_depth(depth, what, self.of.parameters.output.scale)
            run.write(files[what], content, key)


def find_empty_maps(coverage: Sequence[float], camera: str) -> list[Finding]:
    """Whether the depth maps of a camera are all but empty; ``coverage`` is a share of each map."""
    if not len(coverage) or np.mean(coverage) >= _LEAST_DENSITY:
        return []
    text = (
        f"only {100 * np.mean(coverage):.1f} % of the pixels of {camera} have depth: the "
        "extrinsics or the intrinsics may be wrong, the image times may not fit, or the camera may "
        "look where the LiDAR does not"
    )
    return [Finding("empty-maps", "", text)]
