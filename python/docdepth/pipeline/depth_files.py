"""The files of a camera's depth maps in a run folder."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth._core import __version__
from docdepth.config import Parameters
from docdepth.datasets.base import CameraStream
from docdepth.datasets.files import suggest_skipping
from docdepth.errors import DatasetError, Finding
from docdepth.geometry.se3 import inverse
from docdepth.geometry.track import Track
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.atomic import npz_bytes
from docdepth.io.calibration import EXTRINSICS, INTRINSICS, write_calibration
from docdepth.io.depth import DESCRIPTION, FORMATS, as_stored, encode_depth, read_depth
from docdepth.io.frames import write_trajectory
from docdepth.io.images import PICTURE, encode_image
from docdepth.io.run_folder import RunFolder
from docdepth.io.tracks import KITTI_TRACKS, write_kitti_tracking
from docdepth.render.depth_map import NEAR
from docdepth.visualization.pictures import overlay

_LEAST_DENSITY = 0.05  # mean share of pixels with depth: 0.5 to 0.8


@dataclass(frozen=True)
class DepthFiles:
    """The files of one camera: depth maps, layers, pictures and their description."""

    run: RunFolder
    stream: CameraStream
    # its folder in ``depth/``, ``layers/`` and ``report/``; empty for the first camera of a run
    folder: str
    parameters: Parameters
    key: str = ""  # hash of all that the maps are made of; needed to write
    # the identity of each image, which the pictures show; needed to write
    images: dict[int, str] = field(default_factory=dict)
    # share of pixels with depth of each image that is done
    coverage: dict[int, float] = field(default_factory=dict)

    def of(self, indices: Sequence[int]) -> DepthFiles:
        """The files of some images, numbered anew: what a worker needs to know."""
        stream, images = self.stream, self.stream.images
        part = replace(
            stream,
            times=stream.times[indices],
            names=[stream.names[k] for k in indices],
            images=[images[k] for k in indices] if images else [],
        )
        return replace(
            self,
            stream=part,
            images={n: self.images[k] for n, k in enumerate(indices)},
            coverage={},
        )

    @property
    def layers_key(self) -> dict[str, str]:
        """What the records of layers and of the description name beside."""
        return {"layers": ",".join(self.parameters.output.layers)}

    def left(self, index: int) -> list[str]:
        """Those of :meth:`files` that are not up to date."""
        return [
            what
            for what, path in self.files(index).items()
            if self.run.key(path) != self._key(index, what)
        ]

    def _key(self, index: int, what: str) -> dict[str, str]:
        key = {"render": self.key, "image": self.images[index]}
        return key | self.layers_key if what == "layers" else key

    def shares(self) -> list[float]:
        """The coverage of the images that are done, in order."""
        return [share for _, share in sorted(self.coverage.items())]

    def files(self, index: int) -> dict[str, Path]:
        """All files of an image: ``report``, ``layers``, and a depth map of each format.

        Depth maps come last, so that they mark the image as done.
        """
        name, output = self.stream.names[index], self.parameters.output
        places = {"report": ("report", ".jpg"), "layers": ("layers", ".npz")}
        if not output.layers:
            del places["layers"]
        places |= {format: ("depth", FORMATS[format]) for format in output.format}
        return {
            what: self.run.path / folder / self.folder / f"{name}{suffix}"
            for what, (folder, suffix) in places.items()
        }

    def once(self) -> list[Path]:
        """The files of the camera itself: description, calibration, trajectory and tracks."""
        folder = self.run.calibration_folder(self.folder)
        names = (INTRINSICS, EXTRINSICS, "traj_camera.ply", KITTI_TRACKS)
        description = self.run.path / "depth" / self.folder / DESCRIPTION
        return [description, *(folder / name for name in names)]

    def folders(self) -> list[Path]:
        """Where the files of images lie."""
        return [self.run.path / kind / self.folder for kind in ("depth", "report", "layers")]

    def find_coverage(self, index: int) -> bool:
        """Note the coverage of a map that is done; False if it cannot be read after all."""
        try:
            self.coverage[index] = _share_with_depth(self.depth(index))
        except DatasetError:
            return False
        return True

    def depth(self, index: int) -> NDArray[np.float32]:
        """Read the depth map of an image, of several formats the most exact."""
        return read_depth(self.files(index)[self._exact], self.parameters.output.scale)

    def as_stored(self, depth: NDArray[np.float32]) -> NDArray[np.float32]:
        """A depth map as :meth:`depth` reads it."""
        return as_stored(depth, self._exact, self.parameters.output.scale)

    @property
    def _exact(self) -> str:
        return max(self.parameters.output.format, key=list(FORMATS).index)

    def write_camera(self, trajectory: Trajectory, tracks: Iterable[Track]) -> None:
        """Write the calibration, the LiDAR's poses at the times of the images (paper V-A), and
        where the images show tracks."""
        indices = np.array(sorted(self.images, key=lambda k: int(self.stream.times[k])))
        times = self.stream.times[indices]
        poses = Trajectory(times, trajectory.interpolate(times))
        stream, write = self.stream, self.run.writer({"render": self.key})
        folder = self.run.calibration_folder(self.folder)
        distortion = stream.distortion_coefficients
        write_calibration(
            folder, stream.camera, stream.T_camera_lidar, distortion, stream.model, write
        )
        write_trajectory(folder / "traj_camera.ply", poses, indices, write)
        T_world_camera = Trajectory(poses.times, poses.poses @ inverse(stream.T_camera_lidar))
        path = folder / KITTI_TRACKS
        write_kitti_tracking(path, tracks, stream.camera, T_world_camera, indices, write)

    def write(
        self, index: int, depth: NDArray[np.float32], layers: dict[str, NDArray[Any]]
    ) -> float:
        """Write all files of an image that are not up to date.

        Returns
        -------
        float
            Share of pixels with depth.
        """
        for what in self.left(index):
            path, key = self.files(index)[what], self._key(index, what)
            if what == "report":
                with suggest_skipping():
                    image = self.stream.rectified_image(index)
                content = encode_image(overlay(depth, image), ".jpg", *PICTURE)
            elif what == "layers":
                content = npz_bytes(compressed=True, **layers)
            else:
                content = encode_depth(depth, what, self.parameters.output.scale)
            self.run.write(path, content, key)
        return _share_with_depth(depth)

    def describe(self, complete: bool = True) -> None:
        """Write ``depth.json``: unit, camera, parameters, and time and coverage of each map.

        Parameters
        ----------
        complete : bool
            All maps are there. Otherwise the description is written again later.
        """
        stream, output = self.stream, self.parameters.output
        description = {
            "depth": "z along the optical axis of the rectified camera; file = metres x scale",
            "unit": "m",
            "scale": {f: output.scale if f == "png" else 1 for f in output.format},
            "none": {f: 0 if f == "png" else "NaN" for f in output.format},
            "range": [NEAR, self.parameters.render.max_depth],
            "camera": {
                "name": stream.name,
                **stream.camera.as_dict(),
                "T_camera_lidar": stream.T_camera_lidar.tolist(),
                "distortion_of_images": stream.distortion_coefficients,
            },
            "layers": list(output.layers),
            "pixels": "integer coordinates are pixel centres (OpenCV)",
            "docdepth": __version__,
            "parameters": self.parameters.model_dump(mode="json"),
            "maps": {
                stream.names[k]: {"time_ns": int(stream.times[k]), "coverage": round(share, 6)}
                for k, share in sorted(self.coverage.items())
            },
        }
        content = json.dumps(description, indent=1).encode()
        path = self.run.path / "depth" / self.folder / DESCRIPTION
        key = {"render": self.key, **self.layers_key} if complete else {"incomplete": self.key}
        self.run.write(path, content, key)


def _share_with_depth(depth: NDArray[np.float32]) -> float:
    return float(np.isfinite(depth).mean())


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
