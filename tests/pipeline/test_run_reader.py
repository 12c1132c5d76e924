"""A run is read as arrays: compared with its files, with the truth, and with what was drawn."""

from __future__ import annotations

import pickle
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

import docdepth
from command_line import cli
from docdepth.io.ply import read_vertices
from docdepth.pipeline.cloud_map import write_map
from docdepth.pipeline.run_reader import RunImages
from docdepth.render.layers import LAYERS


@pytest.fixture(scope="module")
def run(finished: tuple[Path, str]) -> docdepth.Run:
    return docdepth.open_run(finished[0])


@pytest.fixture(scope="module")
def images(run: docdepth.Run) -> RunImages:
    return run.cameras["image_2"]


@pytest.fixture
def copy(run: docdepth.Run, tmp_path: Path) -> Path:
    return Path(shutil.copytree(run.path, tmp_path / "copy"))


def test_an_image_is_that_of_the_files(run: docdepth.Run, images: RunImages, drive: Path) -> None:
    assert len(images) == 4
    for k, image in enumerate(images):
        assert image.name == f"{k:06d}"
        photo = cv2.imread(str(drive / "image_2" / f"{image.name}.png"))
        assert photo is not None
        assert np.array_equal(image.image, photo[..., ::-1])
        steps = cv2.imread(str(run.path / "depth" / f"{image.name}.png"), cv2.IMREAD_UNCHANGED)
        assert steps is not None
        assert image.depth.dtype == np.float32
        assert np.array_equal(np.isnan(image.depth), steps == 0)
        assert np.array_equal(np.nan_to_num(image.depth), steps / np.float32(256))
        assert image.depth.shape == photo.shape[:2]


def test_cameras_stand_where_they_truly_are(images: RunImages, drive: Path) -> None:
    """Within the error of odometry, a decimetre on this drive, and of a turn of 0.5 degrees."""
    truth = docdepth.open_dataset(drive)
    assert truth.poses is not None
    stream = truth.cameras["image_2"]
    T = docdepth.Trajectory(truth.times, truth.poses)
    T_camera_lidar = stream.T_camera_lidar
    origin = np.linalg.inv(T.poses[0])
    for k, image in enumerate(images):
        assert image.time == stream.times[k]
        assert np.array_equal(image.K, stream.camera.K)
        true = origin @ T.interpolate(image.time)[0] @ np.linalg.inv(T_camera_lidar)
        assert np.abs(image.T_world_camera[:3, 3] - true[:3, 3]).max() < 0.1
        assert np.abs(image.T_world_camera[:3, :3] - true[:3, :3]).max() < 0.01


def test_sequences_count_from_the_end_and_are_cut(run: docdepth.Run, images: RunImages) -> None:
    assert images[-1].name == images[np.int64(3)].name == "000003"
    assert [image.name for image in images[1:3]] == ["000001", "000002"]
    assert images[0] is not images[0]
    assert len(run.sweeps[1:]) == len(run.sweeps) - 1 == 4
    assert np.array_equal(run.sweeps[-5].points, run.sweeps[0].points)
    for wrong in (4, -5):
        with pytest.raises(IndexError, match="there are 4 images of image_2"):
            images[wrong]
    for strange in ("000001", np.array([0, 1]), True):
        with pytest.raises(docdepth.DocDepthError, match="integers"):
            images[strange]  # type: ignore[call-overload]


def test_sweeps_have_the_classes_of_the_labels(run: docdepth.Run) -> None:
    for k, sweep in enumerate(run.sweeps):
        labels = np.fromfile(run.path / "labels" / f"{k:06d}.label", np.uint32)[sweep.index]
        assert np.array_equal(sweep.classes >= 100, labels & 0xFFFF == 251)
        assert np.array_equal(sweep.instance, labels >> 16)
        assert sweep.points.shape == (len(labels), 3)
    assert run.tracks
    seen = np.unique(np.concatenate([s.instance for s in run.sweeps if s.instance is not None]))
    assert set(seen.tolist()) - {0} <= set(run.tracks)


def test_layers_are_drawn_as_a_run_stores_them(run: docdepth.Run, drive: Path, tmp_path) -> None:
    other = tmp_path / "layers"
    result = cli("run", drive, "-o", other, "--layers", ",".join(LAYERS))
    assert result.exit_code == 0, result.output
    shutil.rmtree(other / "frames")  # so that nothing can be drawn
    stored = docdepth.open_run(other).cameras["image_2"]
    for image, same in zip(run.cameras["image_2"], stored, strict=True):
        assert list(image.layers) == list(LAYERS)
        for name, array in image.layers.items():
            assert np.array_equal(array, same.layers[name], equal_nan=array.dtype.kind == "f"), name
        classid = np.load(other / "layers" / f"{image.name}.npz")["class"]
        assert np.array_equal(image.moving, classid == 100)
    assert any(image.moving.any() for image in stored)
    with pytest.raises(KeyError):
        image.layers["colour"]


def test_the_static_map_is_that_of_the_verb(run: docdepth.Run, copy: Path) -> None:
    rows, _ = read_vertices(write_map(docdepth.open_run(copy).folder, 0.2))
    found = run.static_map(0.2)
    assert np.array_equal(found.points, np.stack([rows[name] for name in "xyz"], axis=1))
    assert np.array_equal(found.classid, rows["classid"])
    assert np.array_equal(found.counts, rows["points"])
    world = [
        (s.points @ T[:3, :3].T + T[:3, 3])[s.classes < 100]
        for s, T in zip(run.sweeps, run.trajectory.poses, strict=True)
    ]
    assert found.counts.sum() == sum(map(len, world))
    mean = (found.points * found.counts[:, None]).sum(0) / found.counts.sum()
    assert np.allclose(mean, np.concatenate(world).mean(0), atol=1e-3)


def test_it_can_be_sent_to_workers_and_shown(run: docdepth.Run, images: RunImages) -> None:
    for image in (images[2], docdepth.open_run(run).cameras["image_2"][2]):
        assert np.array_equal(image.layers["class"], images[2].layers["class"])  # makes a scene
        sent = pickle.loads(pickle.dumps(image))
        assert np.array_equal(sent.depth, image.depth, equal_nan=True)
        assert np.array_equal(sent.image, image.image)
    assert (
        repr(run)
        == f"<Run {run.path}: 5 sweeps, {len(run.tracks)} tracks, cameras: image_2 (4 images)>"
    )
    picture = cv2.imdecode(np.frombuffer(images[2]._repr_jpeg_(), np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    assert picture.shape[1] == images.camera.width


def test_reading_writes_nothing(copy: Path) -> None:
    def files() -> dict[Path, tuple[int, int]]:
        return {f: (f.stat().st_size, f.stat().st_mtime_ns) for f in sorted(copy.rglob("*"))}

    before, run = files(), docdepth.open_run(copy)
    image = run.cameras["image_2"][1]
    assert image.image is not None
    assert image.moving.shape == image.depth.shape
    run.static_map()
    assert files() == before


def test_what_is_wrong_is_one_error(copy: Path, tmp_path: Path) -> None:
    with pytest.raises(docdepth.DocDepthError, match="holds no run"):
        docdepth.open_run(tmp_path / "none")
    with pytest.raises(docdepth.DocDepthError, match=r"depth holds no run; name .*, which"):
        docdepth.open_run(copy / "depth")
    (copy / "depth" / "000001.png").unlink()
    (copy / "depth" / "000002.png").write_bytes(b"no image")
    images = docdepth.open_run(copy).cameras["image_2"]
    with pytest.raises(docdepth.DocDepthError, match=r"000001\.png is missing"):
        _ = images[1].depth
    with pytest.raises(docdepth.DocDepthError, match=r"000002\.png is not a readable image"):
        _ = images[2].depth
    (copy / "traj_odometry.ply").write_bytes(b"ply\n")
    with pytest.raises(docdepth.DocDepthError, match=r"traj_odometry\.ply"):
        docdepth.open_run(copy)


def test_a_run_without_its_recording_lacks_the_photos_alone(copy: Path) -> None:
    for file in (copy / "run.yaml", copy / ".docdepth" / "run.yaml"):
        tree = yaml.safe_load(file.read_text())
        tree["inputs"]["recording"] = "/away/drive"
        file.write_text(yaml.safe_dump(tree))
    image = docdepth.open_run(copy).cameras["image_2"][0]
    assert image.moving.shape == image.depth.shape
    with pytest.raises(
        docdepth.DocDepthError, match=r"/away/drive, the recording of .* is not there"
    ):
        _ = image.image


def test_maps_that_are_not_done_are_told(copy: Path) -> None:
    for file in (copy / "run.yaml", copy / ".docdepth" / "run.yaml"):
        tree = yaml.safe_load(file.read_text())
        tree["stages"]["render image_2"]["state"] = "running"
        file.write_text(yaml.safe_dump(tree))
    run = docdepth.open_run(copy)
    assert len(run.sweeps[0])
    with pytest.raises(docdepth.DocDepthError, match=r"depth maps of image_2 .* are not done"):
        _ = run.cameras
