"""Layouts of posed images: opened by the program or by its documented convention, and compared."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

import docdepth
from command_line import cli
from docdepth.export import export
from docdepth.io.ply import read_vertices
from docdepth.pipeline.run_reader import RunImage, RunImages


@pytest.fixture(scope="module")
def images(finished: tuple[Path, str]) -> RunImages:
    return docdepth.open_run(finished[0]).cameras["image_2"]


@pytest.fixture(scope="module")
def scene(images: RunImages, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scene")
    assert export(images.run, folder, "nerfstudio") == 4
    return folder


@pytest.fixture(scope="module")
def model(images: RunImages, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("model")
    assert export(images.run, folder, "colmap") == 4
    return folder


def hundred(image: RunImage) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Rows and columns of a hundred pixels with depth, and their points in the world."""
    depth = image.depth
    known = np.argwhere(np.isfinite(depth))
    v, u = some = known[:: len(known) // 100][:100].T
    rays = np.linalg.inv(image.K) @ [u, v, np.ones(100)]
    T = image.T_world_camera
    return some, (T[:3, :3] @ (rays * depth[v, u]) + T[:3, 3:]).T


def test_nerfstudio_finds_the_same_points(images: RunImages, scene: Path) -> None:
    """By its rays: through (column + 0.5, row + 0.5), y up, z backward, depth x 0.001."""
    frames = json.loads((scene / "transforms.json").read_text())["frames"]
    for frame, image in zip(frames, images, strict=True):
        (rows, columns), points = hundred(image)
        depth = np.load(scene / frame["depth_file_path"]) * 1e-3
        assert np.array_equal(depth > 0, np.isfinite(image.depth))
        x = (columns + 0.5 - frame["cx"]) / frame["fl_x"]
        y = -(rows + 0.5 - frame["cy"]) / frame["fl_y"]
        rays = np.stack([x, y, -np.ones(100)]) * depth[rows, columns]
        T = np.array(frame["transform_matrix"])
        assert np.allclose((T[:3, :3] @ rays + T[:3, 3:]).T, points, atol=1e-4)
        assert (frame["h"], frame["w"]) == depth.shape


@pytest.mark.filterwarnings("ignore")  # of its many libraries
def test_nerfstudios_own_parser_finds_the_same_points(images: RunImages, scene: Path) -> None:
    dataparsers = pytest.importorskip("nerfstudio.data.dataparsers.nerfstudio_dataparser")
    read_depth = pytest.importorskip("nerfstudio.data.utils.data_utils").get_depth_image_from_path
    config = dataparsers.NerfstudioDataParserConfig(
        data=scene, orientation_method="none", center_method="none", auto_scale_poses=False,
        eval_mode="all", load_3D_points=True,
    )  # fmt: skip
    found = config.setup().get_dataparser_outputs("train")
    assert np.allclose(found.metadata["points3D_xyz"], images.run.static_map().points, atol=1e-4)
    by_name = {path.stem: k for k, path in enumerate(found.image_filenames)}
    assert len(by_name) == len(images)
    for image in images:
        k = by_name[image.name]
        assert np.array_equal(cv2.imread(str(found.mask_filenames[k]), 0) == 0, image.moving)
        size, scale = image.depth.shape, found.metadata["depth_unit_scale_factor"]
        depth = read_depth(found.metadata["depth_filenames"][k], *size, scale).numpy()[..., 0]
        assert np.allclose(depth, np.nan_to_num(image.depth), atol=1e-4)
        rays = found.cameras.generate_rays(camera_indices=k)
        (rows, columns), points = hundred(image)
        along = depth[..., None] * rays.metadata["directions_norm"].numpy()
        places = rays.origins.numpy() + along * rays.directions.numpy()
        assert np.allclose(places[rows, columns], points, atol=1e-3)


def test_up_of_nerfstudio_is_up_in_the_world(scene: Path) -> None:
    for frame in json.loads((scene / "transforms.json").read_text())["frames"]:
        T = np.array(frame["transform_matrix"])
        assert T[2, 1] > 0.99  # y of the camera along z of the world
        assert T[0, 2] < -0.99  # its z against the way that the vehicle drives
        assert np.linalg.det(T[:3, :3]) == pytest.approx(1)


def test_photos_and_masks_are_those_of_the_run(
    images: RunImages, scene: Path, model: Path, drive: Path
) -> None:
    for image in images:
        name = f"image_2/{image.name}.png"
        photo = cv2.imread(str(drive / "image_2" / f"{image.name}.png"))
        assert photo is not None
        for folder in (scene, model):
            assert np.array_equal(cv2.imread(str(folder / "images" / name)), photo)
        for file in (scene / "masks" / name, model / "masks" / f"{name}.png"):
            mask = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
            assert np.array_equal(mask == 0, image.moving)
    assert any(image.moving.any() for image in images)


def test_points_have_the_colours_of_the_photos(images: RunImages, scene: Path) -> None:
    """Of points that one photo alone shows the colour is exactly that of the pixel."""
    rows, _ = read_vertices(scene / "points.ply")
    points = np.stack([rows[n] for n in "xyz"], axis=1)
    assert np.array_equal(points, images.run.static_map().points)
    colors = np.stack([rows[n] for n in ("red", "green", "blue")], axis=1)
    shown = np.zeros((len(images), len(points)), bool)
    found = np.full((len(images), len(points), 3), np.nan)
    for k, image in enumerate(images):
        photo = image.image
        assert photo is not None
        depth, moving = image.depth, image.moving
        for n, point in enumerate(points):
            x, y, z = image.K @ (np.linalg.inv(image.T_world_camera) @ [*point, 1])[:3]
            if z <= 0.1:
                continue
            u, v = round(x / z), round(y / z)
            if 0 <= u < depth.shape[1] and 0 <= v < depth.shape[0]:
                shown[k, n] = abs(depth[v, u] - z) < 0.02 * z and not moving[v, u]
                if shown[k, n]:
                    found[k, n] = photo[v, u]
    count = shown.sum(0)
    assert (count == 1).sum() > 20
    assert (count > 1).sum() > 20
    assert (colors[count == 0] == 128).all()
    middle = np.nanmedian(found[:, count > 0], axis=0)
    assert np.abs(colors[count > 0] - middle).max() <= 0.5


def test_the_map_has_these_colours_and_laspy_opens_it(
    images: RunImages, scene: Path, tmp_path: Path
) -> None:
    laspy = pytest.importorskip("laspy")
    static = images.run.static_map()
    assert export(images.run, tmp_path / "map", "map") == len(static.points)
    rows, _ = read_vertices(tmp_path / "map" / "map.ply")
    same, _ = read_vertices(scene / "points.ply")
    names = ("x", "y", "z", "red", "green", "blue")
    assert all(np.array_equal(rows[name], same[name]) for name in names)
    assert np.array_equal(rows["classid"], static.classid)
    las = laspy.read(tmp_path / "map" / "map.laz")
    assert np.abs(las.xyz - static.points).max() < 0.001
    for name in ("red", "green", "blue"):
        assert np.array_equal(np.asarray(las[name]) >> 8, rows[name])
    assert np.array_equal(np.asarray(las.classification) == 2, static.classid == 0)


def test_without_laspy_the_map_says_what_is_left_out(
    images: RunImages,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setattr("docdepth.export.colored_map.find_spec", lambda name: None)
    export(images.run, tmp_path / "map", "map")
    assert [file.name for file in (tmp_path / "map").iterdir()] == ["map.ply"]
    assert "docdepth[clouds]" in caplog.text


def test_colmap_sees_the_points_where_they_are(images: RunImages, model: Path) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    found = pycolmap.Reconstruction(model / "sparse" / "0")
    assert (found.num_cameras(), found.num_images()) == (1, len(images))
    assert found.num_points3D() == len(images.run.static_map().points)
    by_name = {image.name: image for image in found.images.values()}
    for image in images:
        (rows, columns), points = hundred(image)
        other = by_name[f"image_2/{image.name}.png"]
        camera = found.cameras[other.camera_id]
        assert (camera.width, camera.height) == (images.camera.width, images.camera.height)
        for row, column, point in zip(rows, columns, points, strict=True):
            seen = other.project_point(point)
            assert seen == pytest.approx([column + 0.5, row + 0.5], abs=1e-3)
        pose = other.cam_from_world
        pose = pose() if callable(pose) else pose
        assert np.allclose(pose.inverse().matrix(), image.T_world_camera[:3], atol=1e-9)
    point = found.points3D[1]
    assert np.allclose(point.xyz, images.run.static_map().points[0])


def test_the_verb_writes_and_refuses(finished: tuple[Path, str], tmp_path: Path) -> None:
    result = cli("convert", finished[0], tmp_path / "scene", "--to", "colmap")
    assert result.exit_code == 0, result.output
    assert f"4 images in {tmp_path / 'scene'}" in " ".join(result.output.split())
    again = cli("convert", finished[0], tmp_path / "scene", "--to", "nerfstudio")
    assert isinstance(again.exception, docdepth.DocDepthError)
    assert "is there; name another" in str(again.exception)
    one = cli("convert", finished[0], tmp_path / "a", "--to", "colmap", "--camera", "image_2")
    assert "leave the option out" in str(one.exception)
