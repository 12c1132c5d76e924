"""``ego_boxes`` in docdepth.yaml: points of the vehicle itself are left out, rows stay."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from conformance import check, differences
from formats import WRITERS

from docdepth.datasets import open_dataset, usable_points
from docdepth.datasets.files import settings_file
from docdepth.errors import DatasetError

BOXES = [[[4.0, 7.0], [-3.0, 3.0], [-2.0, 2.0]], [[-9.0, -5.0], [0.0, 6.0], [-9.0, 9.0]]]
PCD = "folder of binary pcd"
LAYOUTS = ["kitti_raw", "kitti_odometry", PCD, "Argoverse 2"]


def said(path: Path, **more) -> None:
    """Adds entries to docdepth.yaml of a recording."""
    file = settings_file(path)
    known = yaml.safe_load(file.read_text()) if file.is_file() else {}
    file.write_text(yaml.safe_dump({**known, **more}))


@pytest.mark.parametrize("what", LAYOUTS)
def test_points_in_boxes_are_no_returns(what, tmp_path):
    name, write = WRITERS[what]
    path = write(tmp_path).path
    whole = open_dataset(path)
    before = [whole.sweep(k) for k in range(len(whole))]
    said(path, ego_boxes=BOXES)
    dataset = open_dataset(path)
    check(dataset, name)
    for k, sweep in enumerate(before):
        low, high = np.array(BOXES, np.float32).transpose(2, 0, 1)
        inside = ((sweep.points[:, None] >= low) & (sweep.points[:, None] <= high)).all(2).any(1)
        found = dataset.sweep(k)
        assert differences(found, sweep) == ["points"]
        np.testing.assert_array_equal(found.points[~inside], sweep.points[~inside])
        assert inside[usable_points(sweep.points)].sum() > 20
        assert not usable_points(found.points[inside]).any()
    assert {*dataset.sweep_files(0)} == {*whole.sweep_files(0), settings_file(path)}


def test_one_box(tmp_path):
    path = WRITERS["kitti_odometry"][1](tmp_path).path
    said(path, ego_boxes=BOXES[:1])
    expected = open_dataset(path).sweep(0)
    said(path, ego_boxes=BOXES[0])
    assert differences(open_dataset(path).sweep(0), expected) == []


@pytest.mark.parametrize("what", ["kitti_odometry", PCD])
@pytest.mark.parametrize(
    "wrong",
    [
        3,
        [[1, 2]],
        [[[2, 1], [0, 1], [0, 1]]],
        [[[0, 2000], [0, 1], [0, 1]]],
        [["a"] * 6],
        1001 * BOXES[:1],
    ],
)
def test_what_is_no_box(what, wrong, tmp_path):
    path = WRITERS[what][1](tmp_path).path
    said(path, ego_boxes=wrong)
    with pytest.raises(DatasetError, match=r"docdepth.yaml.*ego_boxes"):
        open_dataset(path)


def test_an_entry_that_kitti_raw_does_not_take(tmp_path):
    path = WRITERS["kitti_raw"][1](tmp_path).path
    said(path, sensor_origin=[0, 0, 1])
    with pytest.raises(DatasetError, match="sensor_origin is unknown; there are ego_boxes"):
        open_dataset(path)
