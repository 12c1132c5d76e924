"""Sweeps over each other and points on images: what is drawn where."""

import numpy as np

from docdepth.diagnostics.recording_pictures import COLORS, clouds_in_plane, points_on_image
from docdepth.geometry.camera import Camera
from docdepth.visualization.image_views import write_text


def test_x_points_up_y_to_the_left_and_colours_add_up() -> None:
    both, first, second = [0.0, 0, 0], [8.0, 0, 0], [0.0, 8, 0]
    clouds = [np.array([both, first]), np.array([both, second])]
    picture = clouds_in_plane(clouds, np.zeros((2, 3)), reach=10, size=200)
    assert picture.shape == (200, 200, 3)
    assert tuple(picture[20, 100]) == COLORS[0], "ahead is up"
    assert tuple(picture[100, 20]) == COLORS[1], "left is left"
    without = clouds_in_plane(clouds, None, reach=10, size=200)
    total = np.minimum(np.add(*COLORS[:2]), 255)
    assert (without == total).all(axis=2).sum() == 1


def test_far_points_do_not_shrink_the_picture_and_none_is_none() -> None:
    cloud = np.random.default_rng(0).uniform(-10, 10, (1000, 3))
    cloud[0] = 1e6
    picture = clouds_in_plane([cloud], size=300)
    assert (picture.max(axis=2) > 60).mean() > 0.01
    assert clouds_in_plane([np.zeros((0, 3))]).ndim == 3


def test_the_nearest_point_of_a_pixel_is_drawn_and_none_behind_the_camera() -> None:
    camera = Camera(np.array([[100.0, 0, 50], [0, 100, 40], [0, 0, 1]]), 100, 80)
    near, far = (np.array([[0.0, 0, z]]) for z in (5, 60))
    behind = np.array([[0.0, 0, -5]])
    image = np.full((80, 100, 3), 90, np.uint8)
    alone = points_on_image(near, camera, np.eye(4), image)
    both = points_on_image(np.concatenate([far, near, behind]), camera, np.eye(4), image)
    np.testing.assert_array_equal(alone, both)
    assert not np.array_equal(alone[40, 50], alone[5, 5])
    nothing = points_on_image(behind, camera, np.eye(4), image)
    assert np.array_equal(nothing[40, 50], nothing[5, 5])


def test_the_rim_of_text_goes_with_it() -> None:
    """OpenCV 5 draws thick letters wider, so a thick copy below the text runs out of it."""
    picture = np.full((40, 500, 3), 128, np.uint8)
    write_text(picture, "depth map in the colours of its image", (8, 25), (255, 255, 255))
    bright, dark = (
        np.flatnonzero(found.any(axis=(0, 2))) for found in (picture > 200, picture < 40)
    )
    assert 0 <= dark.max() - bright.max() < 6
    assert 0 <= bright.min() - dark.min() < 6
