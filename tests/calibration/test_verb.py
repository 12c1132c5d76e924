"""``docdepth calibrate`` from images and sweeps on disk to files that ``docdepth run`` takes."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from boards import BOARD, LENS, T_CAMERA_LIDAR, all_poses, picture, sweep_of

from command_line import cli
from docdepth.calibration.pairs import board_pairs
from docdepth.calibration.quality import difference
from docdepth.datasets import image_streams, open_dataset
from docdepth.io.calibration import EXTRINSICS, read_camera_calibration

BOARD_OPTIONS = ("--corners", "4x6", "--square", "0.12", "--board", "0.68x0.96")
COUNT = 6


@pytest.fixture(scope="module")
def images() -> list[np.ndarray]:
    rng = np.random.default_rng(1)
    return [picture(BOARD, LENS, T_CAMERA_LIDAR @ T, rng) for T in all_poses()[:COUNT]]


def write(folder: Path, images: list[np.ndarray], **camera: object) -> Path:
    for name in ("images", "sweeps"):
        (folder / name).mkdir(parents=True)
    for k, (image, T) in enumerate(zip(images, all_poses(), strict=False)):
        cv2.imwrite(str(folder / "images" / f"pose{k}.png"), image)
        np.save(folder / "sweeps" / f"pose{k}.npy", sweep_of(T).astype(np.float32))
    front = {"images": "images", "times": "sweeps", **camera}
    settings = {"sweeps": "sweeps", "rate": 1, "cameras": {"front": front}}
    (folder / "docdepth.yaml").write_text(yaml.safe_dump(settings))
    return folder


def test_from_files_to_a_calibration(images, tmp_path):
    lens = {"K": LENS.K.tolist(), "distortion": LENS.distortion.tolist()}
    boards = write(tmp_path / "boards", images, **lens)
    cv2.imwrite(str(boards / "images" / "pose2.png"), images[2][:, :260].repeat(3, axis=1)[:, :640])
    ended = cli("calibrate", boards, *BOARD_OPTIONS, "-o", tmp_path / "out")
    assert ended.exit_code == 0
    text = " ".join(ended.output.split())
    assert "not used: pose2: no whole checkerboard of 4x6 inner corners" in text
    assert "pinhole, K given: fx 420.0" in text
    assert "docdepth run RECORDING --calibration" in text
    found = read_camera_calibration(tmp_path / "out" / "calib.json")
    degrees, centimetres = difference(found.T_camera_lidar, T_CAMERA_LIDAR)
    assert degrees < 0.1
    assert centimetres < 0.6
    assert found.name == "front"
    assert found.camera is not None
    np.testing.assert_array_equal(found.camera.K, LENS.K)
    np.testing.assert_array_equal(found.distortion, LENS.distortion)
    np.testing.assert_array_equal(np.loadtxt(tmp_path / "out" / EXTRINSICS), found.T_camera_lidar)
    quality = json.loads((tmp_path / "out" / "calib.json").read_text())["quality"]
    assert sorted(quality["boards"]) == ["pose0", "pose1", "pose3", "pose4", "pose5"]
    assert list(quality["not_used"]) == ["pose2"]
    assert all(one["left_out_px"] < 2 for one in quality["boards"].values())
    # The returns lie on the board in the picture: green, as what is a few metres away.
    picture = cv2.imread(str(tmp_path / "out" / "pose0.jpg")).astype(int)
    T = T_CAMERA_LIDAR @ all_poses()[0]
    u, v = np.rint(LENS.project(T[None, :3, 3])[0]).astype(int)
    patch = picture[v - 12 : v + 12, u - 12 : u + 12]
    assert (patch[..., 1] > patch[..., 0] + 60).mean() > 0.3
    assert sorted(f.name for f in (tmp_path / "out").glob("*.jpg")) == [
        f"pose{k}.jpg" for k in range(COUNT)
    ]


def test_pairs_of_a_bag(images, tmp_path, monkeypatch):
    """Its CameraInfo gives K; it has no transform, which calibration is for."""
    pytest.importorskip("rosbags")
    monkeypatch.syspath_prepend(str(Path(__file__).parents[1] / "datasets"))
    from bags import BagWriter

    with BagWriter(tmp_path / "boards", "mcap") as bag:
        for k, (image, T) in enumerate(zip(images, all_poses(), strict=False)):
            time = int(1e9) * (1000 + 10 * k)
            points = sweep_of(T).astype(np.float32)
            rows = np.empty(len(points), [("x", "<f4"), ("y", "<f4"), ("z", "<f4")])
            for axis in range(3):
                rows["xyz"[axis]] = points[:, axis]
            bag.write("/points", bag.cloud(rows, time), time)
            bag.write("/cam/image_raw", bag.image(image, time + 100), time + 100)
            info = bag.camera_info(LENS.K, LENS.distortion, (640, 400), time, "plumb_bob")
            bag.write("/cam/camera_info", info, time)
    recording = open_dataset(tmp_path / "boards")
    stream = image_streams(recording)["cam"]
    assert stream.camera is not None
    np.testing.assert_array_equal(stream.camera.K, LENS.K)
    pairs, size = board_pairs(recording, stream, BOARD)
    assert size == (640, 400)
    assert len(pairs) == COUNT
    for pair, T in zip(pairs, all_poses(), strict=False):
        assert pair.corners is not None
        np.testing.assert_array_equal(pair.sweep.points, sweep_of(T).astype(np.float32))


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (("--box", "1,2,3"), "must be x,x,y,y,z,z, least and greatest of each, in metres"),
        (("--box", "pose1:2,1,0,1,0,1"), "must be x,x,y,y,z,z"),
        (("--box", "pose9:1,2,0,1,0,1"), "`boxes` names pose9, but front has no such image"),
        (("--camera", "back"), "has no images of back; name one of front"),
        (("--corners", "5x7", "--square", "0.1"), "of 4x6 inner corners, not 5x7"),
        (("--square", "12"), "do not fit on a board of 0.68 x 0.96 m.*in metres"),
    ],
)
def test_options_that_cannot_be(images, tmp_path, more, message):
    boards = write(tmp_path / "boards", images[:4])
    arguments = [*BOARD_OPTIONS, *more]
    ended = cli("calibrate", boards, *arguments, "-o", tmp_path / "out")
    assert ended.exit_code == 2
    with pytest.raises(type(ended.exception), match=message):
        raise ended.exception
    assert not (tmp_path / "out").exists()


def test_a_fisheye_needs_its_distortion(images, tmp_path):
    """Where K is given; else both are estimated."""
    boards = write(tmp_path / "boards", images[:4], model="fisheye", K=LENS.K.tolist())
    ended = cli("calibrate", boards, *BOARD_OPTIONS, "-o", tmp_path / "out")
    assert "front: the distortion of a fisheye is k1 k2 k3 k4" in str(ended.exception)


def test_pictures_do_not_replace_images(images, tmp_path):
    boards = write(tmp_path / "boards", images[:4])
    ended = cli("calibrate", boards, *BOARD_OPTIONS, "-o", boards / "images")
    assert "holds the images of front; choose another folder" in str(ended.exception)


def test_a_recording_without_images(tmp_path):
    (tmp_path / "boards").mkdir()
    np.save(tmp_path / "boards" / "a.npy", np.full((5, 3), 3.0, np.float32))
    (tmp_path / "boards" / "docdepth.yaml").write_text("rate: 1\nmotion_compensated: true\n")
    ended = cli("calibrate", tmp_path / "boards", *BOARD_OPTIONS, "-o", tmp_path / "out")
    assert "has no images; for a folder say cameras:" in str(ended.exception)
