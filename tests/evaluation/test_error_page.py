"""Pages of errors: the worst images first, in one file, with colours that say what is wrong."""

from __future__ import annotations

import base64
import re

import cv2
import numpy as np
import pytest

from docdepth.errors import DatasetError
from docdepth.evaluation import DepthEvaluation, LabelEvaluation
from docdepth.evaluation.error_page import WORST, DepthPage, HeldOutPage, LabelPage
from docdepth.evaluation.held_out import HeldOutView
from docdepth.visualization.pictures import (
    FALSE_COLOR,
    FOUND_COLOR,
    MISSED_COLOR,
    TOO_FAR_COLOR,
    TOO_NEAR_COLOR,
)


def pictures_of(page: str) -> dict[tuple[int, str], np.ndarray]:
    """All pictures of a page by their number and view."""
    found = {}
    for source, image, view in re.findall(
        r'src="data:image/jpeg;base64,([^"]+)" data-image=(\d+) data-view=(\w+)', page
    ):
        data = np.frombuffer(base64.b64decode(source), np.uint8)
        found[int(image), view] = cv2.imdecode(data, cv2.IMREAD_COLOR)
    return found


def captions_of(page: str) -> list[str]:
    return re.findall(r"<span class=name [^>]*>([^<]+)</span>", page)


def image(wrong: int) -> tuple[str, np.ndarray, np.ndarray]:
    """A wall at 10 m of which some rows are drawn at 8 m, one at 13 m, one not at all."""
    truth = np.full((40, 60), 10, np.float32)
    depth = truth.copy()
    depth[:wrong] = 8
    depth[38], depth[39] = 13, np.nan
    return f"{wrong:03d}", depth, truth


def test_the_worst_depth_maps_come_first_with_their_errors_in_colour(tmp_path) -> None:
    evaluation, page = DepthEvaluation(), DepthPage("depth <here>", 80.0, None)
    for wrong in [*range(20)]:
        evaluation.add(*image(wrong)[1:])
        page.look(*image(wrong))
    result = evaluation.result()
    page.write(tmp_path / "page.html", [result.table(), result.kitti_table()])
    text = (tmp_path / "page.html").read_text()
    captions = captions_of(text)
    assert len(captions) == WORST
    assert [re.findall(r"image (\d+)", c)[0] for c in captions] == [
        f"{k:03d}" for k in range(19, 7, -1)
    ]
    # 19 rows at 8 m and one at 13 m of 39 compared rows; (19 * 2 + 3) / 39 m.
    assert captions[0].endswith(
        "51.3 % of 2,340 compared pixels are more than 5 % off, the mean error is 1.05 m"
    )
    rows = pictures_of(text)[0, "error"].reshape(40, 60, 3).mean(axis=1)
    assert np.abs(rows[2:17] - TOO_NEAR_COLOR).max() < 30
    assert np.abs(rows[38] - TOO_FAR_COLOR).max() < 60
    assert (rows[22:36] > 230).all(), "right is white"
    assert "depth &lt;here&gt;" in text
    assert "edge displacement px" in text
    assert "irmse" in text
    assert "http" not in text.replace("http://www.w3.org", ""), "the page needs nothing else"
    for name in ("019", "000"):
        assert f'title="{name}: ' in text, "a bar for each image"


def test_returns_are_drawn_where_they_are_with_the_error_of_their_own_pixel(tmp_path) -> None:
    depth = np.full((40, 60), 20, np.float32)
    truth = np.full((40, 60), np.nan, np.float32)
    truth[10, 15], truth[10, 40], truth[30, 20], truth[30, 50] = 20, 26, 16, 90
    flat = np.zeros((40, 60), np.uint16)
    page = HeldOutPage("left out", 80.0, "held-out sweeps", None, np.zeros(3, np.int64))
    page.look(HeldOutView(2, "7", depth, truth, flat, flat > 0))
    page.write(tmp_path / "page.html", [], ["the poses jitter"])
    text = (tmp_path / "page.html").read_text()
    (caption,) = captions_of(text)
    assert caption.startswith("sweep 7: 66.7 % of 3 compared pixels")
    assert "the poses jitter" in text
    errors = pictures_of(text)[0, "error"].astype(int)
    assert (errors[9:12, 14:17] > 180).all(), "a right return is a white square"
    assert errors[10, 40, 2] - errors[10, 40, 0] > 100, "6 m too near is orange"
    assert errors[30, 20, 0] - errors[30, 20, 2] > 100, "4 m too far is blue"
    assert errors[30, 50].max() < 120, "beyond the range nothing is evaluated"


def sweep(name: str, labelled: list[int], moving: list[int], unlabelled: tuple[int, ...] = ()):
    points = np.array([(10, 10, 0), (20, -20, 0), (-30, 5, 0), (40, 40, 0)], np.float32)
    classid, labels = np.full(4, 50, np.uint16), np.full(4, 40, np.uint32)
    classid[labelled], labels[moving], labels[list(unlabelled)] = 100, 252, 0
    return name, points, classid, labels


def test_labels_from_above_show_what_was_missed_and_false_alarms(tmp_path) -> None:
    page = LabelPage("labels")
    page.look(*sweep("good", [0], [0]))
    page.look(*sweep("bad", [0, 2], [0, 1]))
    page.look(*sweep("unlabelled", [3], [], (3,)))
    page.write(tmp_path / "page.html", [LabelEvaluation().result().table()])
    text = (tmp_path / "page.html").read_text()
    captions = captions_of(text)
    assert captions[0] == "sweep bad: 1 of 2 moving points missed, 1 false alarms"
    assert "sweep unlabelled: 0 of 0 moving points missed, 0 false alarms" in captions
    above = pictures_of(text)[0, "above"].astype(int)
    # 10 pixels a metre, the vehicle at (500, 500); x is up, y is left.
    for (x, y), color in (((20, -20), MISSED_COLOR), ((-30, 5), FALSE_COLOR)):
        assert np.abs(above[500 - 10 * x, 500 - 10 * y] - color).max() < 60
    assert np.abs(above[395:405, 395:405] - FOUND_COLOR).max(axis=2).min() < 90


def test_a_file_that_is_no_page_is_kept(tmp_path) -> None:
    mine = tmp_path / "thesis.html"
    mine.write_text("<html>mine</html>")
    with pytest.raises(DatasetError, match="no page of docdepth"):
        LabelPage("labels").write(mine, [])
    with pytest.raises(DatasetError, match="is a folder"):
        LabelPage("labels").write(tmp_path, [])
    LabelPage("labels").write(tmp_path / "new.html", [])
    LabelPage("labels").write(tmp_path / "new.html", [])
    assert mine.read_text() == "<html>mine</html>"
