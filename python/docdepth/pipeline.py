"""The stages of a run, one after the other: each reads what the one before wrote.

Every stage can be killed and goes on where it stopped; what is done is known from the files.
"""

from __future__ import annotations

import logging
import resource
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from threading import Lock
from typing import Any, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from docdepth import dynamics, render, visualize
from docdepth.backends import Renderer
from docdepth.datasets.base import CameraStream, Dataset, usable_points
from docdepth.errors import DatasetError, RunError
from docdepth.ground import GroundMap, chunks
from docdepth.io.atomic import write_atomically
from docdepth.io.depth import encode_png, read_depth
from docdepth.io.ply import FrameRecord, write_trajectory
from docdepth.io.run_folder import RunFolder, stage_key
from docdepth.odometry import odometry
from docdepth.surface import Surface
from docdepth.trajectory import Trajectory

log = logging.getLogger(__name__)

Progress = Callable[[str, int, int], None]
"""Called with the stage, how many frames are done and how many there are."""

_MOVING, _STATIC = 251, 9  # SemanticKITTI's moving-object labels
T = TypeVar("T")


class Stopwatch:
    """Seconds spent by name, for the profile in run.yaml; names may run side by side."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._lock = Lock()
        self._start = time.perf_counter()

    def wall(self) -> float:
        """Seconds since the stage began."""
        return time.perf_counter() - self._start

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        start = time.perf_counter()
        try:
            yield
        finally:
            spent = time.perf_counter() - start
            with self._lock:
                self.seconds[name] = self.seconds.get(name, 0.0) + spent


def run_odometry(
    run: RunFolder,
    dataset: Dataset,
    poses: NDArray[np.float64] | None = None,
    progress: Progress | None = None,
) -> None:
    """Poses of every sweep, and the sweeps deskewed to their stamp, into ``frames/``.

    Parameters
    ----------
    poses : ndarray of float64, shape (n, 4, 4), optional
        ``T_world_lidar`` of another SLAM; registered here when there are none.

    Raises
    ------
    DatasetError
        A sweep is damaged or empty.
    """
    parameters = run.parameters.odometry
    key = stage_key(run.manifest["source"], parameters.model_dump())
    if _is_done(run, "odometry", key):
        return
    watch, total = Stopwatch(), len(dataset)
    run.set_stage("odometry", state="running", key=key)
    tell = _teller(progress, "odometry")
    with watch("poses"):
        checkpoint = run.path / ".odometry" / key

        def registered(done: int, total: int, what: str) -> None:
            log.debug("%s", what)
            if progress:
                progress("register", done, total)

        estimate = odometry(dataset, parameters, poses, registered, checkpoint)
    write_trajectory(run.trajectory_path, estimate.trajectory, np.arange(total))
    period = np.float32(np.median(np.diff(dataset.times)) * 1e-9 if total > 1 else 0)
    worked = 0
    for index in range(total):
        if run.frame_key(index).get("odometry") != key:
            worked += 1
            with watch("deskew"):
                sweep = dataset.sweep(index)
                points = estimate.points(index)
                usable = usable_points(points)
            if not usable.any():
                raise DatasetError(
                    f"{dataset.path}: sweep {sweep.name} (frame {index}) holds no usable point; "
                    "leave this frame out of the recording"
                )
            record = FrameRecord(
                np.ascontiguousarray(points[usable]),
                np.flatnonzero(usable).astype(np.uint32),
                sweep.name,
                len(points),
                {"odometry": key},
                late=None if sweep.fraction is None else period * sweep.fraction[usable],
            )
            with watch("write"):
                run.write_frame(index, record)
        tell(index + 1, total)
    _finish(run, "odometry", watch, worked)


def run_classify(run: RunFolder, threads: int = 0, progress: Progress | None = None) -> None:
    """Ground, votes and class of every point into ``frames/`` and ``labels/``.

    Parameters
    ----------
    threads : int
        0 takes every core.
    """
    parameters = run.parameters
    trajectory = run.trajectory()
    key = stage_key(
        run.stage("odometry").get("key"),
        parameters.ground.model_dump(),
        parameters.surface.model_dump(),
        parameters.dynamics.model_dump(),
    )
    if _is_done(run, "classify", key):
        return
    watch, total = Stopwatch(), len(trajectory)
    run.set_stage("classify", state="running", key=key)
    grounds = run.path / ".ground"
    _grow_ground(run, trajectory, grounds, watch, threads, _teller(progress, "ground"))

    def ground_of(index: int, count: int) -> NDArray[np.bool_]:
        return np.unpackbits(np.load(grounds / f"{index:06d}.npy"), count=count).astype(bool)

    over_time = dynamics.carries_evidence(parameters.dynamics)
    local = dynamics.poses_near_start(trajectory)
    seen = run.path / ".objects" / key

    def is_voted(index: int) -> bool:
        whole = not over_time or (seen / f"{index:06d}.npz").is_file()
        return whole and run.frame_key(index).get("classify") == key

    def finish(
        index: int,
        record: FrameRecord,
        ground: NDArray[np.bool_],
        votes: dynamics.Votes,
        surface: Surface | None,
    ) -> None:
        points, objects = record.points, None
        with watch("objects"):
            if over_time:
                objects = dynamics.connect_objects(points, ground, surface, parameters.dynamics)
            classid = dynamics.classify(
                ground, votes, parameters.dynamics, points, surface, objects
            )
        if objects is not None:
            with watch("sightings"):
                sighting = dynamics.Sighting(points, ground, objects, classid, local[index])
            with watch("write"):
                _write_arrays(seen / f"{index:06d}.npz", objects=objects, **sighting.arrays)
        with watch("write"):
            _write_classified(run, index, replace(record, classid=classid))

    voters = dynamics.key_frames(trajectory, parameters.dynamics)
    asked: dict[int, dynamics.KeyFrame] = {}
    surfaces: dict[int, Surface | None] = {}  # of key frames whose own turn is still to come

    def surface_of(k: int, points: NDArray[np.float32]) -> Surface | None:
        if k not in surfaces:
            with watch("surfaces"):
                surfaces[k] = dynamics.surface_for(points, parameters.dynamics, parameters.surface)
        return surfaces[k]

    tell = _teller(progress, "classify")
    worked = 0
    with ThreadPoolExecutor(1) as writer:
        pending: Future[None] | None = None
        for index in range(total):
            if not is_voted(index):
                worked += 1
                wanted = voters[index]
                asked = {k: asked[k] for k in asked if k in set(wanted.tolist())}
                for k in (int(k) for k in wanted if int(k) not in asked):
                    with watch("read"):
                        record = run.frame(k)
                        ground = ground_of(k, len(record.points))
                    surface = surface_of(k, record.points)
                    with watch("key frames"):
                        asked[k] = dynamics.KeyFrame(
                            record.points, ground, parameters.dynamics, surface
                        )
                with watch("read"):
                    record = run.frame(index)
                    ground = ground_of(index, len(record.points))
                with watch("vote"):
                    votes = dynamics.vote(
                        record.points,
                        ground,
                        trajectory.poses[index],
                        [asked[int(k)] for k in wanted],
                        trajectory.poses[wanted],
                        parameters.dynamics,
                        threads,
                    )
                surface = surface_of(index, record.points)
                surfaces = {k: surfaces[k] for k in surfaces if k > index}
                record = replace(
                    record,
                    key={**record.key, "classify": key},
                    votes_static=votes.static,
                    votes_dynamic=votes.dynamic,
                )
                # The next sweep is voted on meanwhile.
                with watch("wait for objects and files"):
                    if pending:
                        pending.result()
                    pending = writer.submit(finish, index, record, ground, votes, surface)
            tell(index + 1, total)
        if pending:
            pending.result()
    if over_time:
        _carry_evidence(run, trajectory, seen, watch, threads)
        shutil.rmtree(seen.parent)
    for path in grounds.glob("*"):
        path.unlink()
    _finish(run, "classify", watch, worked)


def run_render(
    run: RunFolder,
    stream: CameraStream,
    threads: int = 0,
    progress: Progress | None = None,
    renderer: Renderer | None = None,
) -> list[str]:
    """A depth map for every image of a camera into ``depth/``, pictures into ``report/``.

    Parameters
    ----------
    renderer : Renderer, optional
        What draws; the processor if absent. All draw the same.

    Returns
    -------
    list of str
        Images before the first or after the last sweep, which get no depth map.
    """
    parameters = run.parameters.render
    trajectory = run.trajectory()
    inside = trajectory.covers(stream.times)
    left_out = [name for name, ok in zip(stream.names, inside, strict=True) if not ok]
    chosen = np.flatnonzero(inside)
    if not len(chosen):
        raise DatasetError(
            f"none of the {len(stream.names)} images of {stream.name} lies between the first and "
            "the last sweep; are camera and LiDAR on one clock? See --camera-times"
        )
    camera = stream.camera
    key = stage_key(
        run.stage("classify").get("key"),
        run.parameters.surface.model_dump(),
        parameters.model_dump(),
        camera.K.tolist(),
        [camera.width, camera.height],
        stream.T_camera_lidar.tolist(),
        stream.names,
        stream.times.tolist(),
    )
    if _is_done(run, "render", key):
        return left_out
    if run.stage("render").get("key") != key:
        run.clear("depth")
        run.clear("report")
    watch, total = Stopwatch(), len(chosen)
    renderer = renderer or Renderer()
    run.set_stage(
        "render",
        state="running",
        key=key,
        camera=stream.name,
        left_out=left_out,
        renderer=f"{renderer.name}: {renderer.description}",
    )
    run.write_calibration(camera, stream.T_camera_lidar)
    times = stream.times[chosen]
    shutter = Trajectory(times, trajectory.interpolate(times))
    write_trajectory(run.path / "traj_camera.ply", shutter, chosen)

    def load(index: int) -> render.Frame:
        with watch("read"):
            record = run.frame(index)
        if record.classid is None:
            raise RunError(f"frame {index} of {run.path} has no classes; run: docdepth classify")
        with watch("frames"):
            return render.Frame(
                record.points, record.classid, parameters, run.parameters.surface, record.late
            )

    def write(k: int, depth: NDArray[np.float32]) -> None:
        with watch("write"):
            picture = visualize.overlay(depth, _image(stream, k))
            _write_image(run.path / "report" / f"{stream.names[k]}.jpg", picture)
            png = encode_png(depth)
            write_atomically(paths[k], lambda out: out.write(png))

    paths = {int(k): run.path / "depth" / f"{stream.names[k]}.png" for k in chosen}
    left = [
        (int(k), int(t)) for k, t in zip(chosen, times, strict=True) if not paths[int(k)].is_file()
    ]
    whole = [path for path in paths.values() if path.is_file()]
    densities = [float((read_depth(path) > 0).mean()) for path in whole]
    tell = _teller(progress, "render")
    tell(len(whole), total)
    made: dict[int, Future[render.Frame]] = {}
    # Frames of the next image are made, and the last image is written, while one is drawn.
    with ThreadPoolExecutor(2) as pool:
        pending: Future[None] | None = None
        for done, (k, stamp) in enumerate(left):
            ahead = [t for _, t in left[done : done + 2]]
            needed = set().union(*(render.needed_frames(trajectory, t, parameters) for t in ahead))
            made = {i: made[i] for i in made if i in needed}
            for i in sorted(needed - made.keys()):
                made[i] = pool.submit(load, i)
            for i in render.needed_frames(trajectory, stamp, parameters):
                with watch("wait for frames"):
                    made[i].result()
            with watch("draw"):
                depth = render.render(
                    camera,
                    stream.T_camera_lidar,
                    trajectory,
                    stamp,
                    lambda i, made=made: made[i].result(),  # type: ignore[misc]
                    parameters,
                    threads,
                    renderer,
                )
            densities.append(float(np.isfinite(depth).mean()))
            if pending:
                pending.result()
            pending = pool.submit(write, k, depth)
            tell(len(whole) + done + 1, total)
        if pending:
            pending.result()
    density = {"density": float(np.mean(densities))} if densities else {}
    _finish(run, "render", watch, len(left), **density)
    return left_out


def _grow_ground(
    run: RunFolder,
    trajectory: Trajectory,
    folder: Path,
    watch: Stopwatch,
    threads: int,
    tell: Callable[[int, int], None],
) -> None:
    """Ground labels of every frame as packed bits, a chunk of path length at a time."""
    parameters = run.parameters.ground
    key = stage_key(run.stage("odometry").get("key"), parameters.model_dump())
    marker = folder / "key"
    if not (marker.is_file() and marker.read_text() == key):
        for path in folder.glob("*"):
            path.unlink()
        write_atomically(marker, lambda stream: stream.write(key.encode()))
    done = 0
    for frames, merged in chunks(trajectory, parameters):
        paths = {i: folder / f"{i:06d}.npy" for i in frames}
        if not all(path.is_file() for path in paths.values()):
            ground_map = GroundMap(parameters, threads)
            for step, index in enumerate(merged):
                with watch("read"):
                    record = run.frame(index)
                with watch("ground: insert"):
                    ground_map.insert(record.points, trajectory.poses[index])
                tell(done + len(paths) * step // (2 * len(merged)), len(trajectory))
            with watch("ground: grow"):
                ground_map.grow()
            for step, (index, path) in enumerate(paths.items()):
                with watch("read"):
                    record = run.frame(index)
                with watch("ground: label"):
                    bits = np.packbits(ground_map.label(record.points, trajectory.poses[index]))
                write_atomically(path, lambda out, bits=bits: np.save(out, bits))  # type: ignore[misc]
                tell(done + (len(paths) + step) // 2, len(trajectory))
        done += len(frames)
    tell(len(trajectory), len(trajectory))


def _carry_evidence(
    run: RunFolder, trajectory: Trajectory, seen: Path, watch: Stopwatch, threads: int
) -> None:
    """Classes of objects that move at another time; the same again when it was interrupted."""
    sightings = []
    for index in range(len(trajectory)):
        with watch("read"), np.load(seen / f"{index:06d}.npz") as arrays:
            sightings.append(dynamics.Sighting.of(arrays))
    with watch("tracks"):
        carried = dynamics.follow(sightings, trajectory.times, run.parameters.dynamics, threads)
    for index, found in enumerate(carried):
        if not len(found):
            continue
        with watch("read"):
            record = run.frame(index)
            with np.load(seen / f"{index:06d}.npz") as arrays:
                moving = np.isin(arrays["objects"], found)
        assert record.classid is not None
        classid = np.where(moving, np.uint16(dynamics.DYNAMIC), record.classid)
        with watch("write"):
            _write_classified(run, index, replace(record, classid=classid))


def _write_arrays(path: Path, **arrays: NDArray[Any]) -> None:
    write_atomically(path, lambda out: np.savez(out, allow_pickle=False, **arrays))


def _write_classified(run: RunFolder, index: int, record: FrameRecord) -> None:
    assert record.classid is not None
    labels = np.full(record.input_points, _STATIC, np.uint32)
    labels[record.index[record.classid >= 100]] = _MOVING
    path = run.path / "labels" / f"{record.name}.label"
    write_atomically(path, lambda stream: stream.write(labels.tobytes()))
    # Last, because its key says that this frame is done.
    run.write_frame(index, record)


def _image(stream: CameraStream, k: int) -> NDArray[np.uint8] | None:
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
    return np.asarray(image, np.uint8)


def _write_image(path: Path, image: NDArray[np.uint8]) -> None:
    _, encoded = cv2.imencode(path.suffix, image, [cv2.IMWRITE_JPEG_QUALITY, 90])
    write_atomically(path, lambda stream: stream.write(encoded.tobytes()))


def _is_done(run: RunFolder, stage: str, key: str) -> bool:
    state = run.stage(stage)
    return bool(state.get("state") == "done" and state.get("key") == key)


def _finish(run: RunFolder, stage: str, watch: Stopwatch, frames: int, **more: float) -> None:
    """Mark a stage as done; ``frames`` were worked on in these seconds, others before."""
    before = run.stage(stage)
    kilobytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    peak = kilobytes // 1024 if sys.platform != "darwin" else kilobytes // 1024**2
    run.set_stage(
        stage,
        state="done",
        frames=frames,
        wall_seconds=round(watch.wall(), 3),
        seconds={name: round(s, 3) for name, s in watch.seconds.items()},
        peak_memory_mb=max(peak, before.get("peak_memory_mb", 0)),
        **more,
    )


def _teller(progress: Progress | None, stage: str) -> Callable[[int, int], None]:
    def tell(done: int, total: int) -> None:
        if progress:
            progress(stage, done, total)

    return tell
