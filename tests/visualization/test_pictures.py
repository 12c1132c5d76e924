"""Pictures: what a colour means and where a point is drawn."""

import cv2
import numpy as np
import pytest

from docdepth.errors import InputError
from docdepth.visualization import pictures as visualize


def test_near_is_yellow_far_is_violet_and_none_is_dark() -> None:
    picture = visualize.colorize(np.array([[3.0, 80.0, np.nan, 1.0, 500.0]]), bar=False)
    assert picture.dtype == np.uint8
    blue, green, red = picture[0].T.astype(int)
    assert min(red[0], green[0]) > 2 * blue[0]
    assert blue[1] > 1.3 * max(red[1], green[1])
    assert (picture[0, 2] == picture[0, 2, 0]).all()
    assert picture[0, 2, 0] < 40
    np.testing.assert_array_equal(picture[0, 0], picture[0, 3])
    np.testing.assert_array_equal(picture[0, 1], picture[0, 4])


def test_colors_do_not_depend_on_the_picture() -> None:
    alone = visualize.colorize(np.full((1, 1), 20.0), bar=False)
    among = visualize.colorize(np.array([[5.0, 20.0, 70.0]]), bar=False)
    np.testing.assert_array_equal(alone[0, 0], among[0, 1])


def test_the_bar_is_drawn_on_a_copy() -> None:
    plain = visualize.colorize(np.full((200, 600), 20.0), bar=False)
    before = plain.copy()
    barred = visualize.draw_bar(plain)
    np.testing.assert_array_equal(plain, before)
    assert (barred[170:] != plain[170:]).any()
    np.testing.assert_array_equal(barred[:150], plain[:150])
    assert visualize.draw_bar(np.zeros((5, 5, 3), np.uint8)).shape == (5, 5, 3)


def test_overlay_shows_the_image_where_there_is_no_depth() -> None:
    depth = np.full((20, 30), 10, np.float32)
    depth[:, 15:] = np.nan
    image = np.full((20, 30, 3), 200, np.uint8)
    picture = visualize.overlay(depth, image)
    assert (picture[:, 15:] == 100).all()
    assert len(np.unique(picture[0, 0])) > 1
    assert visualize.overlay(depth).shape == image.shape
    with pytest.raises(InputError, match="differ in size"):
        visualize.overlay(depth, image[:-1])


def test_error_picture_tells_near_from_far() -> None:
    truth = np.full((1, 4), 10.0)
    picture = visualize.error_picture(np.array([[10.0, 8.0, 12.0, np.nan]]), truth)
    assert picture[0, 0].tolist() == [255, 255, 255]
    assert tuple(picture[0, 1]) == visualize.TOO_NEAR_COLOR
    assert tuple(picture[0, 2]) == visualize.TOO_FAR_COLOR
    assert picture[0, 3].max() < 40


def test_labels_from_above_are_where_the_points_are() -> None:
    # One metre a pixel, sensor in the middle: 10 m ahead is up, 5 m to the left is left.
    points = np.array([[10, 5, 0], [-10.5, 0, 0], [0, 60, 0]], np.float32)
    classid = np.array([100, 0, 50], np.uint16)
    picture = visualize.labels_from_above(points, classid, reach=50, size=100)
    assert tuple(picture[40, 45]) == visualize.DYNAMIC_COLOR
    assert tuple(picture[60, 50]) == visualize.GROUND_COLOR
    assert (picture != picture[0, 0]).any(axis=2).sum() == 2


def test_truth_colors_found_missed_and_false() -> None:
    points = np.array([[10, 0, 0], [20, 0, 0], [30, 0, 0]], np.float32)
    classid = np.array([100, 50, 100], np.uint16)
    truth = np.array([True, True, False])
    picture = visualize.labels_from_above(points, classid, truth, reach=50, size=100)
    colors = [tuple(picture[row, 50]) for row in (40, 30, 20)]
    expected = [visualize.FOUND_COLOR, visualize.MISSED_COLOR, visualize.FALSE_COLOR]
    assert colors == expected


def test_range_image_has_forward_in_the_middle() -> None:
    points = np.array([[10, 0, 0], [0, 10, 1], [np.nan, 0, 0], [0, 0, 0]], np.float32)
    classid = np.array([100, 50, 50, 50], np.uint16)
    picture = visualize.labels_in_range_image(points, classid, classid >= 100)
    rows, columns = np.nonzero((picture == visualize.FOUND_COLOR).all(axis=2))
    assert set(columns) == {900}
    left = np.nonzero((picture == visualize.STATIC_COLOR).all(axis=2))
    assert set(left[1]) == {450}
    assert left[0].max() < rows.min()


# What red-blind, green-blind and blue-blind readers see of linear RGB: Machado, Oliveira and
# Fernandes (2009), severity 1.
BLINDNESS = {
    "none": np.eye(3),
    "protanopia": ((0.152286, 1.052583, -0.204868), (0.114503, 0.786281, 0.099216),
                   (-0.003882, -0.048116, 1.051998)),
    "deuteranopia": ((0.367322, 0.860646, -0.227968), (0.280085, 0.672501, 0.047413),
                     (-0.011820, 0.042940, 0.968881)),
    "tritanopia": ((1.255528, -0.076749, -0.178779), (-0.078411, 0.930809, 0.147602),
                   (0.004733, 0.691367, 0.303900)),
}  # fmt: skip


def seen(colors: np.ndarray, blindness: str) -> np.ndarray:
    """CIELAB (n, 3) of BGR colours (n, 3) as a reader sees them."""
    rgb = np.asarray(colors)[:, ::-1] / 255
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    linear = (linear @ np.array(BLINDNESS[blindness]).T).clip(0, 1)
    shown = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return cv2.cvtColor(shown[None].astype(np.float32), cv2.COLOR_RGB2LAB)[0]


@pytest.mark.parametrize("blindness", BLINDNESS)
def test_every_reader_tells_the_classes_and_no_depth_apart(blindness: str) -> None:
    far = visualize.colorize(np.full((1, 1), 80.0), bar=False)[0, 0]
    background = (visualize.BACKGROUND,) * 3
    classes = [visualize.GROUND_COLOR, visualize.STATIC_COLOR, visualize.DYNAMIC_COLOR, background]
    lab = seen(np.array(classes), blindness)
    apart = np.linalg.norm(lab[:, None] - lab, axis=2)[np.triu_indices(4, 1)]
    assert apart.min() > 25  # 2.3 is what a reader just sees
    edge = seen(np.array([far, background]), blindness)
    assert np.linalg.norm(edge[0] - edge[1]) > 15


@pytest.mark.parametrize("blindness", BLINDNESS)
def test_colours_of_depth_get_darker_in_even_steps_for_every_reader(blindness: str) -> None:
    depths = np.geomspace(3, 80, 21)[None]
    lab = seen(visualize.colorize(depths, bar=False)[0], blindness)
    steps = -np.diff(lab[:, 0])
    assert steps.min() > 1
    assert steps.max() < 2.5 * np.median(steps)


BACKGROUND = (visualize.BACKGROUND,) * 3
ERRORS = (visualize.TOO_NEAR_COLOR, visualize.TOO_FAR_COLOR, (255, 255, 255), BACKGROUND)
MISTAKES = (visualize.FOUND_COLOR, visualize.MISSED_COLOR, visualize.FALSE_COLOR)
LABELS = (*MISTAKES, visualize.STATIC_COLOR, visualize.GROUND_COLOR, BACKGROUND)


@pytest.mark.parametrize("blindness", BLINDNESS)
@pytest.mark.parametrize("colors", [ERRORS, LABELS], ids=["errors", "labels"])
def test_every_reader_tells_mistakes_apart(colors: tuple, blindness: str) -> None:
    lab = seen(np.array(colors), blindness)
    apart = np.linalg.norm(lab[:, None] - lab, axis=2)[np.triu_indices(len(colors), 1)]
    assert apart.min() > 30


def test_mistakes_are_seen_on_the_dark_ground_and_no_side_of_the_errors_stands_out() -> None:
    near, far = seen(np.array(ERRORS[:2]), "none")[:, 0]
    assert abs(near - far) < 3
    shown = np.array([*ERRORS[:2], *MISTAKES, BACKGROUND])[:, ::-1] / 255
    linear = np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)
    light = linear @ (0.2126, 0.7152, 0.0722) + 0.05
    assert (light[:-1] / light[-1]).min() > 4.5  # what WCAG asks of text
