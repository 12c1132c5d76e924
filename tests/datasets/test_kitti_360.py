"""KITTI-360: poses of some frames, cameras, fisheyes, and files that are broken."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from conformance import check
from formats import WRITERS
from kitti_drives import R_RECT, date, moved, numbers
from long_drives import R_RECT_01, SEQUENCE, T_IMU_CAMERA0
from made_up import DRIVE, K

from docdepth.datasets import open_dataset
from docdepth.errors import CalibrationError, DatasetError
from docdepth.geometry.se3 import inverse


@pytest.fixture
def kitti_360(tmp_path: Path) -> Path:
    """ROOT of KITTI-360."""
    return WRITERS["KITTI-360"][1](tmp_path).path.parent.parent


def test_kitti_360_is_found_from_its_root(kitti_360: Path) -> None:
    assert open_dataset(kitti_360).path == kitti_360 / "data_3d_raw" / SEQUENCE
    (kitti_360 / "data_3d_raw").rename(kitti_360 / "sweeps")
    assert open_dataset(kitti_360 / "sweeps" / SEQUENCE).name == "kitti_360"


def test_kitti_360_from_within_its_folder(kitti_360: Path, monkeypatch) -> None:
    monkeypatch.chdir(kitti_360 / "data_3d_raw")
    there = open_dataset(SEQUENCE)
    assert there.name == "kitti_360"
    assert there.poses is not None
    assert len(there.cameras["image_00"].images) == DRIVE.images_count


def test_poses_of_the_camera_are_those_of_the_imu(kitti_360: Path) -> None:
    folder = kitti_360 / "data_poses" / SEQUENCE
    poses = open_dataset(kitti_360).poses
    (folder / "poses.txt").unlink()
    np.testing.assert_allclose(open_dataset(kitti_360).poses, poses, atol=1e-9)
    (folder / "cam0_to_world.txt").unlink()
    assert open_dataset(kitti_360).poses is None


def test_the_right_camera_of_kitti_360(kitti_360: Path) -> None:
    file = kitti_360 / "calibration" / "perspective.txt"
    P = np.hstack([K, [[-20.0], [0], [0]]])
    file.write_text(
        file.read_text()
        + f"S_rect_01: 64 48\nR_rect_01: {numbers(R_RECT_01)}\nP_rect_01: {numbers(P)}\n"
    )
    cameras = open_dataset(kitti_360).cameras
    assert list(cameras) == ["image_00", "image_01"]
    from_left = inverse(cameras["image_00"].T_camera_lidar)
    shift = np.eye(4)
    shift[:3, 3] = -0.6, -0.01, 0.02
    expected = moved(R_RECT_01) @ shift @ inverse(moved(R_RECT))
    np.testing.assert_allclose(cameras["image_01"].T_camera_lidar @ from_left, expected, atol=1e-9)
    assert cameras["image_01"].images == []
    np.testing.assert_array_equal(cameras["image_01"].times, DRIVE.times)


MEI = """%YAML:1.0
---
model_type: MEI
camera_name: image_02
image_width: 140
image_height: 120
mirror_parameters:
   xi: 2.2134
distortion_parameters:
   k1: 1.6798e-02
   k2: 1.6548e+00
   p1: 4.2223e-03
   p2: -8.2462e-03
projection_parameters:
   gamma1: 133.63
   gamma2: 132.9
   u0: 71.3
   v0: 60.25
"""


def write_fisheye(root: Path) -> np.ndarray:
    """Camera 02, which looks ahead here, and images whose colours tell their pixels."""
    (root / "calibration" / "image_02.yaml").write_text(MEI)
    T_camera = T_IMU_CAMERA0 @ inverse(moved(R_RECT))  # as the rectified camera 00
    file = root / "calibration" / "calib_cam_to_pose.txt"
    lines = [line for line in file.read_text().splitlines() if not line.startswith("image_02")]
    file.write_text("\n".join([*lines, f"image_02: {numbers(T_camera[:3])}"]) + "\n")
    v, u = np.mgrid[:120, :140]
    image = np.stack([u, v, u + v - 2], axis=-1).clip(0, 255).astype(np.uint8)
    folder = root / "data_2d_raw" / SEQUENCE / "image_02"
    (folder / "data_rgb").mkdir(parents=True)
    for k in range(2):
        cv2.imwrite(str(folder / "data_rgb" / f"{k:010d}.png"), image)
    (folder / "timestamps.txt").write_text("".join(date(t) for t in DRIVE.image_times[:2]))
    return image


def test_fisheyes_of_kitti_360_are_rectified(kitti_360: Path) -> None:
    image = write_fisheye(kitti_360)
    dataset = open_dataset(kitti_360)
    check(dataset, "kitti_360")
    assert list(dataset.cameras) == ["image_00", "fisheye_02"]
    stream = dataset.cameras["fisheye_02"]
    left = dataset.cameras["image_00"].T_camera_lidar
    np.testing.assert_allclose(stream.T_camera_lidar, left, atol=1e-9)
    found, K = stream.rectified_image(1), stream.camera.K
    assert found is not None
    assert np.degrees(2 * np.arctan(70 / K[0, 0])) > 115
    for x, y in [(0.0, 0.0), (1.4, 0.3), (-1.1, -1.3), (0.2, 1.2), (-1.5, 0.7)]:
        norm = np.sqrt(x * x + y * y + 1)  # the data set's own arithmetic, point by point
        mx, my = x / norm / (1 / norm + 2.2134), y / norm / (1 / norm + 2.2134)
        r2 = mx**2 + my**2
        radial = 1 + 1.6798e-2 * r2 + 1.6548 * r2**2
        p1, p2 = 4.2223e-3, -8.2462e-3
        px = 133.63 * (mx * radial + 2 * p1 * mx * my + p2 * (r2 + 2 * mx**2)) + 71.3
        py = 132.9 * (my * radial + p1 * (r2 + 2 * my**2) + 2 * p2 * mx * my) + 60.25
        u, v = K[0, 0] * x + K[0, 2], K[1, 1] * y + K[1, 2]
        seen = cv2.remap(found, np.float32([[u]]), np.float32([[v]]), cv2.INTER_LINEAR)[0, 0]
        np.testing.assert_allclose(seen[:2], [px, py], atol=1.3)
    assert not np.array_equal(found, image)


def test_an_image_of_a_fisheye_of_another_size(kitti_360: Path) -> None:
    write_fisheye(kitti_360)
    stream = open_dataset(kitti_360).cameras["fisheye_02"]
    cv2.imwrite(str(stream.images[1].file), np.zeros((30, 20, 3), np.uint8))
    with pytest.raises(DatasetError, match=r"0000000001\.png is 20x30 pixels, its calibration"):
        stream.rectified_image(1)


@pytest.mark.parametrize(
    "text",
    [MEI.replace("xi", "pi"), MEI.replace("140", "w"), MEI.replace("71.3", "x"), "nothing", ""]
    + ["%YAML:1.0\n{{[", "%YAML:1.0\n- 1\n"],
)
def test_a_broken_calibration_of_a_fisheye(kitti_360: Path, text: str) -> None:
    write_fisheye(kitti_360)
    (kitti_360 / "calibration" / "image_02.yaml").write_text(text)
    with pytest.raises(CalibrationError, match=r"image_02\.yaml (has no number|is no YAML)"):
        open_dataset(kitti_360)
