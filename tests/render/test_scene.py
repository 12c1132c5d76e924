"""Scene and render_depth: the same maps as a run, and errors that say what to change."""

from __future__ import annotations

import shutil
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from render_reference import (
    AXES,
    PAPER,
    TRIANGLES,
    compose_depth,
    drawing,
    render_sweep,
    small_camera,
)

from command_line import cli
from docdepth.config import Parameters, parameters
from docdepth.datasets import CameraStream, Sweep, open_dataset
from docdepth.dynamics.classes import Labels
from docdepth.dynamics.voting import Votes
from docdepth.errors import InputError
from docdepth.io.depth import read_depth
from docdepth.io.run_folder import RunFolder
from docdepth.io.tracks import tracks_in
from docdepth.render.scene import Scene, render_depth, render_layers
from docdepth.render.selection import needed_sweeps
from motion import pose, straight
from walled_yard import scan

LAYERS = ("class", "time", "range", "support", "std", "confidence")


def scene_of(run, drive):
    """The scene that a user would make of the sweeps and labels of a run."""
    folder, recording = RunFolder(run), open_dataset(drive)
    sweeps, labels = [], []
    for index in range(len(recording)):
        record, classid = folder.classified_frame(index)
        raw = recording.sweep(index)
        # All rows as they were recorded, the unusable ones unmoved; their class does not matter.
        points, classes = raw.points.copy(), np.full(len(raw.points), 50, np.uint16)
        points[record.index], classes[record.index] = record.points, classid
        rig, times = raw.sensor_rig, raw.relative_time
        sweeps.append(Sweep(points, raw.name, raw.time, None, times, rig, motion_compensated=True))
        instance = np.zeros(len(raw.points), np.uint16)
        if record.instance is not None:
            instance[record.index] = record.instance
        nobody = Votes(instance, instance)
        labels.append(Labels(classes, nobody, instance))
    tracks = tracks_in(folder.path)
    return Scene(sweeps, folder.trajectory(), labels, folder.parameters, tracks), recording


def test_a_sweep_that_was_cut_off_is_completed_where_the_vehicle_stands():
    """All sweeps are from one place, and that nearest in time stands for it."""
    whole = scan(pose(), 0.0, 2)[0].astype(np.float32)
    trajectory = straight(4, spacing=0.0)
    camera = CameraStream("front", small_camera(), AXES, trajectory.times, list("abcd"))
    maps = []
    for last in (whole, whole[whole[:, 2] > -0.5]):
        labels = [np.full(len(points), 50, np.uint16) for points in (whole, whole, whole, last)]
        scene = Scene([whole, whole, whole, last], trajectory, labels, tracks=())
        maps.append(render_depth(scene, camera, 3))
    drawn = [np.isfinite(depth) for depth in maps]
    assert drawn[0].mean() > 0.4
    assert np.mean(drawn[1] != drawn[0]) < 0.01  # along the cut
    off = np.abs(maps[1] / maps[0] - 1)[drawn[0] & drawn[1]]
    assert np.quantile(off, 0.9) < 1e-3


@pytest.mark.parametrize("preset", ["default", "paper"])
def test_a_scene_gives_what_a_run_writes(drive, finished, preset, tmp_path):
    run = tmp_path / "run"
    if preset == "default":
        shutil.copytree(finished[0], run)
        arguments = ("render", run)
    else:
        arguments = ("run", drive, "-o", run, "--preset", "paper")
    result = cli(*arguments, "--format", "npy", "--layers", ",".join(LAYERS))
    assert result.exit_code == 0, result.output
    scene, recording = scene_of(run, drive)
    camera = recording.cameras["image_2"]
    written = sorted((run / "depth").glob("*.npy"))
    assert len(written) >= 4
    for path in written:
        k = camera.names.index(path.stem)
        depth = render_depth(scene, camera, k)
        np.testing.assert_array_equal(depth, read_depth(path))
        assert depth.dtype == np.float32
        np.testing.assert_array_equal(
            render_depth(scene, camera, time=int(camera.times[k]), threads=1), depth
        )
        layers = render_layers(scene, camera, LAYERS, k, depth=depth)
        assert list(layers) == list(LAYERS)
        with np.load(run / "layers" / f"{path.stem}.npz") as kept:
            for name in LAYERS:
                np.testing.assert_array_equal(layers[name], kept[name])
    again = render_layers(scene, camera, ("class",), k)
    np.testing.assert_array_equal(again["class"], layers["class"])


class LazySweeps:
    """Sweeps that are made when read."""

    def __init__(self, count):
        self.count, self.asked, self.reading = count, [], 0
        self.lock = threading.Lock()

    def __len__(self):
        return self.count

    def __getitem__(self, index):
        with self.lock:
            self.asked.append(index)
            self.reading += 1
            assert self.reading == 1
        rng = np.random.default_rng(index)
        points = rng.uniform([3, -5, -2], [30, 5, 4], (500, 3)).astype(np.float32)
        with self.lock:
            self.reading -= 1
        return points


def camera_of(times, name="front"):
    names = [f"{i:06d}" for i in range(len(times))]
    return CameraStream(name, small_camera(), AXES, np.asarray(times, np.int64), names)


def asked_scene(count=60, render=TRIANGLES):
    classes = [np.full(500, 50, np.uint16)] * count
    return Scene(LazySweeps(count), straight(count, 0.5), classes, Parameters(render=render))


@pytest.mark.parametrize("render", [PAPER, TRIANGLES])
def test_sweeps_are_made_when_needed_and_forgotten_when_not(render):
    near = render.model_copy(update={"ahead": 5.0, "behind": 2.0})
    scene, camera = asked_scene(render=near), camera_of([1_000_000_000, 1_020_000_000, 10**9 * 4])
    needed = [set(needed_sweeps(scene.trajectory, int(t), near)) for t in camera.times]
    assert scene.sweeps.asked == []
    render_depth(scene, camera, 0)
    assert sorted(scene.sweeps.asked) == sorted(needed[0])
    render_depth(scene, camera, 0)
    assert len(scene.sweeps.asked) == len(needed[0])
    render_depth(scene, camera, 1)
    assert sorted(scene.sweeps.asked) == sorted(needed[0]) + sorted(needed[1] - needed[0])
    render_depth(scene, camera, 2)
    assert set(scene.sweeps_at(int(camera.times[2]))) == needed[2]
    assert {i for i, _ in scene._cache._sweeps} == needed[2]


def test_images_from_many_threads():
    scene, camera = asked_scene(), camera_of(np.arange(20) * 150_000_000)
    expected = [render_depth(asked_scene(), camera, k, threads=1) for k in range(20)]
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda k: render_depth(scene, camera, k), range(20)))
    for a, b in zip(found, expected, strict=True):
        np.testing.assert_array_equal(a, b)


def test_plain_arrays_are_a_scene():
    """As compose_depth on explicit frames, points that are no returns left out."""
    rng = np.random.default_rng(3)
    points = [rng.uniform([2, -5, -2], [30, 5, 4], (800, 3)).astype(np.float32) for _ in range(4)]
    points[1][5:8] = [[0, 0, 0], [np.nan, 1, 1], [0.3, 0, 0]]
    classes = [rng.choice([0, 50, 100], 800).astype(np.uint16) for _ in range(4)]
    usable = [np.ones(800, bool) for _ in range(4)]
    usable[1][5:8] = False
    trajectory, camera = straight(4), camera_of([130_000_000])
    for values in (parameters("default"), parameters("paper")):
        frames = [
            render_sweep(p[u], c[u], values.render)
            for p, c, u in zip(points, classes, usable, strict=True)
        ]
        expected = compose_depth(
            *drawing(frames, trajectory, 130_000_000, values.render, camera=camera.camera)
        )
        scene = Scene(points, trajectory, classes, values)
        np.testing.assert_array_equal(render_depth(scene, camera, -1), expected)
        assert np.isfinite(expected).any()


def test_what_a_scene_refuses():
    points, classes = np.zeros((3, 3), np.float32), np.zeros(3, np.uint16)
    with pytest.raises(InputError, match="2 sweeps need as many poses; the trajectory has 3"):
        Scene([points] * 2, straight(3), [classes] * 2)
    scene, camera = Scene([points] * 2, straight(2), [classes] * 2), camera_of([0, 10**9])
    with pytest.raises(InputError, match="camera front has 2 images; there is no image 2"):
        render_depth(scene, camera, 2)
    with pytest.raises(InputError, match=r"1000000000 ns lies outside the trajectory, .*100000000"):
        render_depth(scene, camera, 1)
    with pytest.raises(InputError, match="-1 ns lies outside"):
        render_depth(scene, camera, time=-1)
    for arguments in ({}, {"index": 0, "time": 0}):
        with pytest.raises(InputError, match="either the index of an image or a time"):
            render_depth(scene, camera, **arguments)
    with pytest.raises(InputError, match="unknown layer 'colour'"):
        render_layers(scene, camera, ("colour",), 0)
    wrong = Scene([points] * 2, straight(2), [classes, classes[:2]])
    for _ in range(2):  # and is not kept
        with pytest.raises(InputError, match=r"sweep 1: points \(3, 3\) .*\(2,\)"):
            render_depth(wrong, camera, 0)
    wrong = Scene([points.astype(int)] * 2, straight(2), [classes] * 2)
    with pytest.raises(InputError, match="sweep 0: points must be float32"):
        render_depth(wrong, camera, 0)
