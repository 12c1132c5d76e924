"""The 3D view: geometries are checked without a window."""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from docdepth.errors import BackendError, InputError, MissingExtraError
from docdepth.geometry.camera import Camera
from docdepth.io.run_folder import RunFolder
from docdepth.visualization import viewer
from docdepth.visualization.geometries import (
    CameraView,
    back_project,
    class_colors,
    run_geometries,
    scene_geometries,
)

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
    assert dynamic[0] > 2 * dynamic[2]  # red
    assert np.ptp(static) == 0  # grey


def test_geometries_are_in_the_world_frame(open3d) -> None:
    points = np.array([(1, 2, 3), (np.nan, 0, 0), (4, 5, 6)], np.float32)
    classid = np.array([0, 50, 100], np.uint16)
    poses = np.repeat(np.eye(4)[None], 3, axis=0)
    poses[:, 0, 3] = 0, 2, 4
    depth = np.full((30, 40), np.nan, np.float32)
    depth[15, 20] = 10.0  # the principal point
    T_world_camera = np.eye(4)
    T_world_camera[:3, 3] = 1, 1, 1
    views = [CameraView(CAMERA, T_world_camera, depth), CameraView(CAMERA, np.eye(4))]
    found = scene_geometries(points, classid, poses, views)
    assert list(found) == ["points", "trajectory", "camera 0", "depth 0", "camera 1"]
    np.testing.assert_allclose(np.asarray(found["points"].points), points[[0, 2]])
    np.testing.assert_allclose(np.asarray(found["points"].colors), class_colors(classid[[0, 2]]))
    np.testing.assert_allclose(np.asarray(found["trajectory"].points)[:, 0], (0, 2, 4))
    assert np.asarray(found["trajectory"].lines).tolist() == [[0, 1], [1, 2]]
    np.testing.assert_allclose(np.asarray(found["depth 0"].points), [(1, 1, 11)])
    image = np.full((30, 40, 3), (10, 20, 30), np.uint8)
    coloured = scene_geometries(
        points, classid, views=[CameraView(CAMERA, T_world_camera, depth, image)]
    )
    rgb = np.asarray(coloured["depth 0"].colors)
    np.testing.assert_allclose(rgb, [(30 / 255, 20 / 255, 10 / 255)])
    centre = np.asarray(found["camera 0"].points)[0]
    np.testing.assert_allclose(centre, (1, 1, 1), atol=1e-12)
    with pytest.raises(InputError, match="classes"):
        scene_geometries(points, classid[:2])


def test_geometries_of_a_run(open3d, finished: tuple[Path, str]) -> None:
    run = RunFolder.open(finished[0])
    found = run_geometries(run, frame=2)
    assert len(found["points"].points) == len(run.points(2))
    assert len(found["trajectory"].points) == 5
    assert sum(name.startswith("camera") for name in found) == 4
    depths = [g for name, g in found.items() if name.startswith("depth")]
    assert len(depths) == 1
    assert len(depths[0].points) > 10_000
    # The depth map lies on the sweep's points, not somewhere else in the world.
    away = depths[0].voxel_down_sample(1.0).compute_point_cloud_distance(found["points"])
    assert np.median(np.asarray(away)) < 1.0
    more = run_geometries(run, frame=2, around=1, depth=False)
    assert list(more) == ["points", "trajectory"]
    assert len(more["points"].points) > 2 * len(found["points"].points)
    with pytest.raises(InputError, match="sweeps 0 to 4, not 5"):
        run_geometries(run, frame=5)


def test_an_image_needs_no_display(open3d, finished: tuple[Path, str], tmp_path: Path) -> None:
    try:
        viewer.view_run(finished[0], frame=2, image=tmp_path / "view.png")
    except BackendError as error:
        pytest.skip(str(error))
    picture = cv2.imread(str(tmp_path / "view.png"))
    assert picture.std() > 5


def test_without_a_display_the_error_says_so(open3d, monkeypatch) -> None:
    monkeypatch.setattr(viewer, "has_display", lambda: False)
    with pytest.raises(BackendError, match="no display"):
        viewer.show({})


def test_without_open3d_the_error_names_the_package(monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(MissingExtraError, match=r"docdepth\[viz\].*libusb"):
        scene_geometries(np.zeros((1, 3), np.float32), np.zeros(1, np.uint16))
