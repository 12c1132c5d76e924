"""What a user passes from Python works, or ends in an error of docdepth that says what is wrong."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import docdepth
import docdepth.geometry.points as points_module
from docdepth.diagnostics.error_sources import find_error_sources
from docdepth.errors import NOTE, InputError
from docdepth.evaluation.held_out import evaluate_held_out
from docdepth.io.tracks import read_tracks
from motion import straight

TIMES = np.arange(4) * 10**8
K = [[500, 0, 320], [0, 500, 180], [0, 0, 1]]
CAMERA = docdepth.Camera(K, 640, 360)
T_CAMERA_LIDAR = [[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]]
STREAM = docdepth.CameraStream("front", CAMERA, T_CAMERA_LIDAR, TIMES, ["a", "b", "c", "d"])
RIGS = np.repeat(np.eye(4)[None], 301, axis=0)


POSES = straight(4, 0.5).poses
TRAJECTORY = docdepth.Trajectory(TIMES, POSES)


@pytest.fixture(scope="module")
def sweeps() -> list[np.ndarray]:
    """Level ground and a wall on the left."""
    x, y = np.meshgrid(np.linspace(-20, 20, 81), np.linspace(-20, 20, 81))
    ground = np.stack([x, y, np.full_like(x, -1.7)], -1).reshape(-1, 3)
    x, z = np.meshgrid(np.linspace(-20, 20, 161), np.linspace(-1.7, 3, 20))
    wall = np.stack([x, np.full_like(x, 10), z], -1).reshape(-1, 3)
    points = np.concatenate([ground, wall]).astype(np.float32)
    return [points - np.float32([0.5 * k, 0, 0]) for k in range(4)]


@pytest.fixture(scope="module")
def labels(sweeps) -> Any:
    return docdepth.classify_drive(sweeps, TRAJECTORY)


WRONG: dict[str, tuple[Callable[[list[np.ndarray]], Any], str]] = {
    "times in seconds": (lambda s: docdepth.Trajectory([0.0, 1.5, 2.2, 3.9], POSES), "nanosec"),
    "times are NaN": (lambda s: docdepth.Trajectory([0, np.nan, 2, 3], POSES), "integers"),
    "times too large": (
        lambda s: docdepth.Trajectory(np.uint64(2**63) + np.arange(4, dtype=np.uint64), POSES),
        "too large",
    ),
    "times are words": (lambda s: docdepth.Trajectory(list("abcd"), POSES), "integers"),
    "no poses": (lambda s: docdepth.Trajectory(TIMES, None), "poses"),
    "poses of two lengths": (lambda s: docdepth.Trajectory(TIMES, [[1, 2], [3]]), "numbers"),
    "times of two dimensions": (lambda s: TRAJECTORY.interpolate([[5, 6], [7, 8]]), "shape"),
    "a time in seconds": (lambda s: TRAJECTORY.interpolate(0.1), "nanoseconds"),
    "width of a camera": (lambda s: docdepth.Camera(K, 640.5, 360), "integers"),
    "no width": (lambda s: docdepth.Camera(K, None, 360), "integers"),
    "K of two lengths": (lambda s: docdepth.Camera([[1, 2], [3]], 640, 360), "3x3"),
    "K for the camera": (
        lambda s: docdepth.CameraStream("c", K, T_CAMERA_LIDAR, TIMES, "abcd"),
        "Camera",
    ),
    "3x4 extrinsic": (
        lambda s: docdepth.CameraStream("c", CAMERA, T_CAMERA_LIDAR[:3], TIMES, "abcd"),
        "4x4",
    ),
    "no extrinsic": (lambda s: docdepth.CameraStream("c", CAMERA, None, TIMES, "abcd"), "4x4"),
    "too few names": (
        lambda s: docdepth.CameraStream("c", CAMERA, T_CAMERA_LIDAR, TIMES, ["a"]),
        "names",
    ),
    "too few images": (
        lambda s: docdepth.CameraStream("c", CAMERA, T_CAMERA_LIDAR, TIMES, "abcd", [Path("a")]),
        "images",
    ),
    "names of a LiDAR": (lambda s: docdepth.LidarStream("l", TIMES, ["a"]), "names"),
    "sweep of four columns": (lambda s: docdepth.Sweep(np.c_[s[0], s[0]], "0", 0), "float32"),
    "sweep of integers": (lambda s: docdepth.Sweep(s[0].astype(int), "0", 0), "float32"),
    "times of other points": (
        lambda s: docdepth.Sweep(s[0], "0", 0, relative_time=np.zeros(3)),
        "one a point",
    ),
    "negative sensor": (lambda s: docdepth.SensorRig([-1, 0], RIGS[:1]), "sensor -1"),
    "half a sensor": (lambda s: docdepth.SensorRig([0.5, 0.7], RIGS[:1]), "integers"),
    "300 sensors": (lambda s: docdepth.SensorRig(np.full(5, 300), RIGS), "at most 256"),
    "arguments in the wrong order": (
        lambda s: docdepth.classify_drive(TRAJECTORY, s),
        "trajectory must be",
    ),
    "poses for a trajectory": (lambda s: docdepth.grow_ground(s, POSES), "trajectory must be"),
    "a generator": (lambda s: docdepth.grow_ground(iter(s), TRAJECTORY), "list or sequence"),
    "sweeps of lists": (
        lambda s: docdepth.grow_ground([x.tolist() for x in s], TRAJECTORY),
        "Sweep or a float32",
    ),
    "sweeps of integers": (
        lambda s: docdepth.grow_ground([x.astype(int) for x in s], TRAJECTORY),
        "float32",
    ),
    "no sweeps": (lambda s: docdepth.classify_drive([None] * 4, TRAJECTORY), "Sweep or a float32"),
    "a preset's name": (
        lambda s: docdepth.classify_drive(s, TRAJECTORY, "paper"),
        "docdepth.parameters",
    ),
    "settings in a list": (lambda s: docdepth.parameters("default", ["dynamics.window=3"]), "dict"),
    "a path for a dataset": (lambda s: docdepth.register_drive("drive"), "open_dataset"),
    "labels for the trajectory": (
        lambda s: docdepth.Scene(s, [None] * 4, TRAJECTORY),
        "trajectory must be",
    ),
    "no labels": (lambda s: docdepth.Scene(s, TRAJECTORY, None), "labels"),
    "no renderer": (lambda s: docdepth.Renderer(None), "str"),
    "a milliard of threads": (
        lambda s: docdepth.grow_ground(s, TRAJECTORY, threads=10**9),
        "threads is 1000000000: 0 .all cores. to 256",
    ),
    "half a thread": (
        lambda s: docdepth.classify_drive(s, TRAJECTORY, threads=1.5),
        "threads is 1.5",
    ),
    "masked poses": (
        lambda s: docdepth.Trajectory(TIMES, np.ma.masked_equal(POSES, POSES[1, 0, 3])),
        "frame 1 is not a rotation",
    ),
    "complex poses": (lambda s: docdepth.Trajectory(TIMES, POSES * (1 + 0j)), "real numbers"),
    "a time that is none": (
        lambda s: docdepth.Trajectory(np.array(["2020-01-01", "NaT"] * 2, "M8[ns]"), POSES),
        "NaT",
    ),
    "masked rows with names": (
        lambda s: docdepth.classify_drive([np.ma.array(np.zeros(9, "f4,f4,f4"))] * 4, TRAJECTORY),
        "masked",
    ),
    "masked times": (
        lambda s: docdepth.Trajectory(np.ma.masked_equal(TIMES, TIMES[1]), POSES),
        "masked; say what they are",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_argument_is_named(name: str, sweeps: list[np.ndarray]) -> None:
    call, said = WRONG[name]
    with pytest.raises(docdepth.DocDepthError, match=said):
        call(sweeps)


def test_wrong_arguments_of_rendering_are_named(sweeps, labels) -> None:
    scene = docdepth.Scene(sweeps, TRAJECTORY, labels)
    for arguments, said in [
        ((scene, CAMERA, 0), "CameraStream"),
        ((scene, "image_02", 0), "CameraStream"),
        ((STREAM, scene, 0), "Scene"),
        ((scene, STREAM, 1.0), "integer"),
        ((scene, STREAM, True), "integer"),
        ((scene, STREAM, None, 0.1), "nanoseconds"),
        ((scene, STREAM, 0, None, 0, "cpu"), "Renderer"),
    ]:
        with pytest.raises(docdepth.DocDepthError, match=said):
            docdepth.render_depth(*arguments)  # type: ignore[arg-type]


def test_a_wrong_scale_is_refused(tmp_path: Path) -> None:
    depth = np.full((3, 3), 5, np.float32)
    file = tmp_path / "a.png"
    for scale in (0, -1, np.nan, "256"):
        with pytest.raises(docdepth.DocDepthError, match="scale"):
            docdepth.write_depth(file, depth, scale=scale)  # type: ignore[arg-type]
    docdepth.write_depth(file, depth)
    with pytest.raises(docdepth.DocDepthError, match="scale"):
        docdepth.read_depth(file, scale=0)
    with pytest.raises(docdepth.DocDepthError, match="float32"):
        docdepth.write_depth(file, depth[:0])


def test_other_forms_of_the_same_values_are_understood(sweeps, labels) -> None:
    stamps = TIMES.astype("datetime64[ns]").astype("datetime64[ms]")
    same = docdepth.Trajectory(stamps, np.asfortranarray(POSES.astype(np.float32)))
    assert (same.times == TIMES).all()
    assert (same.poses == POSES).all()
    strided = [np.repeat(points, 2, axis=0)[::2] for points in sweeps]
    found = docdepth.classify_drive(strided, same)
    for one, other in zip(found, labels, strict=True):
        assert (one.classid == other.classid).all()


class OfAnotherLibrary:
    """An array that only DLPack reaches."""

    def __init__(self, array: np.ndarray) -> None:
        self.array = array

    def __dlpack__(self, **options: Any) -> Any:
        return self.array.__dlpack__(**options)

    def __dlpack_device__(self) -> Any:
        return self.array.__dlpack_device__()


@pytest.mark.parametrize(
    "form",
    [
        lambda points: points.astype(np.float64),
        lambda points: np.c_[points, np.ones(len(points), np.float32)],
        OfAnotherLibrary,
    ],
    ids=["doubles", "four columns", "DLPack"],
)
def test_points_are_taken_as_people_have_them(form, sweeps, labels, caplog) -> None:
    points_module._told.clear()
    caplog.set_level(NOTE)
    found = docdepth.classify_drive([form(points) for points in sweeps], TRAJECTORY)
    for one, other in zip(found, labels, strict=True):
        assert (one.classid == other.classid).all()
    said = [record for record in caplog.records if "are taken as float32 (N, 3)" in record.message]
    assert len(said) == (form is not OfAnotherLibrary)


def test_masked_points_are_no_returns(sweeps, labels) -> None:
    lost = [np.arange(len(points)) % 5 == 0 for points in sweeps]
    masked = [np.ma.array(s, mask=np.c_[k, k, k]) for s, k in zip(sweeps, lost, strict=True)]
    nan = [np.where(k[:, None], np.float32(np.nan), s) for s, k in zip(sweeps, lost, strict=True)]
    one, other = (
        docdepth.render_depth(docdepth.Scene(points, TRAJECTORY, labels), STREAM, 1)
        for points in (masked, nan)
    )
    assert np.array_equal(one, other, equal_nan=True)


def test_classes_are_taken_as_people_have_them(sweeps, labels) -> None:
    expected = docdepth.render_depth(docdepth.Scene(sweeps, TRAJECTORY, labels), STREAM, 1)
    for form in (np.uint8, np.int64):
        classes = [of.classid.astype(form) for of in labels]
        scene = docdepth.Scene(sweeps, TRAJECTORY, classes)
        depth = docdepth.render_depth(scene, STREAM, 1)
        assert np.array_equal(depth, expected, equal_nan=True)
    still = docdepth.Scene(sweeps, TRAJECTORY, [np.zeros(len(s), bool) for s in sweeps])
    classid = docdepth.render_layers(still, STREAM, "class", 1)["class"]
    assert set(np.unique(classid)) == {50, 255}
    wrong = docdepth.Scene(sweeps, TRAJECTORY, [np.full(len(s), -1) for s in sweeps])
    with pytest.raises(docdepth.DocDepthError, match="sweep 0: classes must be uint16, got int64"):
        docdepth.render_depth(wrong, STREAM, 1)


def test_inputs_of_a_run_are_files(drive: Path, tmp_path: Path) -> None:
    for poses in ([np.eye(4)] * 9, np.tile(np.eye(4), (9, 1, 1))):
        with pytest.raises(
            docdepth.DocDepthError, match=r"^a \w+ is not a path; give that of its .* file$"
        ):
            docdepth.run(drive, tmp_path / "run", poses=poses)
    with pytest.raises(
        docdepth.DocDepthError, match=r"frames is \[0, .{50,60}\.\.\.: Input should be"
    ):
        docdepth.run(drive, tmp_path / "run", frames=list(range(99)))


def test_a_sweep_has_a_time_in_nanoseconds() -> None:
    with pytest.raises(docdepth.DocDepthError, match=r"an integer, nanoseconds, not 0\.1"):
        docdepth.Sweep(np.zeros((9, 3), np.float32), "a", 0.1)


def test_poses_may_be_a_trajectory(drive: Path) -> None:
    dataset = docdepth.open_dataset(drive)
    assert dataset.poses is not None
    given = docdepth.Trajectory(dataset.times, dataset.poses)
    found = docdepth.register_drive(dataset, poses=given, poses_as_given=True).trajectory
    same = docdepth.register_drive(dataset, poses=dataset.poses, poses_as_given=True).trajectory
    assert (found.poses == same.poses).all()
    short = docdepth.Trajectory(dataset.times[:2], dataset.poses[:2])
    with pytest.raises(docdepth.DocDepthError, match="3 times lie outside the trajectory"):
        docdepth.register_drive(dataset, poses=short)


def test_the_callers_arrays_are_neither_kept_nor_changed(sweeps, labels) -> None:
    times, poses, matrix = TIMES.copy(), POSES.copy(), np.array(K, float)
    trajectory, camera = docdepth.Trajectory(times, poses), docdepth.Camera(matrix, 640, 360)
    poses[0, 0, 3], times[0], matrix[0, 0] = 99, -5, 1
    assert trajectory.poses[0, 0, 3] == trajectory.times[0] == 0
    assert camera.K[0, 0] == 500
    with pytest.raises(ValueError, match="read-only"):
        trajectory.poses[0, 0, 3] = 1
    for points in sweeps:
        points.setflags(write=False)
    docdepth.render_depth(docdepth.Scene(sweeps, TRAJECTORY, labels), STREAM, 1)


def test_rows_without_a_usable_return_are_static_and_change_nothing(sweeps, labels) -> None:
    gap = np.full((7, 3), np.nan, np.float32)
    gap[3:] = 0
    gaps = [np.insert(points, [100] * len(gap), gap, axis=0) for points in sweeps]
    kept = np.insert(np.ones(len(sweeps[0]), bool), [100] * len(gap), False)
    ground = docdepth.grow_ground(gaps, TRAJECTORY)
    found = docdepth.classify_drive(gaps, TRAJECTORY)
    for of_gaps, one, other in zip(ground, found, labels, strict=True):
        assert not of_gaps[~kept].any()
        assert (one.classid[kept] == other.classid).all()
        assert (one.votes.static[kept] == other.votes.static).all()
        assert (one.classid[~kept] == 50).all()
        assert not one.votes.static[~kept].any()
        assert one.instance is not None
        assert one.instance.shape == one.classid.shape


def test_every_object_says_in_a_line_what_it_is(sweeps, labels, drive: Path) -> None:
    dataset = docdepth.open_dataset(drive)
    objects = [
        TRAJECTORY,
        CAMERA,
        STREAM,
        docdepth.Sweep(sweeps[0], "0", 0),
        docdepth.SensorRig.single([0, 0, 1], len(sweeps[0])),
        labels[0],
        docdepth.Scene(sweeps, TRAJECTORY, labels),
        docdepth.Renderer(),
        dataset,
        dataset.sweep(0),
        *dataset.lidars.values(),
        *dataset.cameras.values(),
        docdepth.register_drive(dataset, poses=dataset.poses),
    ]
    for shown in map(repr, objects):
        assert "\n" not in shown
        assert len(shown) < 600
        assert " at 0x" not in shown
    assert repr(docdepth.LidarStream("top", TIMES[:2], ["a", "b"])) == (
        "LidarStream(name='top', times=[0, 100000000], names=['a', 'b'], "
        "T_lidar_sensor=float64 (4, 4))"
    )


def test_parameters_show_what_differs_from_their_preset() -> None:
    changed = docdepth.parameters("paper", {"render.ahead": 50, "output.format": "png,exr"})
    assert repr(docdepth.Parameters()) == "parameters('default')"
    assert str(docdepth.parameters("paper")) == "parameters('paper')"
    assert repr(changed) == (
        "parameters('paper', {'render.ahead': 50.0, 'output.format': ('png', 'exr')})"
    )
    assert eval(repr(changed), {"parameters": docdepth.parameters}) == changed


def test_the_format_of_a_recording_has_one_name(drive: Path, tmp_path: Path) -> None:
    """``dataset``, as ``--dataset``; Python itself says what is unknown."""
    assert docdepth.open_dataset(drive, dataset="semantic_kitti").name == "semantic_kitti"
    with pytest.raises(docdepth.DocDepthError, match="no recording of kitti_raw"):
        docdepth.run(drive, tmp_path / "run", dataset="kitti_raw")
    with pytest.raises(TypeError, match="unexpected keyword argument 'format'"):
        docdepth.open_dataset(drive, format="folder")  # type: ignore[call-arg]
    with pytest.raises(TypeError, match="unexpected keyword argument 'layout'"):
        docdepth.run(drive, tmp_path / "run", layout="folder")


def test_objects_of_arrays_can_be_compared_and_are_keys(sweeps, labels) -> None:
    for value in (TRAJECTORY, CAMERA, STREAM, labels[0], docdepth.Sweep(sweeps[0], "0", 0)):
        assert value != copy.deepcopy(value)
        assert {value: 1}[value] == 1


def test_loaders_may_take_scenes_and_datasets_to_workers(sweeps, labels, drive: Path) -> None:
    scene = docdepth.Scene(sweeps, TRAJECTORY, labels)
    depth = docdepth.render_depth(scene, STREAM, 1)
    for other in (pickle.loads(pickle.dumps(scene)), copy.deepcopy(scene)):
        assert np.array_equal(docdepth.render_depth(other, STREAM, 1), depth, equal_nan=True)
    dataset = docdepth.open_dataset(drive)
    sent = pickle.loads(pickle.dumps(docdepth.register_drive(dataset, poses=dataset.poses)))
    assert (sent.sweeps[1].points == dataset.sweep(1).points).all()


def test_labels_and_depth_are_those_of_a_run(drive: Path, finished: tuple[Path, str]) -> None:
    """To the last bit with the tracks of the run, which its table rounds."""
    run = docdepth.open_run(finished[0])
    dataset = docdepth.open_dataset(drive)
    odometry = docdepth.register_drive(dataset)
    labels = docdepth.classify_drive(odometry.sweeps, odometry.trajectory)
    for k, of_sweep in enumerate(labels):
        frame = run.sweeps[k]
        assert (of_sweep.classid[frame.index] == frame.classid).all()
        assert (of_sweep.instance[frame.index] == frame.instance).all()
    tracks = read_tracks(run.path / "tracks.csv")
    assert len(labels.tracks) == len(tracks) > 0
    scene = docdepth.Scene(odometry.sweeps, run.trajectory, labels, tracks=tracks)
    camera = dataset.cameras["image_2"]
    for k in (1, 2):
        written = docdepth.read_depth(run.path / "depth" / f"{camera.names[k]}.png")
        made = docdepth.render_depth(scene, camera, k)
        assert (np.isnan(made) == np.isnan(written)).all()
        known = ~np.isnan(made)
        assert (np.rint(made[known] * 256) == np.rint(written[known] * 256)).all()


def test_figures_take_a_run_or_its_path(finished: tuple[Path, str]) -> None:
    run = docdepth.open_run(finished[0])
    figures = [find_error_sources(one) for one in (run, run.path, str(run.path))]
    assert len({str(found) for found in figures}) == 1
    held_out = [evaluate_held_out(one, every=2) for one in (run, run.path, str(run.path))]
    assert len({str(found.as_dict()) for found in held_out}) == 1


@pytest.mark.parametrize("shape", [(3, 100), (4, 100), (100, 5)])
def test_the_remedy_for_points_of_another_shape_is_true(shape: tuple[int, int]) -> None:
    """Followed as it is written, it gives the same points."""
    rows = np.random.default_rng(0).normal(size=(100, 5)).astype(np.float32)
    points = rows[:, : shape[0]].T if shape[1] == 100 else rows
    with pytest.raises(InputError) as error:
        points_module.check_points(points)
    given = _follow(str(error.value), points)
    np.testing.assert_array_equal(points_module.check_points(given), rows[:, :3])


@pytest.mark.parametrize("count", [3, 4, 9])
def test_the_remedy_for_points_that_are_integers_is_true(count: int) -> None:
    """Also of as few points as there are columns."""
    points = np.arange(3 * count).reshape(count, 3)
    with pytest.raises(InputError) as error:
        points_module.check_points(points)
    given = _follow(str(error.value), points)
    np.testing.assert_array_equal(points_module.check_points(given), points)


def _follow(message: str, points: np.ndarray) -> Any:
    return eval(message.split(": ")[-1], {"np": np, "points": points})
