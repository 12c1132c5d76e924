"""Writes the made-up drive as a segment of Waymo's version 2: Parquet files, by pyarrow."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from made_up import DISTORTION, DRIVE, SIZE, K
from writers import Written, writes

from docdepth.geometry.se3 import inverse, poses_from, rotation_exp

SEGMENT = "10023947602400723454_1120_000_1140_000"
T_VEHICLE_TOP = poses_from([rotation_exp([0, 0, 2.6])], [[1.43, 0, 2.184]])[0]
T_VEHICLE_LIDAR = poses_from([np.eye(3)], T_VEHICLE_TOP[:3, 3][None])[0]
T_VEHICLE_REAR = poses_from([rotation_exp([0.05, -0.1, 3.1])], [[-1.1, 0.1, 0.47]])[0]
THEIR_AXES = poses_from([np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])], [[0, 0, 0]])[0]
WIDTH = 4_000
INCLINATIONS = np.radians(3.0 * np.arange(8) - 12)


def write_component(root: Path, component: str, columns: dict) -> Path:
    """A Parquet file of two rows a group."""
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    file = root / component / f"{SEGMENT}.parquet"
    file.parent.mkdir(parents=True, exist_ok=True)
    count = len(next(iter(columns.values())))
    table = pyarrow.table({"key.segment_context_name": [SEGMENT] * count, **columns})
    parquet.write_table(table, file, row_group_size=2)
    return file


def images_of(name: str, images: list[np.ndarray]) -> dict:
    """Columns of range images."""
    pyarrow = pytest.importorskip("pyarrow")
    values = [image.astype(np.float32).ravel() for image in images]
    kind = pyarrow.list_(pyarrow.float32())
    return {
        f"{name}.values": pyarrow.array(values, kind),
        f"{name}.shape": [list(image.shape) for image in images],
    }


def frame_names() -> list[int]:
    """Microseconds of the start of each revolution."""
    return (microseconds(DRIVE.times) // 1000 - 50_000).tolist()


def vehicle_poses() -> np.ndarray:
    return DRIVE.poses @ inverse(T_VEHICLE_LIDAR)


def range_image(k: int) -> np.ndarray:
    """Row 0 is the highest laser, column 0 looks back, and columns run clockwise."""
    rows, kept = DRIVE.rows(k), DRIVE.usable(k)
    image = np.full((8, WIDTH, 4), -1, np.float32)
    points = DRIVE.points(k)[kept].astype(float)
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    column = np.floor((np.pi - azimuth) / (2 * np.pi) * WIDTH).astype(int).clip(0, WIDTH - 1)
    row = 7 - rows["ring"][kept]
    assert len(set(zip(row.tolist(), column.tolist(), strict=True))) == kept.sum()
    image[row, column, 0] = np.linalg.norm(points, axis=1)
    image[row, column, 1] = rows["intensity"][kept]
    return image


def pixel_poses(T: np.ndarray, height: int, width: int) -> np.ndarray:
    """One pose for all pixels: roll, pitch, yaw, x, y, z."""
    R = T[:3, :3]
    angles = [np.arctan2(R[2, 1], R[2, 2]), -np.arcsin(R[2, 0]), np.arctan2(R[1, 0], R[0, 0])]
    return np.tile(np.array([*angles, *T[:3, 3]], np.float32), (height, width, 1))


def write_calibration(root: Path, lidars: dict[int, np.ndarray]) -> None:
    """Of TOP each laser, of the others the least and the greatest inclination."""
    name = "[LiDARCalibrationComponent]"
    numbers = list(lidars)
    write_component(
        root,
        "lidar_calibration",
        {
            "key.laser_name": numbers,
            f"{name}.extrinsic.transform": [lidars[n].ravel().tolist() for n in numbers],
            f"{name}.beam_inclination.min": [
                float(INCLINATIONS[0]) if n == 1 else -1.5 for n in numbers
            ],
            f"{name}.beam_inclination.max": [
                float(INCLINATIONS[-1]) if n == 1 else 0.5 for n in numbers
            ],
            f"{name}.beam_inclination.values": [
                INCLINATIONS.tolist() if n == 1 else None for n in numbers
            ],
        },
    )
    name = "[CameraCalibrationComponent]"
    extrinsic = T_VEHICLE_LIDAR @ inverse(DRIVE.T_camera_lidar) @ THEIR_AXES
    intrinsic = dict(
        f_u=K[0, 0], f_v=K[1, 1], c_u=K[0, 2] + 0.5, c_v=K[1, 2] + 0.5,
        **dict(zip(("k1", "k2", "p1", "p2", "k3"), DISTORTION, strict=True)),
    )  # fmt: skip
    write_component(
        root,
        "camera_calibration",
        {
            "key.camera_name": [1],
            **{f"{name}.intrinsic.{key}": [float(value)] for key, value in intrinsic.items()},
            f"{name}.extrinsic.transform": [extrinsic.ravel().tolist()],
            f"{name}.width": [SIZE[0]],
            f"{name}.height": [SIZE[1]],
            f"{name}.rolling_shutter_direction": [4],
        },
    )


def write_poses(root: Path, poses: np.ndarray) -> None:
    name = "[VehiclePoseComponent].world_from_vehicle.transform"
    matrices = [T.ravel().tolist() for T in poses]
    rows = {"key.frame_timestamp_micros": frame_names(), name: matrices}
    write_component(root, "vehicle_pose", rows)


def write_images(root: Path, poses: np.ndarray, shutter: float = 0.0) -> None:
    """Images of FRONT; PNG in place of JPEG, so that pixels stay. The last frame has none."""
    name, count = "[CameraImageComponent]", DRIVE.images_count
    taken = DRIVE.image_times / 1e9
    images = [cv2.imencode(".png", DRIVE.image(k))[1].tobytes() for k in range(count)]
    write_component(
        root,
        "camera_image",
        {
            "key.frame_timestamp_micros": frame_names()[:count],
            "key.camera_name": [1] * count,
            f"{name}.image": images,
            f"{name}.pose.transform": [T.ravel().tolist() for T in poses[:count]],
            f"{name}.pose_timestamp": (DRIVE.times[:count] / 1e9).tolist(),
            f"{name}.rolling_shutter_params.camera_trigger_time": taken - shutter / 2,
            f"{name}.rolling_shutter_params.camera_readout_done_time": taken + shutter / 2,
        },
    )


def write_lidar(root: Path, images: dict[int, list[np.ndarray]]) -> Path:
    """Sweeps of LiDARs, in no order."""
    rows = [(name, n, k) for n in images for k, name in enumerate(frame_names())][::-1]
    return write_component(
        root,
        "lidar",
        {
            "key.frame_timestamp_micros": [name for name, _, _ in rows],
            "key.laser_name": [n for _, n, _ in rows],
            **images_of("[LiDARComponent].range_image_return1", [images[n][k] for _, n, k in rows]),
        },
    )


def write_pixel_poses(root: Path, poses: list[np.ndarray]) -> Path:
    name = "[LiDARPoseComponent].range_image_return1"
    return write_component(
        root,
        "lidar_pose",
        {
            "key.frame_timestamp_micros": frame_names(),
            "key.laser_name": [1] * len(poses),
            **images_of(name, poses),
        },
    )


def microseconds(times: np.ndarray) -> np.ndarray:
    return np.rint(times / 1e9 * 1e6).astype(np.int64) * 1000


@writes("Waymo", "waymo")
def _waymo(root: Path) -> Written:
    images, poses = [range_image(k) for k in range(DRIVE.count)], vehicle_poses()
    write_lidar(root, {1: images})
    write_calibration(root, {1: T_VEHICLE_TOP})
    write_poses(root, poses)
    write_images(root, poses)

    def damage() -> Path:
        broken = [*images[:2], images[2][:, :0], *images[3:]]
        return write_lidar(root, {1: broken})

    return Written(
        root / SEGMENT, damage, {"poses", "camera"}, tolerance=np.inf, clock=microseconds,
        reordered=True,
    )  # fmt: skip
