"""Pixels that show no world, such as those of the own bonnet, get no depth."""

import cv2
import numpy as np
import pytest

import docdepth
from docdepth.errors import ConfigError, DocDepthError
from docdepth.io.depth import read_depth
from small_drive import HEIGHT, SWEEPS, WIDTH, write_small_drive


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory):
    """A drive, its depth maps without a mask, and a mask that hides the lower third."""
    folder = tmp_path_factory.mktemp("masks")
    drive = write_small_drive(folder / "drive")
    docdepth.run(drive, folder / "run", camera="all")
    seen = np.full((HEIGHT, WIDTH), 255, np.uint8)
    seen[2 * HEIGHT // 3 :, 10:70] = 0
    cv2.imwrite(str(folder / "bonnet.png"), seen)
    return drive, folder / "run", folder / "bonnet.png", seen > 0


def depths(run, camera: str) -> list[np.ndarray]:
    return [read_depth(path) for path in sorted((run / "depth" / camera).glob("*.png"))]


def test_masked_pixels_get_no_depth_and_others_the_same(small, tmp_path):
    drive, plain, mask, seen = small
    run = docdepth.run(drive, tmp_path / "run", camera="all", mask=f"image_2:{mask}").path
    before, after = depths(plain, "image_2"), depths(run, "image_2")
    assert len(after) == SWEEPS
    hidden = 0
    for a, b in zip(before, after, strict=True):
        hidden += np.isfinite(a[~seen]).sum()
        assert np.isnan(b[~seen]).all()
        np.testing.assert_array_equal(b[seen], a[seen])
    assert hidden > 0  # the mask hides something
    for a, b in zip(depths(plain, "image_3"), depths(run, "image_3"), strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_mask_of_numbers_and_a_camera_that_stays_as_it_is():
    K = np.array([[5.0, 0, 3], [0, 5, 2], [0, 0, 1]])
    camera = docdepth.Camera(K, 6, 4, np.full((4, 6), 255, np.uint8))
    assert camera.mask is not None
    assert (~camera.mask).sum() == 0
    with pytest.raises(ValueError, match="read-only"):
        camera.K[:2] *= 0.5
    with pytest.raises(DocDepthError, match="mask has 6 x 3 pixels"):
        docdepth.Camera(K, 6, 4, [[True] * 6] * 3)


def test_a_polygon_of_the_recording_and_a_mask_in_its_place(small, tmp_path):
    _, _, mask, seen = small
    other = write_small_drive(tmp_path / "drive")
    polygon = [[0, 20], [WIDTH - 1, 20], [WIDTH - 1, 30], [0, 30]]
    (other / "docdepth.yaml").write_text(f"masks: {{image_2: {polygon}}}\n")
    run = docdepth.run(other, tmp_path / "run").path
    for depth in depths(run, ""):
        assert np.isnan(depth[20:31]).all()
        assert np.isfinite(depth[31:]).any()
    again = docdepth.run(other, tmp_path / "again", mask=f"image_2:{mask}").path
    for depth in depths(again, ""):
        assert np.isnan(depth[~seen]).all()
        assert np.isfinite(depth[20:31]).any()


def test_another_mask_draws_the_maps_again(small, tmp_path):
    drive, _, mask, seen = small
    own = tmp_path / "mask.png"
    own.write_bytes(mask.read_bytes())
    docdepth.run(drive, tmp_path / "run", mask=f"image_2:{own}")
    cv2.imwrite(str(own), np.where(seen[::-1], 255, 0).astype(np.uint8))
    run = docdepth.run(drive, tmp_path / "run", mask=f"image_2:{own}").path
    for depth in depths(run, ""):
        assert np.isnan(depth[~seen[::-1]]).all()


@pytest.mark.parametrize(
    "corners",
    [
        [[float("nan"), 0], [5, 5], [9, 0]],
        [[1e30, 0], [5, 5], [9, 0]],
        [[-9, -9], [999, -9], [999, 999], [-9, 999]],
        [[-9, -9], [-3, -9], [-3, -3]],
        [[1, 1], [5, 5]],
    ],
)
def test_polygons_that_cover_nothing_or_all(small, tmp_path, corners):
    other = write_small_drive(tmp_path / "drive", images=False)
    text = str(corners).replace("nan", ".nan")
    (other / "docdepth.yaml").write_text(f"masks: {{image_2: {text}}}\n")
    with pytest.raises(DocDepthError, match="polygon"):
        docdepth.run(other, tmp_path / "run", image_size=f"{WIDTH}x{HEIGHT}")


def test_wrong_masks(small, tmp_path):
    drive, _, mask, _ = small
    with pytest.raises(ConfigError, match="CAMERA:FILE"):
        docdepth.run(drive, tmp_path / "run", mask=str(mask))
    with pytest.raises(DocDepthError, match="image_7"):
        docdepth.run(drive, tmp_path / "run", mask=f"image_7:{mask}")
    cv2.imwrite(str(tmp_path / "small.png"), np.full((HEIGHT, WIDTH - 1), 255, np.uint8))
    with pytest.raises(DocDepthError, match=f"{WIDTH}x{HEIGHT}"):
        docdepth.run(drive, tmp_path / "run", mask=f"image_2:{tmp_path / 'small.png'}")
    with pytest.raises(DocDepthError, match=r"missing\.png"):
        docdepth.run(drive, tmp_path / "run", mask=f"image_2:{tmp_path / 'missing.png'}")
