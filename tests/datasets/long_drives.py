"""Writes the made-up drive as data sets of long drives have it: stamped files, tables of poses."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest
from kitti_drives import R_RECT, date, moved, numbers, write_velodyne
from made_up import DRIVE, SIZE, K
from old_pandas import write_table
from vehicles import microseconds
from writers import Written, doubles, truncate, writes

from docdepth.datasets.formats.mulran import _T_VEHICLE_THEIRS as T_VEHICLE_OUSTER
from docdepth.datasets.formats.pandaset import T_camera_lidar
from docdepth.geometry.se3 import inverse, matrix_to_quaternion, poses_from, rotation_exp

T_IMU_CAMERA0 = poses_from([rotation_exp([1.2, -1.3, 1.1])], [[1.5, 0.3, -0.8]])[0]
R_RECT_01 = rotation_exp([-0.006, 0.003, 0.01])
SEQUENCE = "2013_05_28_drive_0003_sync"


# ---- KITTI-360


def kitti_360_calibration(folder: Path) -> None:
    """Camera 00 is that of the drive, once it is rectified; camera 01 sits to its right."""
    folder.mkdir(parents=True)
    T_lidar_camera0 = inverse(inverse(moved(R_RECT)) @ DRIVE.T_camera_lidar)
    T_imu_camera1 = T_IMU_CAMERA0 @ poses_from([np.eye(3)], [[0.6, 0.01, -0.02]])[0]
    (folder / "calib_cam_to_velo.txt").write_text(numbers(T_lidar_camera0[:3]) + "\n")
    (folder / "calib_cam_to_pose.txt").write_text(
        f"image_00: {numbers(T_IMU_CAMERA0[:3])}\nimage_01: {numbers(T_imu_camera1[:3])}\n"
        f"image_02: {numbers(np.eye(4)[:3])}\nimage_03: {numbers(np.eye(4)[:3])}\n"
    )
    P = np.hstack([K, np.zeros((3, 1))])
    (folder / "perspective.txt").write_text(
        f"calib_time: 09-Jan-2014 13:57:47\ncorner_dist: 1.0e-01\n"
        f"S_rect_00: {SIZE[0]}.0 {SIZE[1]}.0\n"
        f"R_rect_00: {numbers(R_RECT)}\nP_rect_00: {numbers(P)}\n"
    )


def kitti_360_poses(folder: Path, frames: list[int]) -> None:
    """poses.txt of the IMU and cam0_to_world.txt of the rectified camera, of some frames."""
    folder.mkdir(parents=True, exist_ok=True)
    T_camera_lidar = DRIVE.T_camera_lidar
    T_imu_lidar = T_IMU_CAMERA0 @ inverse(moved(R_RECT)) @ T_camera_lidar
    imu = [f"{k} {numbers((DRIVE.poses[k] @ inverse(T_imu_lidar))[:3])} \n" for k in frames]
    camera = [f"{k} {numbers(DRIVE.poses[k] @ inverse(T_camera_lidar))} \n" for k in frames]
    (folder / "poses.txt").write_text("".join(imu))
    (folder / "cam0_to_world.txt").write_text("".join(camera))


@writes("KITTI-360", "kitti_360")
def write_kitti_360(root: Path) -> Written:
    root = root / "KITTI-360"
    data = write_velodyne(root / "data_3d_raw" / SEQUENCE / "velodyne_points" / "data", 10)
    velodyne = data.parent
    (velodyne / "timestamps.txt").write_text("".join(map(date, DRIVE.times)))
    images = root / "data_2d_raw" / SEQUENCE / "image_00"
    (images / "data_rect").mkdir(parents=True)
    for k in range(DRIVE.images_count):
        cv2.imwrite(str(images / "data_rect" / f"{k:010d}.png"), DRIVE.image(k))
    (images / "timestamps.txt").write_text("".join(map(date, DRIVE.image_times)))
    kitti_360_calibration(root / "calibration")
    kitti_360_poses(root / "data_poses" / SEQUENCE, list(range(DRIVE.count)))
    file = velodyne / "data" / "0000000002.bin"
    kept = {"intensity", "poses", "camera"}
    return Written(velodyne.parent, lambda: truncate(file), kept, lens=False)


# ---- folders of sweeps that are named by their stamps


def pack(file: Path, **columns: tuple[str, np.ndarray]) -> None:
    """Rows without gaps, value by value as a program writes them."""
    kinds = [(name, "<" + kind) for name, (kind, _) in columns.items()]
    rows = np.zeros(len(next(iter(columns.values()))[1]), kinds)
    for name, (_, values) in columns.items():
        rows[name] = values
    rows.tofile(file)


def matrix_rows(poses: np.ndarray, stamps: list[int], between: str = ",") -> str:
    rows = [
        between.join([str(t), *numbers(T[:3]).split()]) for t, T in zip(stamps, poses, strict=True)
    ]
    return "\n".join(rows) + "\n"


def angles_of(rotation: np.ndarray) -> list[float]:
    """Roll, pitch and yaw of Rz(yaw) Ry(pitch) Rx(roll), radians."""
    yaw = np.arctan2(rotation[1, 0], rotation[0, 0])
    pitch = np.arctan2(-rotation[2, 0], np.hypot(rotation[2, 1], rotation[2, 2]))
    return [float(np.arctan2(rotation[2, 1], rotation[2, 2])), float(pitch), float(yaw)]


# ---- MulRan

COLUMNS_APART = 2  # the made-up points stand in every second column, at the place of their beam


def write_ouster(file: Path, k: int) -> None:
    """A whole revolution of 64 x 1024, column by column, seen by a LiDAR that looks backwards."""
    rows, points = DRIVE.rows(k), DRIVE.points(k)
    table = np.zeros((64 * 1024, 4), "<f4")
    kept = np.flatnonzero(DRIVE.usable(k))
    places = 64 * COLUMNS_APART * kept + rows["ring"][kept]
    turned = points[kept] * np.array([-1, -1, 1], np.float32)
    table[places] = np.column_stack([turned, rows["intensity"][kept]])
    table.tofile(file)


@writes("MulRan", "mulran")
def write_mulran(root: Path) -> Written:
    sequence = root / "KAIST01"
    (sequence / "sensor_data" / "Ouster").mkdir(parents=True)
    for k, time in enumerate(DRIVE.times.tolist()):
        write_ouster(sequence / "sensor_data" / "Ouster" / f"{time}.bin", k)
    turn = np.diag([-1.0, -1, 1, 1])
    vehicle = DRIVE.poses @ turn @ inverse(T_VEHICLE_OUSTER)
    (sequence / "global_pose.csv").write_text(matrix_rows(vehicle, DRIVE.times.tolist()))
    file = sequence / "sensor_data" / "Ouster" / f"{DRIVE.times[2]}.bin"
    return Written(sequence, lambda: truncate(file), {"intensity", "ring", "poses"})


# ---- NCLT


@writes("NCLT", "nclt")
def write_nclt(root: Path) -> Written:
    """Body frame: x ahead, y to the right, z down; world: north, east, down."""
    day = root / "2012-01-08"
    (day / "velodyne_sync").mkdir(parents=True)
    down = np.diag([1.0, -1, -1])
    place = np.array([0.002, -0.004, -0.957])  # of the LiDAR in the body
    lines = []
    for k, time in enumerate(DRIVE.times.tolist()):
        rows, kept = DRIVE.rows(k), DRIVE.usable(k)
        body = DRIVE.points(k)[kept].astype("f8") @ down.T + place
        counts = np.round((body + 100) / 0.005)
        pack(
            day / "velodyne_sync" / f"{time // 1000}.bin",
            x=("u2", counts[:, 0]), y=("u2", counts[:, 1]), z=("u2", counts[:, 2]),
            i=("u1", rows["intensity"][kept]), l=("u1", rows["ring"][kept]),
        )  # fmt: skip
        rotation = down @ DRIVE.poses[k][:3, :3] @ down
        position = down @ DRIVE.poses[k][:3, 3] - rotation @ place
        values = [time // 1000, *position, *angles_of(rotation)]
        lines.append(",".join(repr(float(v)) if n else str(v) for n, v in enumerate(values)))
    (root / "ground_truth").mkdir()
    text = "\n".join([f"{DRIVE.times[0] // 1000 - 9},nan,nan,nan,nan,nan,nan", *lines])
    (root / "ground_truth" / "groundtruth_2012-01-08.csv").write_text(text + "\n")
    file = day / "velodyne_sync" / f"{DRIVE.times[2] // 1000}.bin"
    kept = {"intensity", "ring", "poses"}
    return Written(day, lambda: truncate(file), kept, tolerance=0.00251, clock=microseconds)


# ---- HeLiPR


def _helipr(root: Path, name: str, has: set[str]) -> Written:
    sequence = root / "KAIST05"
    folder = sequence / "LiDAR" / name
    folder.mkdir(parents=True)
    for k, time in enumerate(DRIVE.times.tolist()):
        rows = DRIVE.rows(k)
        points = {axis: ("f4", rows[axis]) for axis in "xyz"}
        pack(folder / f"{time}.bin", **points, **_columns(name, k, rows))
    lines = []
    for time, T in zip(DRIVE.times.tolist(), DRIVE.poses, strict=True):
        values = [*T[:3, 3], *matrix_to_quaternion(T[:3, :3])]
        lines.append(" ".join([str(time), *(f"{value:.12f}" for value in values)]))
    (sequence / "LiDAR_GT").mkdir()
    (sequence / "LiDAR_GT" / f"global_{name}_gt.txt").write_text("\n".join(lines) + "\n")
    file = folder / f"{DRIVE.times[2]}.bin"
    return Written(folder, lambda: truncate(file), has)


def _columns(name: str, k: int, rows: np.ndarray) -> dict:
    """Behind x, y and z; Aeva's as sessions after August 2023 have it, with one number more."""
    bright, ring, share = rows["intensity"], rows["ring"], rows["share"]
    since_start = np.round((share.astype("f8") + 0.5) * DRIVE.period)
    return {
        "Ouster": {"intensity": ("f4", bright), "t": ("u4", since_start),
                   "reflectivity": ("u2", ring + 500), "ring": ("u2", ring),
                   "ambient": ("u2", ring + 7)},
        "Velodyne": {"intensity": ("f4", bright), "ring": ("u2", ring),
                     "time": ("f4", DRIVE.seconds(k))},
        "Avia": {"reflectivity": ("u1", bright), "tag": ("u1", ring + 16), "line": ("u1", ring),
                 "offset_time": ("u4", since_start)},
        "Aeva": {"reflectivity": ("f4", bright), "velocity": ("f4", share),
                 "time_offset_ns": ("i4", since_start - DRIVE.period // 2),
                 "line_index": ("u1", ring), "intensity": ("f4", share)},
    }[name]  # fmt: skip


for _name, _times in (("Ouster", False), ("Velodyne", True), ("Avia", False), ("Aeva", True)):
    _has = {"intensity", "ring", "poses"} | ({"times"} if _times else set())
    writes(f"HeLiPR, {_name}", "helipr")(partial(_helipr, name=_name, has=_has))


# ---- Boreas


@writes("Boreas", "boreas")
def write_boreas(root: Path) -> Written:
    """The LiDAR stands turned by 47 degrees; Applanix has x to the right, y ahead."""
    sequence = root / "boreas-2021-08-05-13-34"
    for folder in ("lidar", "camera", "calib", "applanix"):
        (sequence / folder).mkdir(parents=True)
    T_ours_theirs = moved(rotation_exp([0.002, -0.001, -0.82]))
    T_applanix_ours = moved(rotation_exp([0, 0, np.pi / 2]))
    lines = ["GPSTime,easting,northing,altitude,vel_east,vel_north,vel_up,roll,pitch,heading,"
             "angvel_z,angvel_y,angvel_x"]  # fmt: skip
    for k, time in enumerate(DRIVE.times.tolist()):
        rows = DRIVE.rows(k)
        points = DRIVE.points(k).astype("f8") @ T_ours_theirs[:3, :3]
        table = np.column_stack([points, rows["intensity"], rows["ring"], DRIVE.seconds(k)])
        table.astype("<f4").tofile(sequence / "lidar" / f"{time // 1000}.bin")
        pose = DRIVE.poses[k] @ T_ours_theirs
        values = [*pose[:3, 3], 1.0, 2.0, 3.0, *angles_of(pose[:3, :3].T), 0.1, 0.2, 0.3]
        lines.append(",".join([str(time // 1000), *(repr(float(v)) for v in values)]))
    (sequence / "applanix" / "lidar_poses.csv").write_text("\n".join(lines) + "\n")
    for k, time in enumerate(DRIVE.image_times.tolist()):
        cv2.imwrite(str(sequence / "camera" / f"{time // 1000}.png"), DRIVE.image(k))
    P = np.eye(4)
    P[:3, :3] = K
    np.savetxt(sequence / "calib" / "P_camera.txt", P)
    np.savetxt(sequence / "calib" / "T_camera_lidar.txt", DRIVE.T_camera_lidar @ T_ours_theirs)
    np.savetxt(sequence / "calib" / "T_applanix_lidar.txt", T_applanix_ours @ T_ours_theirs)
    file = sequence / "lidar" / f"{DRIVE.times[2] // 1000}.bin"
    return Written(sequence, lambda: truncate(file), tolerance=2e-6, clock=microseconds, lens=False)


# ---- PandaSet


def panda_pose(T: np.ndarray) -> dict:
    x, y, z, w = matrix_to_quaternion(T[:3, :3]).tolist()
    heading = {"w": w, "x": x, "y": y, "z": z}
    return {"position": dict(zip("xyz", T[:3, 3].tolist(), strict=True)), "heading": heading}


@writes("PandaSet", "pandaset")
def write_pandaset(root: Path) -> Written:
    """Points in the world; the second LiDAR's are there, too."""
    pytest.importorskip("pandas")
    sequence = root / "pandaset" / "002"
    front = sequence / "camera" / "front_camera"
    for folder in (sequence / "lidar", front):
        folder.mkdir(parents=True)
    for k, time in enumerate(DRIVE.times.tolist()):
        kept, pose = DRIVE.usable(k), DRIVE.poses[k]
        points = DRIVE.points(k)[kept].astype("f8") @ pose[:3, :3].T + pose[:3, 3]
        x, y, z = np.concatenate([points, points[:7] + 1]).T
        rows = DRIVE.rows(k)[kept]
        times = time * 1e-9 + rows["share"].astype("f8") * DRIVE.period * 1e-9
        d = np.zeros(len(x), int)
        d[-7:] = 1
        write_table(
            sequence / "lidar" / f"{k:02d}.pkl.gz", x=x, y=y, z=z,
            i=np.append(rows["intensity"].astype("f8"), [1.0] * 7),
            t=np.append(times, [time * 1e-9] * 7), d=d,
        )  # fmt: skip
        cv2.imwrite(str(front / f"{k:02d}.jpg"), DRIVE.image(k % 4))
    poses = [panda_pose(T @ inverse(T_camera_lidar("front_camera"))) for T in DRIVE.poses]
    (front / "poses.json").write_text(json.dumps(poses))
    (front / "timestamps.json").write_text(json.dumps((DRIVE.times * 1e-9).tolist()))
    intrinsics = {"fx": K[0, 0], "fy": K[1, 1], "cx": K[0, 2], "cy": K[1, 2]}
    (front / "intrinsics.json").write_text(json.dumps(intrinsics))
    (sequence / "lidar" / "poses.json").write_text(json.dumps([panda_pose(np.eye(4))] * 5))
    file = sequence / "lidar" / "02.pkl.gz"
    return Written(
        sequence, lambda: truncate(file), {"intensity", "poses"}, tolerance=2e-6, clock=doubles
    )
