"""Drives of KITTI's depth completion as truth: they lack maps at both ends."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from docdepth.errors import DatasetError
from docdepth.evaluation.runs import evaluate_depth


@pytest.fixture
def annotated(drive: Path, tmp_path: Path) -> Path:
    """True depth of images 1 and 2 of the synthetic street, as KITTI writes it."""
    folder = tmp_path / "2011_09_26_drive_0001_sync" / "proj_depth" / "groundtruth" / "image_2"
    folder.mkdir(parents=True)
    for name in ("000001", "000002"):
        depth = np.nan_to_num(np.load(drive / "depth_2" / f"{name}.npy"), posinf=0)
        cv2.imwrite(str(folder / f"{name}.png"), np.round(depth * 256).astype(np.uint16))
    return folder.parents[2]


def test_images_without_a_true_map_are_not_compared(finished, drive, annotated, tmp_path, caplog):
    result = evaluate_depth(finished[0], annotated)
    assert result.images == 2
    assert "has no depth map of 2 of 4 images; they are not compared" in caplog.text
    plain = tmp_path / "plain"
    shutil.copytree(annotated / "proj_depth" / "groundtruth" / "image_2", plain)
    assert evaluate_depth(finished[0], plain).all == result.all
    assert "plain has no depth map of 2 of 4 images" in caplog.text
    for name in ("000000", "000003"):  # no pixel of these has a true depth
        cv2.imwrite(
            str(plain / f"{name}.png"), np.zeros_like(cv2.imread(str(plain / "000001.png"), -1))
        )
    same = evaluate_depth(finished[0], plain)
    assert same.all == result.all


def test_the_drive_is_found_in_the_whole_of_the_data(finished, drive, annotated, tmp_path):
    expected = evaluate_depth(finished[0], annotated).all
    for part in ("train", "val"):
        whole = tmp_path / f"annotated_{part}"
        shutil.copytree(annotated, whole / part / drive.name)
        assert evaluate_depth(finished[0], whole).all == expected
    assert evaluate_depth(finished[0], whole / part).all == expected


def test_an_annotated_drive_of_other_images(finished, annotated):
    folder = annotated / "proj_depth" / "groundtruth" / "image_2"
    for file in folder.iterdir():
        file.rename(file.with_name(f"7{file.name}"))
    with pytest.raises(DatasetError, match="of the 4 images of the run; is it of this drive"):
        evaluate_depth(finished[0], annotated)
    shutil.rmtree(folder)
    with pytest.raises(DatasetError, match=r"image_2 has no depth map"):
        evaluate_depth(finished[0], annotated)


@pytest.mark.parametrize("with_intrinsics", [True, False])
def test_the_cropped_selection(finished, drive, tmp_path, with_intrinsics):
    """Cropped maps of several drives and cameras in one folder, as KITTI has them."""
    selection, name = tmp_path / "val_selection_cropped", drive.name
    (selection / "groundtruth_depth").mkdir(parents=True)
    (selection / "intrinsics").mkdir()
    whole = tmp_path / "whole"
    whole.mkdir()
    for k in range(4):
        depth = np.nan_to_num(np.load(drive / "depth_2" / f"{k:06d}.npy"), posinf=0)
        steps = np.round(depth * 256).astype(np.uint16)
        outside = steps.copy()
        outside[8:, 8:-8] = 0  # KITTI crops the lower middle
        cv2.imwrite(str(whole / f"{k:06d}.png"), steps - outside if k in (1, 2) else 0 * steps)
        if k in (1, 2):
            file = f"{name}_groundtruth_depth_{k:06d}_image_2.png"
            cv2.imwrite(str(selection / "groundtruth_depth" / file), steps[8:, 8:-8])
            other = f"2011_09_26_drive_0002_sync_groundtruth_depth_{k:010d}_image_02.png"
            cv2.imwrite(str(selection / "groundtruth_depth" / other), steps[:32, :80])
            if with_intrinsics:
                text = "60 0 40 0 60 12 0 0 1"
                (selection / "intrinsics" / f"{name}_image_{k:06d}_image_2.txt").write_text(text)
    found, same = evaluate_depth(finished[0], selection), evaluate_depth(finished[0], whole)
    assert found.images == 2
    assert found.all.pixels == same.all.pixels
    assert found.all.mae == pytest.approx(same.all.mae)
    assert found.point_to_point == pytest.approx(same.point_to_point, rel=0.02)  # other samples


def test_truth_that_holds_nothing(finished, annotated):
    for file in annotated.rglob("*.png"):
        cv2.imwrite(str(file), np.zeros_like(cv2.imread(str(file), -1)))
    with pytest.raises(DatasetError, match=r"have no pixel in common; is the truth of this camera"):
        evaluate_depth(finished[0], annotated)
