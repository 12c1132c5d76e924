"""Writes the made-up drive as data sets of vehicles have it: nuScenes, Argoverse 2, DGP."""

from __future__ import annotations

import datetime
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from made_up import DRIVE, SIZE, K
from writers import Written, truncate, writes

from docdepth.geometry.se3 import inverse, matrix_to_quaternion, poses_from, rotation_exp

T_EGO_LIDAR = poses_from([np.eye(3)], [[0.9, 0.05, 1.8]])[0]
T_TURNED = poses_from([rotation_exp([0, 0, -np.pi / 2])], [[0, 0, 0]])[0]  # nuScenes' x is right


def wxyz(T: np.ndarray) -> list[float]:
    x, y, z, w = matrix_to_quaternion(T[:3, :3]).tolist()
    return [w, x, y, z]


def microseconds(times: np.ndarray) -> np.ndarray:
    return times // 1000 * 1000


# ---- nuScenes


def nuscenes_tables(root: Path, sensors: dict, data: list[dict], scene: str = "scene-0061") -> None:
    """The tables of one scene.

    ``sensors`` has ``T_ego_sensor`` and K of each channel, ``data`` channel, µs, file, size and
    ``T_world_ego`` of each sweep and image.
    """
    folder = root / "v1.0-mini"
    folder.mkdir(parents=True)
    tables: dict[str, list[dict]] = {
        "scene": [{"token": "s0", "name": scene}, {"token": "s1", "name": "scene-0103"}],
        "sample": [{"token": "a0", "scene_token": "s0", "timestamp": 0}],
        "sensor": [], "calibrated_sensor": [], "ego_pose": [], "sample_data": [],
    }  # fmt: skip
    for name, (T, intrinsic) in sensors.items():
        tables["sensor"].append({"token": f"s-{name}", "channel": name})
        tables["calibrated_sensor"].append(
            {
                "token": f"c-{name}",
                "sensor_token": f"s-{name}",
                "translation": T[:3, 3].tolist(),
                "rotation": wxyz(T),
                "camera_intrinsic": np.asarray(intrinsic).tolist(),
            }
        )
    for k, one in enumerate(data):
        T = one["T_world_ego"]
        tables["ego_pose"].append(
            {"token": f"e{k}", "translation": T[:3, 3].tolist(), "rotation": wxyz(T)}
        )
        tables["sample_data"].append(
            {
                "token": f"d{k}",
                "sample_token": "a0",
                "ego_pose_token": f"e{k}",
                "calibrated_sensor_token": f"c-{one['channel']}",
                "timestamp": one["us"],
                "filename": one["file"],
                "width": one["size"][0],
                "height": one["size"][1],
            }
        )
    for name, rows in tables.items():
        (folder / f"{name}.json").write_text(json.dumps(rows))


@writes("nuScenes", "nuscenes")
def _nuscenes(root: Path) -> Written:
    data = []
    for kind in ("sweeps/LIDAR_TOP", "samples/CAM_FRONT"):
        (root / kind).mkdir(parents=True)
    for k, time in enumerate(DRIVE.times.tolist()):
        rows, points = DRIVE.rows(k), DRIVE.points(k)
        table = [-points[:, 1], points[:, 0], points[:, 2], rows["intensity"], rows["ring"]]
        file = f"sweeps/LIDAR_TOP/n015__LIDAR_TOP__{time // 1000}.pcd.bin"
        np.column_stack(table).astype("<f4").tofile(root / file)
        ego = DRIVE.poses[k] @ inverse(T_EGO_LIDAR)
        data.append({"channel": "LIDAR_TOP", "us": time // 1000, "file": file, "size": (0, 0),
                     "T_world_ego": ego})  # fmt: skip
    for k, time in enumerate(DRIVE.image_times.tolist()):
        file = f"samples/CAM_FRONT/n015__CAM_FRONT__{time // 1000}.png"
        cv2.imwrite(str(root / file), DRIVE.image(k))
        data.append({"channel": "CAM_FRONT", "us": time // 1000, "file": file, "size": SIZE,
                     "T_world_ego": np.eye(4)})  # fmt: skip
    T_ego_camera = T_EGO_LIDAR @ inverse(DRIVE.T_camera_lidar)
    sensors = {"LIDAR_TOP": (T_EGO_LIDAR @ T_TURNED, []), "CAM_FRONT": (T_ego_camera, K)}
    nuscenes_tables(root, sensors, data)
    file = root / f"sweeps/LIDAR_TOP/n015__LIDAR_TOP__{DRIVE.times[2] // 1000}.pcd.bin"
    kept = {"intensity", "ring", "poses", "camera"}
    return Written(
        root / "scene-0061", lambda: truncate(file), kept, clock=microseconds, lens=False
    )


# ---- Argoverse 2


def _offsets(k: int) -> np.ndarray:
    return np.round((DRIVE.rows(k)["share"] + 0.5) * DRIVE.period).astype("<i4")


@writes("Argoverse 2", "argoverse2")
def _argoverse(root: Path) -> Written:
    """By pyarrow. Even lasers are of the upper LiDAR; the lower one hangs upside down."""
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import feather

    log = root / "adcf7d18-0510-35b0-a2fa-b4cea13a6d76"
    for folder in ("sensors/lidar", "sensors/cameras/ring_front_center", "calibration"):
        (log / folder).mkdir(parents=True)

    def write(file: str, **columns) -> None:
        feather.write_feather(pyarrow.table(columns), str(log / file))

    def poses(matrices: list[np.ndarray]) -> dict:
        quaternions = np.array([wxyz(T) for T in matrices]).T
        places = np.array([T[:3, 3] for T in matrices]).T
        return dict(zip(("qw", "qx", "qy", "qz"), quaternions, strict=True)) | dict(
            zip(("tx_m", "ty_m", "tz_m"), places, strict=True)
        )

    for k, time in enumerate(DRIVE.times.tolist()):
        rows, kept = DRIVE.rows(k), DRIVE.usable(k)
        points = DRIVE.points(k).astype("f8") + T_EGO_LIDAR[:3, 3]
        ring = rows["ring"].astype("u1")
        laser = np.where(ring % 2 == 0, ring // 2, 32 + ring // 2).astype("u1")
        order = np.argsort(laser[kept] >= 32, kind="stable")
        columns = {
            "x": points[:, 0].astype("f4"), "y": points[:, 1].astype("f4"),
            "z": points[:, 2].astype("f4"), "intensity": rows["intensity"].astype("u1"),
            "laser_number": laser, "offset_ns": _offsets(k),
        }  # fmt: skip
        write(f"sensors/lidar/{time}.feather", **{n: c[kept][order] for n, c in columns.items()})
    ego = [pose @ inverse(T_EGO_LIDAR) for pose in DRIVE.poses]
    write("city_SE3_egovehicle.feather", timestamp_ns=DRIVE.times, **poses(ego))
    tilted = poses_from([rotation_exp([np.pi, 0, 0.3])], [[0.9, 0.05, 1.6]])[0]
    camera = T_EGO_LIDAR @ inverse(DRIVE.T_camera_lidar)
    write(
        "calibration/egovehicle_SE3_sensor.feather",
        sensor_name=["ring_front_center", "up_lidar", "down_lidar"],
        **poses([camera, T_EGO_LIDAR, tilted]),
    )
    write(
        "calibration/intrinsics.feather",
        sensor_name=["ring_front_center"], fx_px=[K[0, 0]], fy_px=[K[1, 1]], cx_px=[K[0, 2]],
        cy_px=[K[1, 2]], k1=[0.0], k2=[0.0], k3=[0.0], width_px=[SIZE[0]], height_px=[SIZE[1]],
    )  # fmt: skip
    for k, time in enumerate(DRIVE.image_times.tolist()):
        file = log / "sensors" / "cameras" / "ring_front_center" / f"{time}.png"
        cv2.imwrite(str(file), DRIVE.image(k))
    file = log / "sensors" / "lidar" / f"{DRIVE.times[2]}.feather"
    return Written(
        log, lambda: truncate(file), {"intensity", "poses", "camera"}, tolerance=2e-6,
        lens=False, reordered=True,
    )  # fmt: skip


# ---- DGP


def _date(time: int) -> str:
    since = datetime.datetime(1970, 1, 1) + datetime.timedelta(microseconds=time // 1000)
    return since.isoformat(timespec="microseconds") + "Z"


@writes("DGP", "dgp")
def _dgp(root: Path) -> Written:
    scene = root / "scene_01"
    for folder in ("point_cloud/LIDAR", "rgb/CAMERA_01", "calibration"):
        (scene / folder).mkdir(parents=True)

    def pose(T: np.ndarray) -> dict:
        quaternion = dict(zip(("qw", "qx", "qy", "qz"), wxyz(T), strict=True))
        return {"rotation": quaternion, "translation": dict(zip("xyz", T[:3, 3], strict=True))}

    data = []
    for k, time in enumerate(DRIVE.times.tolist()):
        rows = DRIVE.rows(k)
        table = np.column_stack([DRIVE.points(k), rows["intensity"]]).astype("f8")
        file = f"point_cloud/LIDAR/{time // 100}.npz"
        np.savez_compressed(scene / file, data=table)
        about = {"filename": file, "point_format": ["X", "Y", "Z", "INTENSITY"],
                 "pose": pose(DRIVE.poses[k])}  # fmt: skip
        identity = {"name": "LIDAR", "timestamp": _date(time)}
        data.append({"datum": {"point_cloud": about}, "id": identity, "key": f"l{k}"})
    for k, time in enumerate(DRIVE.image_times.tolist()):
        file = f"rgb/CAMERA_01/{time // 100}.png"
        cv2.imwrite(str(scene / file), DRIVE.image(k))
        about = {"filename": file, "width": SIZE[0], "height": SIZE[1], "pose": pose(np.eye(4))}
        identity = {"name": "CAMERA_01", "timestamp": _date(time)}
        data.append({"datum": {"image": about}, "id": identity, "key": f"c{k}"})
    samples = [{"calibration_key": "abc", "datum_keys": [one["key"] for one in data]}]
    content = {"data": data, "samples": samples}
    (scene / "scene_1234.json").write_text(json.dumps(content))
    intrinsic = {"fx": K[0, 0], "fy": K[1, 1], "cx": K[0, 2], "cy": K[1, 2], "skew": 0.0}
    calibration = {
        "names": ["LIDAR", "CAMERA_01"],
        "intrinsics": [dict.fromkeys(intrinsic, 0.0), intrinsic],
        "extrinsics": [pose(np.eye(4)), pose(inverse(DRIVE.T_camera_lidar))],
    }
    (scene / "calibration" / "abc.json").write_text(json.dumps(calibration))
    file = scene / "point_cloud" / "LIDAR" / f"{DRIVE.times[2] // 100}.npz"
    kept = {"intensity", "poses", "camera"}
    (scene / "docdepth.yaml").write_text("motion_compensated: true\n")
    return Written(scene, lambda: truncate(file), kept, clock=microseconds, lens=False)
