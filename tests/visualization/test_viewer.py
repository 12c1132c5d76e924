"""The 3D view: geometries are checked without a window."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from command_line import cli
from docdepth.datasets import open_dataset
from docdepth.errors import BackendError, InputError, MissingExtraError
from docdepth.geometry.camera import Camera
from docdepth.io.run_folder import RunFolder
from docdepth.io.tracks import read_tracks
from docdepth.visualization import viewer
from docdepth.visualization.drive_scene import (
    CameraView,
    back_project,
    class_colors,
    instance_colors,
    vote_colors,
)
from docdepth.visualization.viewer import RunView, exchange, scene_geometries
from small_drive import HEIGHT, WIDTH

CAMERA = Camera(np.array([(100.0, 0, 20), (0, 110, 15), (0, 0, 1)]), 40, 30)


@pytest.fixture
def open3d():
    return pytest.importorskip(
        "open3d", reason="Open3D (or a library it needs) is missing", exc_type=ImportError
    )


def test_back_projected_pixels_project_to_themselves() -> None:
    depth = np.full((30, 40), np.nan, np.float32)
    depth[3, 5], depth[20, 39] = 7.0, 50.0
    points = back_project(CAMERA, depth)
    pixels = points @ CAMERA.K.T
    np.testing.assert_allclose(pixels[:, :2] / pixels[:, 2:], [(5, 3), (39, 20)], atol=1e-9)
    np.testing.assert_array_equal(points[:, 2], [7, 50])
    with pytest.raises(InputError, match="does not fit"):
        back_project(CAMERA, depth.T)


def test_classes_have_a_colour_each() -> None:
    ground, road, static, dynamic = class_colors(np.array([0, 40, 50, 100], np.uint16))
    np.testing.assert_array_equal(ground, road)
    assert dynamic[0] > dynamic[1] > dynamic[2]  # orange
    assert np.ptp(static) == 0  # grey
    assert ground[2] > ground[1] > ground[0]  # blue


def test_votes_go_from_the_static_to_the_dynamic_colour() -> None:
    static, dynamic = class_colors(np.array([50, 100], np.uint16))
    votes = np.array([(9, 0), (0, 3), (2, 2), (0, 0)], np.uint16)
    found = vote_colors(votes[:, 0], votes[:, 1])
    np.testing.assert_allclose(found[:3], [static, dynamic, (static + dynamic) / 2])
    assert found[3].max() < 0.5


def test_tracks_have_a_colour_each_and_the_rest_is_dark() -> None:
    one, other, again, none = instance_colors(np.array([1, 2, 6, 0], np.uint16))
    np.testing.assert_array_equal(one, again)
    assert np.abs(one - other).max() > 0.3
    assert none.max() < 0.5


def test_geometries_are_in_the_world_frame(open3d) -> None:
    points = np.array([(1, 2, 3), (4, 5, 6)], np.float32)
    colors = class_colors(np.array([0, 100], np.uint16))
    poses = np.repeat(np.eye(4)[None], 3, axis=0)
    poses[:, 0, 3] = 0, 2, 4
    depth = np.full((30, 40), np.nan, np.float32)
    depth[15, 20] = 10.0  # the principal point
    T_world_camera = np.eye(4)
    T_world_camera[:3, 3] = 1, 1, 1
    views = [CameraView(CAMERA, T_world_camera, depth), CameraView(CAMERA, np.eye(4))]
    found = scene_geometries(points, colors, poses, views)
    assert list(found) == ["points", "trajectory", "camera 0", "depth 0", "camera 1"]
    np.testing.assert_allclose(np.asarray(found["points"].points), points)
    np.testing.assert_allclose(np.asarray(found["points"].colors), colors)
    np.testing.assert_allclose(np.asarray(found["trajectory"].points)[:, 0], (0, 2, 4))
    assert np.asarray(found["trajectory"].lines).tolist() == [[0, 1], [1, 2]]
    np.testing.assert_allclose(np.asarray(found["depth 0"].points), [(1, 1, 11)])
    image = np.full((30, 40, 3), (10, 20, 30), np.uint8)
    seen = CameraView(CAMERA, T_world_camera, depth, image)
    coloured = scene_geometries(points, colors, views=[seen])
    rgb = np.asarray(coloured["depth 0"].colors)
    np.testing.assert_allclose(rgb, [(30 / 255, 20 / 255, 10 / 255)])
    centre = np.asarray(found["camera 0"].points)[0]
    np.testing.assert_allclose(centre, (1, 1, 1), atol=1e-12)


def test_geometries_of_a_run(open3d, finished: tuple[Path, str]) -> None:
    run = RunFolder.open(finished[0])
    found, _ = RunView(run, frame=2).go(0)
    assert len(found["points"].points) == len(run.points(2))
    assert len(found["trajectory"].points) == 5
    assert [name for name in found if name.startswith("camera")] == ["camera 0"]
    depths = [g for name, g in found.items() if name.startswith("depth")]
    assert len(depths) == 1
    assert len(depths[0].points) > 0.5 * WIDTH * HEIGHT
    # The depth map lies on the sweep's points, not somewhere else in the world.
    away = depths[0].voxel_down_sample(1.0).compute_point_cloud_distance(found["points"])
    assert np.median(np.asarray(away)) < 1.0
    more, _ = RunView(run, frame=2, around=1, depth=False).go(0)
    assert list(more) == ["points", "tracks", "trajectory"]
    assert len(more["points"].points) > 2 * len(found["points"].points)
    with pytest.raises(InputError, match="sweeps 0 to 4, not 5"):
        RunView(run, frame=5)


def test_boxes_are_those_of_the_tracks_and_the_image_stands_in_the_frustum(open3d, finished, drive):
    run = RunFolder.open(finished[0])
    stream = open_dataset(drive).cameras["image_2"]
    found, _ = RunView(run, frame=2, color="instance", stream=stream).go(0)
    time = int(run.trajectory().times[2])
    tracks = [t for t in read_tracks(run.path / "tracks.csv") if t.covers(time)]
    lines = found["tracks"]
    corners = np.asarray(lines.points).reshape(len(tracks), 10, 3)[:, :8]
    for track, box in zip(tracks, corners, strict=True):
        local = (box - track.pose_at(time)[:3, 3]) @ track.pose_at(time)[:3, :3]
        np.testing.assert_allclose(np.ptp(local, axis=0), track.size, atol=1e-9)
        np.testing.assert_allclose(local.min(axis=0), (*-track.size[:2] / 2, 0), atol=1e-9)
    ends = np.asarray(lines.points)[np.asarray(lines.lines)]
    sides = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).reshape(len(tracks), 13)[:, :12]
    expected = [np.sort(np.repeat(track.size, 4)) for track in tracks]
    np.testing.assert_allclose(np.sort(sides, axis=1), expected, atol=1e-9)
    # The corners of the image lie on the rays of its corners, so on the lines of the frustum.
    centre, *frustum = np.asarray(found["camera 0"].points)
    for corner in np.asarray(found["image 0"].vertices):
        rays = np.array(frustum) - centre
        cosines = rays @ (corner - centre) / np.linalg.norm(rays, axis=1)
        assert cosines.max() / np.linalg.norm(corner - centre) > 0.9999
    record, classid = run.classified_frame(2)
    colors = np.asarray(found["points"].colors)
    np.testing.assert_allclose(colors, instance_colors(record.instance))
    assert not np.allclose(colors, class_colors(classid))


def test_keys_step_through_the_drive_and_change_the_colours(
    open3d, finished, tmp_path, monkeypatch
):
    shown = []

    def show(geometries, pose, image, keys, legend):
        shown.append((geometries, pose))
        for key in (262, 262, 263, ord("C"), 267, 266, ord("D")):
            shown.append(keys[key]())

    monkeypatch.setattr(viewer, "show", show)
    told: list[str] = []
    run = RunFolder.open(finished[0])
    RunView(run, frame=1, depth=False, tell=told.append).show()
    poses = run.trajectory().poses
    frames = [int(np.flatnonzero((poses == pose).all(axis=(1, 2)))[0]) for _, pose in shown]
    assert frames == [1, 2, 3, 2, 2, 4, 0, 0]
    # Open3D writes no text into its window, so each change is told.
    assert [text.split(",")[0] for text in told] == [f"sweep {k} of 0 to 4" for k in frames]
    assert "by class: blue ground" in told[3]
    assert "by votes: light grey static" in told[4]
    assert "depth 0" in shown[-1][0]
    assert "depth map" in told[-1]
    assert "depth map" not in told[-2]
    before, after = (np.asarray(shown[k][0]["points"].colors) for k in (3, 4))
    assert before.shape == after.shape
    assert not np.allclose(before, after)


def test_the_view_follows_the_vehicle(finished):
    class Window:
        """A window that remembers what is in it and where it looks from."""

        def __init__(self):
            self.extrinsic, self.shown = np.eye(4), []

        def get_view_control(self):
            return self

        def convert_to_pinhole_camera_parameters(self):
            return SimpleNamespace(extrinsic=self.extrinsic)

        def convert_from_pinhole_camera_parameters(self, view, allow_arbitrary):
            self.extrinsic = view.extrinsic

        def add_geometry(self, geometry, reset_bounding_box):
            self.shown.append(geometry)

        def remove_geometry(self, geometry, reset_bounding_box):
            self.shown.remove(geometry)

    before, after = (RunFolder.open(finished[0]).trajectory().poses[k] for k in (0, 4))
    window = Window()
    T_lidar_viewer = np.eye(4)
    T_lidar_viewer[:3, 3] = -5, 1, 3
    window.extrinsic = np.linalg.inv(before @ T_lidar_viewer)
    window.shown = ["old"]
    exchange(window, ({"points": "old"}, before), ({"points": "new"}, after))
    assert window.shown == ["new"]
    np.testing.assert_allclose(np.linalg.inv(window.extrinsic), after @ T_lidar_viewer, atol=1e-9)


def test_the_verb_names_the_image_and_prints_no_error(
    open3d, finished: tuple[Path, str], tmp_path: Path, monkeypatch, capfd
) -> None:
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    image = tmp_path / "view.png"
    made = cli("view", finished[0], "--image", image)
    if made.exit_code and "Open3D" in made.output:
        pytest.skip(made.output)
    assert made.output.replace("\n", "") == str(image)
    assert "error" not in "".join(capfd.readouterr())
    picture = cv2.imread(str(image))
    assert picture.std() > 5
    assert (picture[:80, :400] == 255).sum() > 300  # the legend, in the empty sky


def test_without_a_display_the_error_says_so(open3d, monkeypatch) -> None:
    monkeypatch.setattr(viewer, "_has_display", lambda: False)
    with pytest.raises(BackendError, match="no display"):
        viewer.show({}, np.eye(4))


def test_without_open3d_the_error_names_the_package(monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(MissingExtraError, match=r"docdepth\[viz\].*libusb"):
        scene_geometries(np.zeros((1, 3), np.float32), np.zeros((1, 3)))
