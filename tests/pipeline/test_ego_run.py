"""A run that leaves out points of the vehicle itself."""

from __future__ import annotations

import numpy as np

from command_line import cli
from docdepth.datasets import open_dataset, usable_points
from docdepth.io.poses import write_kitti
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline.plan import states
from small_drive import SWEEPS, write_small_drive
from walled_yard import straight


def test_rows_in_boxes_are_labelled_as_no_returns(tmp_path):
    drive = write_small_drive(tmp_path / "drive")
    usable = [usable_points(open_dataset(drive).sweep(k).points) for k in range(SWEEPS)]
    write_kitti(tmp_path / "poses.txt", straight(SWEEPS, 0.5).poses)
    run = ("run", drive, "-o", tmp_path / "run", "--poses", tmp_path / "poses.txt")
    (drive / "docdepth.yaml").write_text("ego_boxes: [[0, 9], [-9, 9], [-3, 1]]\n")
    assert cli(*run).exit_code == 0
    for k, before in enumerate(usable):
        after = usable_points(open_dataset(drive).sweep(k).points)
        assert 0.02 < 1 - after.sum() / before.sum() < 0.9
        labels = np.fromfile(tmp_path / "run" / "labels" / f"{k:06d}.label", "<u4")
        np.testing.assert_array_equal(labels == 1, ~after)
        assert len(RunFolder.open(tmp_path / "run").frame(k).index) == after.sum()
    (drive / "docdepth.yaml").write_text("ego_boxes: [[0, 8], [-9, 9], [-3, 1]]\n")
    found = {s.name: s.state for s in states(RunFolder.open(tmp_path / "run"))}
    assert found["odometry"] == "out of date"
