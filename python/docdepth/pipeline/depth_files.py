"""The files of a camera's depth maps in a run folder."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from docdepth import __version__
from docdepth.config import Parameters
from docdepth.datasets.base import CameraStream
from docdepth.io.atomic import write_atomically
from docdepth.io.depth import DESCRIPTION, FORMATS, encode_depth, read_depth
from docdepth.io.run_folder import RunFolder
from docdepth.render.depth_map import NEAR
from docdepth.visualization.pictures import overlay

FOLDERS = ("depth", "report", "layers")


@dataclass(frozen=True)
class DepthFiles:
    """The files of one camera: depth maps, layers, pictures and their description.

    Attributes
    ----------
    run : RunFolder
    stream : CameraStream
    folder : str
        Its folder in ``depth/``, ``layers/`` and ``report/``; empty for the only camera of a run.
    parameters : Parameters
    coverage : dict of int to float
        Share of pixels with depth of each image that is done.
    """

    run: RunFolder
    stream: CameraStream
    folder: str
    parameters: Parameters
    coverage: dict[int, float] = field(default_factory=dict)

    def find_done(self, index: int) -> bool:
        """Whether all files of an image are there; notes its coverage."""
        depths = self._depths(index)
        layers = [self._path("layers", index, ".npz")] if self.parameters.output.layers else []
        if not all(path.is_file() for path in [*layers, *depths.values()]):
            return False
        depth = read_depth(next(iter(depths.values())), self.parameters.output.scale)
        self.coverage[index] = _share_with_depth(depth)
        return True

    def write(
        self, index: int, depth: NDArray[np.float32], layers: dict[str, NDArray[Any]]
    ) -> None:
        """Write all files of an image; the depth map last, so that it marks the image as done."""
        picture = overlay(depth, self.stream.rectified_image(index))
        _write_image(self._path("report", index, ".jpg"), picture)
        if layers:
            path = self._path("layers", index, ".npz")
            write_atomically(path, lambda out: np.savez_compressed(out, **layers))  # type: ignore[arg-type]
        for format, path in self._depths(index).items():
            content = encode_depth(depth, format, self.parameters.output.scale)
            write_atomically(path, lambda out, content=content: out.write(content))  # type: ignore[misc]
        self.coverage[index] = _share_with_depth(depth)

    def describe(self) -> None:
        """Write ``depth.json``: unit, camera, parameters, and time and coverage of each map."""
        stream, output = self.stream, self.parameters.output
        description = {
            "depth": "z along the optical axis of the rectified camera; file = metres x scale",
            "unit": "m",
            "scale": {f: output.scale if f == "png" else 1 for f in output.format},
            "none": {f: 0 if f == "png" else "NaN" for f in output.format},
            "range": [NEAR, self.parameters.render.max_depth],
            "camera": {
                "name": stream.name,
                "K": stream.camera.K.tolist(),
                "size": [stream.camera.width, stream.camera.height],
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
        write_atomically(path, lambda out: out.write(content))

    def _path(self, kind: str, index: int, suffix: str) -> Path:
        return self.run.path / kind / self.folder / f"{self.stream.names[index]}{suffix}"

    def _depths(self, index: int) -> dict[str, Path]:
        """By format."""
        return {f: self._path("depth", index, FORMATS[f]) for f in self.parameters.output.format}


def _share_with_depth(depth: NDArray[np.float32]) -> float:
    return float(np.isfinite(depth).mean())


def _write_image(path: Path, image: NDArray[np.uint8]) -> None:
    _, encoded = cv2.imencode(path.suffix, image, [cv2.IMWRITE_JPEG_QUALITY, 90])
    write_atomically(path, lambda stream: stream.write(encoded.tobytes()))
