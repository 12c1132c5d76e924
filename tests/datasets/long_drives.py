"""Writes the made-up drive as data sets of long drives have it: stamped files, tables of poses."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from kitti_drives import R_RECT, numbers
from made_up import DRIVE, SIZE, K
from writers import Written, truncate, writes

from docdepth.geometry.se3 import inverse, poses_from, rotation_exp

T_IMU_CAMERA0 = poses_from([rotation_exp([1.2, -1.3, 1.1])], [[1.5, 0.3, -0.8]])[0]
R_RECT_01 = rotation_exp([-0.006, 0.003, 0.01])
SEQUENCE = "2013_05_28_drive_0003_sync"


def rectified(rotation: np.ndarray) -> np.ndarray:
    """The rectification of a camera as a pose."""
    return poses_from([rotation], [[0, 0, 0]])[0]


def date(time: int) -> str:
    return f"{np.datetime64(int(time), 'ns')}\n".replace("T", " ")


# ---- KITTI-360


def kitti_360_calibration(folder: Path) -> None:
    """Camera 00 is that of the drive, once it is rectified; camera 01 sits to its right."""
    folder.mkdir(parents=True)
    T_lidar_camera0 = inverse(inverse(rectified(R_RECT)) @ DRIVE.T_camera_lidar)
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
    T_imu_lidar = T_IMU_CAMERA0 @ inverse(rectified(R_RECT)) @ T_camera_lidar
    imu = [f"{k} {numbers((DRIVE.poses[k] @ inverse(T_imu_lidar))[:3])} \n" for k in frames]
    camera = [f"{k} {numbers(DRIVE.poses[k] @ inverse(T_camera_lidar))} \n" for k in frames]
    (folder / "poses.txt").write_text("".join(imu))
    (folder / "cam0_to_world.txt").write_text("".join(camera))


@writes("KITTI-360", "kitti_360")
def write_kitti_360(root: Path) -> Written:
    root = root / "KITTI-360"
    velodyne = root / "data_3d_raw" / SEQUENCE / "velodyne_points"
    (velodyne / "data").mkdir(parents=True)
    for k in range(DRIVE.count):
        table = np.column_stack([DRIVE.points(k), DRIVE.rows(k)["intensity"]]).astype("<f4")
        table.tofile(velodyne / "data" / f"{k:010d}.bin")
    (velodyne / "timestamps.txt").write_text("".join(date(t) for t in DRIVE.times))
    images = root / "data_2d_raw" / SEQUENCE / "image_00"
    (images / "data_rect").mkdir(parents=True)
    for k in range(DRIVE.images_count):
        cv2.imwrite(str(images / "data_rect" / f"{k:010d}.png"), DRIVE.image(k))
    (images / "timestamps.txt").write_text("".join(date(t) for t in DRIVE.image_times))
    kitti_360_calibration(root / "calibration")
    kitti_360_poses(root / "data_poses" / SEQUENCE, list(range(DRIVE.count)))
    file = velodyne / "data" / "0000000002.bin"
    kept = {"intensity", "poses", "camera"}
    return Written(velodyne.parent, lambda: truncate(file), kept, lens=False)
