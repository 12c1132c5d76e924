"""``docdepth run --calibration`` takes a calibration in place of the recording's own."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from command_line import cli
from docdepth.errors import CalibrationError
from docdepth.geometry.camera import Camera
from docdepth.geometry.se3 import rotation_exp
from docdepth.io.calibration import read_camera_calibration, write_calibration
from docdepth.io.inputs import RunInputs
from docdepth.io.poses import write_kitti
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline.cameras import open_cameras
from docdepth.pipeline.plan import states
from docdepth.pipeline.run_inputs import open_inputs, open_recording
from motion import straight
from small_drive import HEIGHT, SWEEPS, WIDTH, write_small_drive

K = np.array([(62.0, 0.0, 47.0), (0.0, 61.0, 20.5), (0.0, 0.0, 1.0)])
T = np.eye(4)
T[:3, :3] = np.array([(0, -1, 0), (0, 0, -1), (1, 0, 0)]) @ rotation_exp((0.0, 0.02, 0.01))
T[:3, 3] = (0.05, -0.1, -0.2)
MORE: dict[str, object] = {"camera": "image_2", "T_camera_lidar": T.tolist()}


@pytest.fixture(scope="module")
def drive(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("given")
    write_kitti(folder / "poses.txt", straight(SWEEPS, 0.5).poses)
    return write_small_drive(folder / "drive")


@pytest.fixture
def calibration(tmp_path: Path) -> Path:
    write(tmp_path / "calibration")
    return tmp_path / "calibration" / "calib.json"


def write(folder: Path, T_camera_lidar=T, more=MORE, size=(WIDTH, HEIGHT)) -> None:
    folder.mkdir(exist_ok=True)
    write_calibration(folder, Camera(K, *size), T_camera_lidar, more=more)


def run(drive: Path, output: Path, *more: object):
    return cli("run", drive, "-o", output, "--poses", drive.parent / "poses.txt", *more)


def source(drive: Path, **more: object) -> RunInputs:
    return RunInputs(recording=drive, **more)


def test_maps_are_those_of_a_recording_with_this_calibration(drive, calibration, tmp_path):
    other = tmp_path / "drive"
    shutil.copytree(drive, other)
    shutil.copy(drive.parent / "poses.txt", tmp_path)
    rows = " ".join(repr(x) for x in T[:3].ravel().tolist())
    P = " ".join(repr(x) for x in np.column_stack([K, np.zeros(3)]).ravel().tolist())
    (other / "calib.txt").write_text(f"P2: {P}\nTr: {rows}\n")
    shutil.rmtree(other / "image_3")
    assert run(other, tmp_path / "own").exit_code == 0
    options = ("--camera", "image_2", "--calibration")
    assert run(drive, tmp_path / "given", *options, calibration).exit_code == 0
    assert run(drive, tmp_path / "plain", "--camera", "image_2").exit_code == 0
    names = sorted(file.name for file in (tmp_path / "own" / "depth").glob("*.png"))
    assert names
    maps = {run: [(tmp_path / run / "depth" / name).read_bytes() for name in names]
            for run in ("own", "given", "plain")}  # fmt: skip
    assert maps["given"] == maps["own"]
    assert maps["given"] != maps["plain"]


def test_a_run_goes_on_with_its_calibration(drive, calibration, tmp_path):
    output, options = tmp_path / "run", ("--camera", "image_2", "--calibration")
    assert run(drive, output, *options, calibration).exit_code == 0
    manifest = yaml.safe_load((output / "run.yaml").read_text())
    assert manifest["inputs"]["calibration"] == str(calibration)
    kept = {file: file.stat().st_mtime_ns for file in (output / "depth").iterdir()}
    assert run(drive, output, *options, calibration).exit_code == 0
    assert cli("run", output).exit_code == 0
    assert cli("run", "--config", output / "run.yaml", "-o", output).exit_code == 0
    assert {file: file.stat().st_mtime_ns for file in (output / "depth").iterdir()} == kept
    refused = run(drive, output, "--camera", "image_2")
    assert refused.exit_code == 2
    assert "calibration" in str(refused.exception)
    # Another calibration in the same file makes the maps out of date, and nothing else.
    write(calibration.parent, rotated(), {**MORE, "T_camera_lidar": rotated().tolist()})
    found = {state.name: state.state for state in states(RunFolder.open(output))}
    assert found == {"odometry": "done", "classify": "done", "render image_2": "out of date"}


def rotated() -> np.ndarray:
    other = T.copy()
    other[:3, :3] = rotation_exp((0.0, 0.01, 0.0)) @ T[:3, :3]
    return other


def test_a_run_without_the_option_has_no_entry(drive, tmp_path):
    """Runs that were started before there was one go on."""
    assert run(drive, tmp_path / "run").exit_code == 0
    assert RunFolder.open(tmp_path / "run").inputs.calibration is None


def test_a_text_file_gives_the_extrinsic_alone(drive, calibration, tmp_path):
    file = calibration.with_name("calib_lidar_ref_cam.txt")
    with pytest.raises(CalibrationError, match=r"a camera without a name.*has image_2, image_3"):
        open_recording(source(drive, calibration=str(file)))
    asked = open_recording(source(drive, calibration=str(file), camera="image_3"))
    np.testing.assert_array_equal(asked.cameras["image_3"].T_camera_lidar, T)
    assert not np.array_equal(asked.cameras["image_2"].T_camera_lidar, T)
    seeing = tmp_path / "seeing"  # image_3 has a calibration and no images
    shutil.copytree(drive, seeing)
    shutil.rmtree(seeing / "image_3")
    stream = open_recording(source(seeing, calibration=str(file))).cameras["image_2"]
    np.testing.assert_array_equal(stream.T_camera_lidar, T)
    alone = tmp_path / "drive"
    shutil.copytree(drive, alone)
    calib = (alone / "calib.txt").read_text().splitlines()
    (alone / "calib.txt").write_text("\n".join(row for row in calib if "P3" not in row))
    shutil.rmtree(alone / "image_3")
    plain = open_recording(source(alone)).cameras["image_2"]
    stream = open_recording(source(alone, calibration=str(file))).cameras["image_2"]
    np.testing.assert_array_equal(stream.T_camera_lidar, T)
    np.testing.assert_array_equal(stream.camera.K, plain.camera.K)


def test_the_extrinsic_may_stand_beside_k(drive, tmp_path):
    write(tmp_path / "c", more={"camera": "image_3"})
    given = source(drive, calibration=str(tmp_path / "c" / "calib.json"), frames="1:3")
    recording = open_recording(given)
    (stream,) = open_cameras(given, recording, ["image_3"])
    np.testing.assert_array_equal(stream.T_camera_lidar, T)
    np.testing.assert_array_equal(stream.camera.K, K)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"size": [64, 40]}, "is of images of 64x40 pixels, those of image_2 in .* are 96x40"),
        ({"camera": "front"}, "is of the camera front, .* has image_2, image_3"),
        ({"model": "omni"}, "model is 'omni', not pinhole or fisheye"),
        ({"mtx": [[1, 2], [3]]}, "calib.json is damaged"),
        ({"T_camera_lidar": [[1, 0, 0, 0]]}, "must be a 4x4 matrix"),
        ({"T_camera_lidar": [[1, 0, 0, 0], [0]]}, "calib.json is damaged"),
        ({"T_camera_lidar": (2 * np.eye(4)).tolist()}, "a 4x4 rotation and translation in metres"),
    ],
)
def test_files_that_do_not_fit(drive, calibration, change, message):
    entries = json.loads(calibration.read_text()) | change
    calibration.write_text(json.dumps(entries))
    with pytest.raises(CalibrationError, match=message):
        open_inputs(source(drive, calibration=str(calibration)))


def test_a_missing_file_is_told_with_all_other_problems(drive, tmp_path):
    refused = run(drive, tmp_path / "run", "--calibration", tmp_path / "none.json")
    assert refused.exit_code == 2
    assert "none.json is missing" in str(refused.exception)
    with pytest.raises(CalibrationError, match=r"none.txt is missing"):
        read_camera_calibration(tmp_path / "none.txt")


def test_a_camera_that_nobody_has_calibrated(tmp_path, calibration, caplog):
    folder = tmp_path / "folder"
    for name in ("sweeps", "front"):
        (folder / name).mkdir(parents=True)
    for k in range(3):
        np.save(folder / "sweeps" / f"{k}.npy", np.full((9, 3), 5.0, np.float32))
        cv2.imwrite(str(folder / "front" / f"{k}.png"), np.zeros((HEIGHT, WIDTH, 3), np.uint8))
    settings = {"sweeps": "sweeps", "rate": 10, "motion_compensated": True,
                "cameras": {"front": {"images": "front", "times": "sweeps"}}}  # fmt: skip
    (folder / "docdepth.yaml").write_text(yaml.safe_dump(settings))
    with pytest.raises(CalibrationError, match=r"calibrate.*finds those of front"):
        open_inputs(source(folder))
    assert "front has no K" in caplog.text
    # The only camera takes a calibration of another name.
    (stream,) = open_inputs(source(folder, calibration=str(calibration))).cameras
    assert stream.name == "front"
    np.testing.assert_array_equal(stream.camera.K, K)
    np.testing.assert_array_equal(stream.T_camera_lidar, T)
    assert stream.distortion is None
    entries = json.loads(calibration.read_text())
    entries |= {"dist": [0.1, 0.0, 0.0, 0.0], "model": "fisheye"}
    calibration.write_text(json.dumps(entries))
    (stream,) = open_inputs(source(folder, calibration=str(calibration))).cameras
    assert stream.model == "fisheye"
    assert stream.rectified_image(0) is not None
