"""Poses, labels and depth of a run, a recording or a file, in the formats of other tools."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docdepth.concurrency import Progress, null_progress
from docdepth.datasets import Dataset, open_dataset, usable_points
from docdepth.errors import ConfigError, DatasetError
from docdepth.geometry.ground_plane import level_turn
from docdepth.geometry.lidar_frame import LidarFrame
from docdepth.geometry.points import DYNAMIC, STATIC
from docdepth.geometry.se3 import inverse, matrix_to_quaternion, transform_points
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.atomic import new_output, write_atomically
from docdepth.io.depth import PNG_SCALE, maps_in, read_depth, write_depth
from docdepth.io.frames import write_trajectory
from docdepth.io.labels import classes_of_labels, write_labels
from docdepth.io.pcd import write_pcd
from docdepth.io.poses import POSE_FORMATS, read_timed_poses, write_kitti, write_tum
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline.cameras import place_for_poses
from docdepth.pipeline.plan import require
from docdepth.pipeline.run_inputs import open_recording

DEPTH_FORMATS = ("proj_depth",)
"""Layouts of depth maps that :func:`~.convert.convert` writes."""

INSIDE = Path("proj_depth") / "groundtruth"
"""Where in a drive KITTI keeps its depth maps, a folder a camera."""


def write_release(run: RunFolder, output: Path, progress: Progress = null_progress) -> int:
    """Write the depth maps of all recorded cameras of a run as KITTI releases them.

    PNG of 16 bits, metres x 256, 0 where there is no depth.

    Parameters
    ----------
    output : Path
        Folder of the release; the drive is a folder in it and must not be there.
    """
    name = (run.recording_path or run.path).absolute().name
    drive = output / name
    recorded = {n: entry for n, entry in run.cameras.items() if entry.virtual is None}
    maps = []
    for camera, entry in recorded.items():
        require(run, f"render {camera}")
        found = maps_in(run.path / "depth" / entry.folder)
        maps += [(camera, image, path) for image, path in found.items()]
    if not maps:
        raise DatasetError(
            f"{run.path} has no depth maps", f"make them: `docdepth.run(..., {str(run.path)!r})`"
        )
    with new_output(drive):
        for done, (camera, image, path) in enumerate(maps, 1):
            file = drive / INSIDE / camera / f"{image}.png"
            write_depth(file, read_depth(path), "png", PNG_SCALE)
            progress("convert", done, len(maps))
    return len(maps)


_POSE_FILES = ("", ".txt", ".tum", ".kitti", ".csv", ".ply", ".npy")


def convert(
    source: Path,
    output: Path,
    to: str,
    dataset: str | None = None,
    camera: str | None = None,
    progress: Progress = null_progress,
) -> int:
    """Write poses into a file, or labels or depth maps into a folder.

    Parameters
    ----------
    source : Path
        A run folder, a recording that has poses or labels, or a file of poses.
    output : Path
        File of poses, or folder of labels; it must not be there. Or folder of KITTI's release, in
        which the drive must not be.
    to : str
        One of :data:`POSE_FORMATS`, :data:`LABEL_FORMATS` or :data:`DEPTH_FORMATS`.
    dataset : str, optional
        Format of the recording; guessed if absent.
    camera : str, optional
        Poses of this camera, as KITTI has them, in place of those of the LiDAR.
    """
    if to in DEPTH_FORMATS:
        if camera is not None:
            raise ConfigError(f"`camera` is for poses; {to} holds the depth of every camera")
        return write_release(RunFolder.open(source), output, progress)
    with new_output(output):
        if to in POSE_FORMATS:
            times, poses = _poses(source, dataset, camera)
            return _write_poses(source, output, to, times, poses)
        if camera is not None:
            raise ConfigError(f"`camera` is for poses; {to} are labels of the LiDAR's points")
        if _is_pose_file(source):
            raise ConfigError(f"{source} is a file; labels are those of a run or a recording")
        sweeps, trajectory, count = _sweeps(source, dataset, to)
        for k, sweep in enumerate(sweeps):
            _write_labels(output, to, sweep, trajectory, k)
            progress("convert", k + 1, count)
        return count


def _is_pose_file(source: Path) -> bool:
    return source.is_file() and source.suffix.lower() in _POSE_FILES


def _poses(
    source: Path, dataset: str | None, camera: str | None
) -> tuple[NDArray[np.int64] | None, NDArray[np.float64]]:
    """Times, where they are known, and poses of the LiDAR or a camera."""
    if _is_pose_file(source):
        if camera is not None:
            raise ConfigError(
                f"{source} does not tell where {camera} sits; convert the run or the recording"
            )
        return read_timed_poses(source)
    recording = open_dataset(source, dataset)
    if recording.poses is None:
        raise DatasetError(
            f"{source} has no poses of its own",
            f"estimate them by `docdepth.run({str(source)!r}, RUN)`, and convert RUN",
        )
    poses = recording.poses
    if camera is None and recording.name == "run":
        poses = poses @ _T_run_lidar(RunFolder.open(recording.path))
    if camera is not None:
        T = _camera_place(recording, camera)
        poses = T @ poses @ inverse(T)
    return recording.times, poses


def _T_run_lidar(run: RunFolder) -> NDArray[np.float64]:
    """From the LiDAR frame of the recording to that of its run, which has z up."""
    T = np.eye(4)
    up = run.manifest.derived.up
    if up:
        T[:3, :3] = level_turn(up)
    return T


def _camera_place(recording: Dataset, name: str) -> NDArray[np.float64]:
    """``T_camera_lidar`` of a camera; a run may have been made of a recording with more cameras."""
    if recording.name == "run":
        run = RunFolder.open(recording.path)
        if run.recording_path is not None and run.recording_path.exists():
            recording = open_recording(run.inputs, run.manifest.derived)
    if name not in recording.cameras:
        known = ", ".join(recording.cameras)
        raise ConfigError(f"{recording.path} has no camera {name!r}; it has {known}")
    return place_for_poses(recording, name)


def _write_poses(
    source: Path,
    output: Path,
    to: str,
    times: NDArray[np.int64] | None,
    poses: NDArray[np.float64],
) -> int:
    output.parent.mkdir(parents=True, exist_ok=True)
    if to == "kitti":
        write_kitti(output, poses)
    elif to == "npy":
        write_atomically(output, lambda stream: np.save(stream, poses))
    elif times is None:
        raise ConfigError(
            f"{source} has no times, which {to} needs; convert the run or the recording, or say "
            "`to='kitti'` or npy"
        )
    elif to == "tum":
        write_tum(output, Trajectory(times, poses))
    else:
        write_trajectory(output, Trajectory(times, poses), np.arange(len(times)))
    return len(poses)


def _sweeps(
    source: Path, dataset: str | None, to: str
) -> tuple[Iterator[LidarFrame], NDArray[np.float64] | None, int]:
    """Sweeps with classes, the poses of the LiDAR, and their number."""
    recording = open_dataset(source, dataset)
    if to == "pcd" and recording.poses is None:
        raise DatasetError(
            f"{source} has no poses of its own, which PCD files keep as VIEWPOINT; convert a run"
        )
    if recording.name == "run":
        run = RunFolder.open(recording.path)
        require(run, "classify")
        frames = (run.classified_frame(k)[0] for k in range(len(recording)))
        return frames, recording.poses, len(recording)
    if recording.labels(0) is None:
        raise DatasetError(
            f"{source} has no labels of its own",
            f"find classes by `docdepth.run({str(source)!r}, RUN)`, and convert RUN",
        )
    return _of_recording(recording), recording.poses, len(recording)


def _of_recording(recording: Dataset) -> Iterator[LidarFrame]:
    for k in range(len(recording)):
        sweep, labels = recording.sweep(k), recording.labels(k)
        if labels is None:
            raise DatasetError(f"{recording.path} has no labels of sweep {sweep.name} (frame {k})")
        rows = np.flatnonzero(usable_points(sweep.points))
        classid, instance = (values[rows] for values in classes_of_labels(labels))
        yield LidarFrame(
            sweep.points[rows],
            rows.astype(np.uint32),
            sweep.name,
            len(labels),
            classid=classid,
            instance=instance,
        )


def _write_labels(
    folder: Path, to: str, record: LidarFrame, poses: NDArray[np.float64] | None, frame: int
) -> None:
    classid = record.classid
    assert classid is not None
    if to == "label":
        write_labels(folder / f"{record.name}.label", record)
    elif to == "classid":
        rows = np.full(record.input_points, STATIC, np.uint16)
        rows[record.index] = classid
        write_atomically(folder / f"{record.name}.npy", lambda stream: np.save(stream, rows))
    elif poses is not None:
        # From the first pose on, since float32 cannot hold the coordinates of a country.
        T = inverse(poses[0]) @ poses[frame]
        points = transform_points(T, record.points.astype(np.float64)).astype(np.float32)
        x, y, z, w = matrix_to_quaternion(T[:3, :3])
        moves = (classid >= DYNAMIC).astype(np.float32)
        file = folder / "pcd" / f"{frame:06d}.pcd"
        write_pcd(file, points, moves, np.array([*T[:3, 3], w, x, y, z]))
