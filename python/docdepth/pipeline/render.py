"""The last stage of a run: a depth map for every image of its cameras, and pictures of them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from docdepth import __version__
from docdepth.config import OutputParameters, Parameters
from docdepth.datasets.base import CameraStream
from docdepth.errors import DatasetError
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.atomic import write_atomically
from docdepth.io.depth import DESCRIPTION, FORMATS, check_format, encode_depth, read_depth
from docdepth.io.ply import write_trajectory
from docdepth.io.run_folder import RunFolder, stage_key
from docdepth.pipeline.stage import (
    Progress,
    Stopwatch,
    finish_stage,
    progress_callback,
    stage_is_done,
)
from docdepth.render import depth_map as render
from docdepth.render.backends import Renderer
from docdepth.render.frame import Frame
from docdepth.render.layers import check_layers
from docdepth.render.layers import layers as layers_of
from docdepth.render.selection import needed_frames
from docdepth.visualization import pictures as visualize
from docdepth.visualization.report import write_index

_FOLDERS = ("depth", "report", "layers")


@dataclass(frozen=True)
class _Maps:
    """The files of one camera: ``depth/NAME.png``, or ``depth/CAMERA/NAME.png`` among several."""

    run: RunFolder
    stream: CameraStream
    folder: str
    parameters: Parameters

    @property
    def output(self) -> OutputParameters:
        return self.parameters.output

    def path(self, kind: str, k: int, suffix: str) -> Path:
        return self.run.path / kind / self.folder / f"{self.stream.names[k]}{suffix}"

    def depths(self, k: int) -> dict[str, Path]:
        """By format; the first is read for its coverage."""
        return {f: self.path("depth", k, FORMATS[f]) for f in self.output.format}

    def are_whole(self, k: int) -> bool:
        layers = [self.path("layers", k, ".npz")] if self.output.layers else []
        return all(path.is_file() for path in [*layers, *self.depths(k).values()])

    def coverage(self, k: int) -> float:
        first, *_ = self.depths(k).items()
        return float(np.isfinite(read_depth(first[1], self.output.scale)).mean())

    def write(self, k: int, depth: NDArray[np.float32], layers: dict[str, NDArray[Any]]) -> None:
        """The picture first: a map that is there has all that belongs to it."""
        picture = visualize.overlay(depth, rectified_image(self.stream, k))
        _write_image(self.path("report", k, ".jpg"), picture)
        if layers:
            path = self.path("layers", k, ".npz")
            write_atomically(path, lambda out: np.savez_compressed(out, **layers))  # type: ignore[arg-type]
        for format, path in self.depths(k).items():
            content = encode_depth(depth, format, self.output.scale)
            write_atomically(path, lambda out, content=content: out.write(content))  # type: ignore[misc]

    def describe(self, coverage: dict[int, float]) -> None:
        """What is to be known of these maps, into ``depth.json`` beside them."""
        stream, output = self.stream, self.output
        text = {
            "depth": "z along the optical axis of the rectified camera; file = metres x scale",
            "unit": "m",
            "scale": {f: output.scale if f == "png" else 1 for f in output.format},
            "none": {f: 0 if f == "png" else "NaN" for f in output.format},
            "range": [render.NEAR, self.parameters.render.max_depth],
            "camera": {
                "name": stream.name,
                "K": stream.camera.K.tolist(),
                "size": [stream.camera.width, stream.camera.height],
                "T_camera_lidar": stream.T_camera_lidar.tolist(),
                "distortion_of_images": _coefficients(stream),
            },
            "layers": list(output.layers),
            "pixels": "integer coordinates are pixel centres (OpenCV)",
            "docdepth": __version__,
            "parameters": self.parameters.model_dump(mode="json"),
            "maps": {
                stream.names[k]: {"time_ns": int(stream.times[k]), "coverage": round(share, 6)}
                for k, share in sorted(coverage.items())
            },
        }
        content = json.dumps(text, indent=1).encode()
        path = self.run.path / "depth" / self.folder / DESCRIPTION
        write_atomically(path, lambda out: out.write(content))


def run_render(
    run: RunFolder,
    streams: CameraStream | Sequence[CameraStream],
    threads: int = 0,
    progress: Progress | None = None,
    renderer: Renderer | None = None,
    stage: str = "render",
    parameters: Parameters | None = None,
) -> list[str]:
    """Depth maps for every image into ``depth/``; layers and pictures into folders beside it.

    Parameters
    ----------
    streams : CameraStream or sequence of CameraStream
        The cameras. Several have folders of their own, named after them.
    renderer : Renderer, optional
        What draws; the processor if absent. All draw the same.
    stage : str
        Name in run.yaml. Cameras of another name than ``render`` come beside those of the run,
        each in a folder of its own.
    parameters : Parameters, optional
        Those of the run if absent.

    Returns
    -------
    list of str
        Images before the first or after the last sweep, which get no depth map.
    """
    streams = [streams] if isinstance(streams, CameraStream) else list(streams)
    apart = len(streams) > 1 or stage != "render"
    parameters = parameters or run.parameters
    drawing, output = parameters.render, parameters.output
    for format in output.format:
        check_format(format, output.scale, drawing.max_depth)
    check_layers(output.layers, drawing)
    trajectory = run.trajectory()
    key = stage_key(
        run.stage("classify").get("key"),
        drawing.model_dump(),
        output.model_dump(),
        [_identity(stream) for stream in streams],
    )
    maps = [_Maps(run, s, s.name if apart else "", parameters) for s in streams]
    inside = [_inside(trajectory, stream) for stream in streams]
    left_out = [
        f"{m.folder}/{name}" if apart else name
        for m, ok in zip(maps, inside, strict=True)
        for name, seen in zip(m.stream.names, ok, strict=True)
        if not seen
    ]
    if stage_is_done(run, stage, key):
        return left_out
    before = run.stage(stage)
    folders = [m.folder for m in maps]
    if before.get("key") != key:
        old = set(before.get("folders", [""] if stage == "render" else []))
        for folder in old | set(folders):
            for kind in _FOLDERS:
                run.clear(f"{kind}/{folder}")
        for folder in old - set(folders):
            run.forget_calibration(folder)
    watch = Stopwatch()
    renderer = renderer or Renderer()
    run.set_stage(
        stage,
        state="running",
        key=key,
        cameras=[s.name for s in streams],
        folders=folders,
        left_out=left_out,
        renderer=f"{renderer.name}: {renderer.description}",
    )
    for m, ok in zip(maps, inside, strict=True):
        stream, chosen = m.stream, np.flatnonzero(ok)
        run.write_calibration(stream.camera, stream.T_camera_lidar, _coefficients(stream), m.folder)
        times = stream.times[chosen]
        shutter = Trajectory(times, trajectory.interpolate(times))
        write_trajectory(run.calibration_folder(m.folder) / "traj_camera.ply", shutter, chosen)

    coverage: list[dict[int, float]] = [{} for _ in maps]
    jobs: list[tuple[int, int, int]] = []  # time, camera, image; cameras share sweeps of one time
    for c, (m, ok) in enumerate(zip(maps, inside, strict=True)):
        for k in (int(k) for k in np.flatnonzero(ok)):
            if m.are_whole(k):
                coverage[c][k] = m.coverage(k)
            else:
                jobs.append((int(m.stream.times[k]), c, k))
        m.describe(coverage[c])
    jobs.sort()

    def load(index: int) -> Frame:
        return load_frame(run, trajectory, index, parameters, watch)

    def write(m: _Maps, k: int, depth: NDArray[np.float32], more: dict[str, NDArray[Any]]) -> None:
        with watch("write"):
            m.write(k, depth, more)

    whole = sum(map(len, coverage))
    tell = progress_callback(progress, stage)
    tell(whole, whole + len(jobs))
    made: dict[int, Future[Frame]] = {}
    # Frames of the next image are made, and the last image is written, while one is drawn.
    with ThreadPoolExecutor(2) as pool:
        pending: Future[None] | None = None
        for done, (stamp, c, k) in enumerate(jobs):
            ahead = {t for t, _, _ in jobs[done : done + 2]}
            needed = set().union(*(needed_frames(trajectory, t, drawing) for t in ahead))
            made = {i: made[i] for i in made if i in needed}
            for i in sorted(needed - made.keys()):
                made[i] = pool.submit(load, i)
            for i in needed_frames(trajectory, stamp, drawing):
                with watch("wait for frames"):
                    made[i].result()
            scene = (
                streams[c].camera,
                streams[c].T_camera_lidar,
                trajectory,
                stamp,
                lambda i, made=made: made[i].result(),
                drawing,
                threads,
            )
            with watch("draw"):
                depth = render.render(*scene, renderer)
            more: dict[str, NDArray[Any]] = {}
            if output.layers:
                with watch("layers"):
                    more = layers_of(output.layers, depth, *scene)
            coverage[c][k] = float(np.isfinite(depth).mean())
            if pending:
                pending.result()
            pending = pool.submit(write, maps[c], k, depth, more)
            tell(whole + done + 1, whole + len(jobs))
        if pending:
            pending.result()
    for m, shares in zip(maps, coverage, strict=True):
        m.describe(shares)
    every = [share for shares in coverage for share in shares.values()]
    finish_stage(run, stage, watch, len(jobs), density=float(np.mean(every)))
    write_index(run)
    return left_out


def load_frame(
    run: RunFolder,
    trajectory: Trajectory,
    index: int,
    parameters: Parameters,
    watch: Stopwatch | None = None,
) -> Frame:
    """A classified sweep of a run, made ready to be drawn.

    Raises
    ------
    RunError
        It has no classes.
    """
    watch = watch or Stopwatch()
    with watch("read"):
        record, classid = run.classified_frame(index)
    with watch("frames"):
        return Frame(
            record.points,
            classid,
            parameters.render,
            record.time_offset,
            run.sensor_rig(record),
            trajectory.velocity(index),
        )


def _inside(trajectory: Trajectory, stream: CameraStream) -> NDArray[np.bool_]:
    """Which images were taken between the first and the last sweep."""
    inside = trajectory.covers(stream.times)
    if not inside.any():
        raise DatasetError(
            f"none of the {len(stream.names)} images of {stream.name} lies between the first and "
            "the last sweep; are camera and LiDAR on one clock? See --camera-times"
        )
    return inside


def _identity(stream: CameraStream) -> list[Any]:
    """All of a camera that its maps depend on."""
    camera = stream.camera
    return [
        stream.name,
        camera.K.tolist(),
        [camera.width, camera.height],
        _coefficients(stream),
        stream.T_camera_lidar.tolist(),
        stream.names,
        stream.times.tolist(),
    ]


def _coefficients(stream: CameraStream) -> list[float]:
    return [0.0] * 5 if stream.distortion is None else stream.distortion.tolist()


def rectified_image(stream: CameraStream, k: int) -> NDArray[np.uint8] | None:
    """Image ``k`` of a camera as its depth map sees it, None where there is none.

    Raises
    ------
    DatasetError
        It cannot be read, or is not of the camera's size.
    """
    if not stream.images:
        return None
    image = cv2.imread(str(stream.images[k]), cv2.IMREAD_COLOR)
    if image is None:
        raise DatasetError(f"{stream.images[k]} is not a readable image; replace or remove it")
    if image.shape[:2] != (stream.camera.height, stream.camera.width):
        raise DatasetError(
            f"{stream.images[k]} is {image.shape[1]}x{image.shape[0]} pixels, the calibration is "
            f"for {stream.camera.width}x{stream.camera.height}; give the right --image-size"
        )
    if stream.distortion is not None:
        image = cv2.undistort(image, stream.camera.K, stream.distortion)
    return np.asarray(image, np.uint8)


def _write_image(path: Path, image: NDArray[np.uint8]) -> None:
    _, encoded = cv2.imencode(path.suffix, image, [cv2.IMWRITE_JPEG_QUALITY, 90])
    write_atomically(path, lambda stream: stream.write(encoded.tobytes()))
