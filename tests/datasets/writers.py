"""Writes the made-up drive in each format, by the format's own library where there is one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from kitti_drives import R_RECT, S_RECT, P, T_camera0_lidar, date, numbers, write_velodyne
from made_up import DISTORTION, DRIVE, K

from docdepth.io.poses import write_kitti


@dataclass(frozen=True)
class Written:
    """A recording of the made-up drive.

    Attributes
    ----------
    path : Path
    damage : callable or None
        Breaks sweep 2; returns the file that the error has to name. None where a part that is
        missing cannot be told from one that was never there.
    has : set of str
        What the format keeps, of intensity, ring, times, poses, camera.
    tolerance : float
        Metres to which points are kept; 0 is to the bit.
    clock : callable
        What the format makes of stamps; None: it keeps them to half a microsecond.
    lens : bool
        Images keep their distortion.
    reordered : bool
        Points come in another order: each LiDAR's by themselves.
    points : bool
        Points are those of the drive; captures have others.
    """

    path: Path
    damage: Callable[[], Path] | None
    has: set[str] = field(default_factory=lambda: {"intensity", "ring", "times", "poses", "camera"})
    tolerance: float = 0.0
    clock: Callable[[np.ndarray], np.ndarray] | None = lambda times: times
    lens: bool = True
    reordered: bool = False
    points: bool = True


WRITERS: dict[str, tuple[str, Callable[[Path], Written]]] = {}
"""By the name of a test: the name of the format, and what writes it."""


def writes(name: str, format: str):
    def register(function):
        WRITERS[name] = (format, function)
        return function

    return register


def truncate(file: Path, size: int = 999) -> Path:
    file.write_bytes(file.read_bytes()[:-size])
    return file


def seconds(times: np.ndarray) -> str:
    return "".join(f"{t // 10**9}.{t % 10**9:09d}\n" for t in times.tolist())


def doubles(times: np.ndarray) -> np.ndarray:
    return np.round(times * 1e-9 * 1e9).astype(np.int64)


def _tenths(times: np.ndarray) -> np.ndarray:
    return np.round((17_000_000_000 + np.arange(len(times))) * 1e8).astype(np.int64)


def write_images(folder: Path) -> list[Path]:
    folder.mkdir(parents=True)
    files = [folder / f"{k:06d}.png" for k in range(DRIVE.images_count)]
    for k, file in enumerate(files):
        cv2.imwrite(str(file), DRIVE.image(k))
    return files


# ---- KITTI


@writes("kitti_odometry", "kitti_odometry")
def _odometry(root: Path, labels: bool = False) -> Written:
    sequence = root / "sequences" / "03"
    velodyne = write_velodyne(sequence / "velodyne", 6)
    for folder in ("point_times", *(["labels"] if labels else [])):
        (sequence / folder).mkdir()
    for k in range(DRIVE.count):
        rows = DRIVE.rows(k)
        rows["share"].tofile(sequence / "point_times" / f"{k:06d}.bin")
        if labels:
            np.full(len(rows), 9, "<u4").tofile(sequence / "labels" / f"{k:06d}.label")
    (sequence / "docdepth.yaml").write_text("motion_compensated: false\n")
    (sequence / "times.txt").write_text(seconds(DRIVE.times))
    write_images(sequence / "image_2")
    (sequence / "image_2" / "times.txt").write_text(seconds(DRIVE.image_times))
    (sequence / "image_2" / "distortion.txt").write_text(numbers(DISTORTION))
    T = T_camera0_lidar(rectified=True)
    (sequence / "calib.txt").write_text(f"P2: {numbers(P)}\nTr: {numbers(T[:3])}\n")
    poses = root / "poses" / "03.txt" if labels else sequence / "poses.txt"
    poses.parent.mkdir(exist_ok=True)
    write_kitti(poses, T @ DRIVE.poses @ np.linalg.inv(T))
    kept = {"intensity", "times", "camera", "poses"}
    return Written(sequence, lambda: truncate(velodyne / "000002.bin"), kept)


@writes("semantic_kitti", "semantic_kitti")
def _semantic(root: Path) -> Written:
    return _odometry(root, labels=True)


@writes("kitti_raw", "kitti_raw")
def _raw(root: Path) -> Written:
    drive = root / "2011_09_26" / "2011_09_26_drive_0001_sync"
    data = write_velodyne(drive / "velodyne_points" / "data", 10)
    (data.parent / "timestamps.txt").write_text("".join(map(date, DRIVE.times)))
    images = drive / "image_02"
    write_images(images / "data")
    (images / "timestamps.txt").write_text("".join(map(date, DRIVE.image_times)))
    (drive.parent / "calib_cam_to_cam.txt").write_text(
        f"calib_time: 09-Jan-2012 13:57:47\ncorner_dist: 9.950000e-02\n{S_RECT}"
        f"R_rect_00: {numbers(R_RECT)}\nP_rect_02: {numbers(P)}\n"
    )
    T = T_camera0_lidar(rectified=False)
    (drive.parent / "calib_velo_to_cam.txt").write_text(
        f"calib_time: 15-Mar-2012 11:37:16\nR: {numbers(T[:3, :3])}\nT: {numbers(T[:3, 3])}\n"
    )
    file, kept = data / "0000000002.bin", {"intensity", "camera"}
    return Written(drive, lambda: truncate(file), kept, lens=False)


@writes("run", "run")
def _run(root: Path) -> Written:
    from docdepth.config import parameters
    from docdepth.datasets import open_dataset
    from docdepth.io.run_folder import RunFolder
    from docdepth.pipeline import run_odometry

    recording = open_dataset(_odometry(root / "drive").path)
    run = RunFolder.create(root / "run", None, parameters())
    run_odometry(run, recording, DRIVE.poses)
    return Written(run.path, lambda: truncate(run.frame_path(2)), {"poses"}, tolerance=np.inf)


# ---- folders of point clouds


def settings(**more) -> dict:
    """docdepth.yaml of a folder with images, times and poses beside the sweeps."""
    camera = {
        "images": "front",
        "times": "front.txt",
        "K": K.ravel().tolist(),
        "distortion": DISTORTION.tolist(),
        "T_camera_lidar": DRIVE.T_camera_lidar.tolist(),
    }
    return {
        "times": "stamps.txt",
        "poses": "poses.txt",
        "motion_compensated": False,
        "cameras": {"front": camera},
        **more,
    }


def write_beside(folder: Path, **more) -> None:
    write_images(folder / "front")
    (folder / "front.txt").write_text(seconds(DRIVE.image_times))
    (folder / "stamps.txt").write_text(seconds(DRIVE.times))
    write_kitti(folder / "poses.txt", DRIVE.poses)
    (folder / "docdepth.yaml").write_text(yaml.safe_dump(settings(**more)))


def folder_rows(k: int) -> np.ndarray:
    """Rows with times in seconds after the stamp, as doubles."""
    rows = DRIVE.rows(k)
    names = [(n, rows.dtype[n]) for n in ("x", "y", "z", "intensity", "ring")]
    table = np.empty(len(rows), [*names, ("time", "<f8")])
    for name, _ in names:
        table[name] = rows[name]
    table["time"] = DRIVE.seconds(k)
    return table


def write_pcd(file: Path, rows: np.ndarray, encoding: str = "binary", viewpoint=None) -> None:
    """By pypcd4."""
    pypcd4 = pytest.importorskip("pypcd4")
    names = rows.dtype.names
    cloud = pypcd4.PointCloud.from_points(
        [rows[name] for name in names], names, [rows.dtype[name] for name in names]
    )
    if viewpoint is not None:
        cloud.metadata.viewpoint = tuple(viewpoint)
    cloud.save(file, pypcd4.Encoding(encoding))


@writes("folder of binary pcd", "folder")
def _pcd(root: Path, encoding: str = "binary") -> Written:
    folder = root / "clouds"
    folder.mkdir()
    for k in range(DRIVE.count):
        write_pcd(folder / f"{k:06d}.pcd", folder_rows(k), encoding)
    write_beside(folder)
    return Written(folder, lambda: truncate(folder / "000002.pcd"))


@writes("folder of compressed pcd", "folder")
def _compressed(root: Path) -> Written:
    return _pcd(root, "binary_compressed")


@writes("folder of ascii pcd", "folder")
def _ascii(root: Path) -> Written:
    return replace(_pcd(root, "ascii"), tolerance=1e-5)


@writes("folder of ply", "folder")
def _ply(root: Path) -> Written:
    from docdepth.io.ply import write_vertices

    folder = root / "clouds"
    folder.mkdir()
    for k in range(DRIVE.count):
        write_vertices(folder / f"{k:06d}.ply", folder_rows(k), [])
    write_beside(folder)
    return Written(folder, lambda: truncate(folder / "000002.ply"))


@writes("folder of bin", "folder")
def _bin(root: Path) -> Written:
    folder = root / "clouds"
    (folder / "sweeps").mkdir(parents=True)
    for k in range(DRIVE.count):
        rows = folder_rows(k)
        table = np.column_stack([rows[name] for name in rows.dtype.names])
        table.astype("<f8").tofile(folder / "sweeps" / f"{k:06d}.bin")
    columns = ["x", "y", "z", "intensity", "ring", "time"]
    write_beside(folder, sweeps="sweeps", columns=columns, dtype="float64")
    return Written(folder, lambda: truncate(folder / "sweeps" / "000002.bin"))


@writes("folder of npy", "folder")
def _npy(root: Path) -> Written:
    folder = root / "clouds"
    folder.mkdir()
    for k in range(DRIVE.count):
        rows = folder_rows(k)
        table = np.column_stack([rows[name] for name in ("x", "y", "z", "intensity")])
        np.save(folder / f"{k:06d}.npy", table)
    write_beside(folder)
    kept = {"intensity", "poses", "camera"}
    return Written(folder, lambda: truncate(folder / "000002.npy"), kept)


@writes("folder of csv", "folder")
def _csv(root: Path) -> Written:
    folder = root / "clouds"
    folder.mkdir()
    for k in range(DRIVE.count):
        rows = folder_rows(k)
        table = np.column_stack([rows[name] for name in rows.dtype.names])
        names = ",".join(rows.dtype.names)
        np.savetxt(folder / f"{k:06d}.csv", table, "%.9g", ",", header=names, comments="")
    write_beside(folder)
    return Written(folder, None, tolerance=1e-5)


@writes("folder of las", "folder")
def _las(root: Path, suffix: str = "las") -> Written:
    laspy = pytest.importorskip("laspy")
    folder = root / "clouds"
    folder.mkdir()
    for k in range(DRIVE.count):
        rows = folder_rows(k)
        rows = rows[np.isfinite(rows["x"])]  # LAS holds integers, so no NaN
        header = laspy.LasHeader(point_format=3, version="1.2")
        header.scales, header.offsets = [1e-4] * 3, [0] * 3
        header.add_extra_dim(laspy.ExtraBytesParams("ring", "u2"))
        las = laspy.LasData(header)
        las.x, las.y, las.z = rows["x"], rows["y"], rows["z"]
        las.intensity, las.ring, las.gps_time = rows["intensity"], rows["ring"], rows["time"]
        las.write(folder / f"{k:06d}.{suffix}")
    write_beside(folder)
    return Written(folder, lambda: truncate(folder / f"000002.{suffix}"), tolerance=6e-5)


@writes("folder of laz", "folder")
def _laz(root: Path) -> Written:
    pytest.importorskip("lazrs")
    return _las(root, "laz")


@writes("DynamicMap_Benchmark", "dynamic_map")
def _dynamic_map(root: Path) -> Written:
    """Numbered at ten a second from frame 17000000000, points in the world, 1 is dynamic."""
    from docdepth.geometry.se3 import matrix_to_quaternion

    folder = root / "00" / "pcd"
    folder.mkdir(parents=True)
    for k, pose in enumerate(DRIVE.poses):
        rows, kept = DRIVE.rows(k), DRIVE.usable(k)
        cloud = rows[["x", "y", "z", "intensity"]][kept].copy()
        moved = DRIVE.points(k)[kept].astype("f8") @ pose[:3, :3].T + pose[:3, 3]
        cloud["x"], cloud["y"], cloud["z"] = moved.T
        cloud["intensity"] = rows["ring"][kept] == 3
        x, y, z, w = matrix_to_quaternion(pose[:3, :3])
        viewpoint = [*pose[:3, 3].tolist(), w, x, y, z]
        write_pcd(folder / f"{17_000_000_000 + k}.pcd", cloud, "binary", viewpoint)
    file = folder / "17000000002.pcd"
    return Written(folder.parent, lambda: truncate(file), {"poses"}, tolerance=3e-6, clock=_tenths)


@writes("folder of the authors' release", "run")
def _official(root: Path) -> Written:
    """Quaternions as its FORMAT.md spells them; no size in calib.json, no run.yaml."""
    import json

    from docdepth.geometry.se3 import matrix_to_quaternion
    from docdepth.io.ply import write_vertices

    (root / "frames").mkdir(parents=True)
    columns = ["x", "y", "z", "qx", "qy", "qz", "qw", "timestamp"]
    poses = np.empty(DRIVE.count, [*((c, "<f8") for c in columns), ("indices", "<i4")])
    for k, pose in enumerate(DRIVE.poses):
        numbers = [*pose[:3, 3], *matrix_to_quaternion(pose[:3, :3]), DRIVE.times[k] * 1e-9]
        poses[k] = (*numbers, k)
        rows = DRIVE.rows(k)[DRIVE.usable(k)]
        frame = np.empty(len(rows), [*((a, "<f4") for a in "xyz"), ("classid", "<u2")])
        for axis in "xyz":
            frame[axis] = rows[axis]
        frame["classid"] = np.where(rows["ring"] == 3, 100, 50)
        write_vertices(root / "frames" / f"frame_{k:06d}.ply", frame, [])
    write_vertices(root / "traj_odometry.ply", poses, [])
    write_vertices(root / "traj_camera.ply", poses[:-1], [])
    (root / "calib.json").write_text(json.dumps({"mtx": K.tolist(), "dist": [[0.0] * 5]}))
    np.savetxt(root / "calib_lidar_ref_cam.txt", DRIVE.T_camera_lidar)
    file = root / "frames" / "frame_000002.ply"
    return Written(root, lambda: truncate(file), {"poses"}, clock=doubles)


# ---- bags


def _bag(root: Path, kind: str, name: str) -> Written:
    from bags import write_drive

    path = write_drive(root / name, kind)

    def damage() -> Path:
        return write_drive(path, kind, truncated=2)

    return Written(path, damage, {"intensity", "ring", "times", "camera"})


for _name, _kind, _file in (
    ("ROS 1 bag", "ros1", "drive.bag"),
    ("ROS 2 bag", "db3", "drive"),
    ("MCAP", "mcap", "drive"),
):
    writes(_name, "bag")(partial(_bag, kind=_kind, name=_file))


@writes("a lone MCAP file", "bag")
def _lone(root: Path) -> Written:
    written = _bag(root, "mcap", "drive")
    (file,) = written.path.glob("*.mcap")
    (written.path / "metadata.yaml").unlink()

    def damage() -> Path:
        written.damage()
        return file

    return Written(file, damage, written.has)
