"""The table of classes and tracks, from benchmarks/."""

from __future__ import annotations

import numpy as np
import pytest

from docdepth.io.tracks import TRACKS, read_tracks
from docdepth.pipeline import run_classify

pytest.importorskip("embreex")
pytest.importorskip("motrics")


@pytest.mark.slow
def test_a_tiny_cell_has_figures_of_labels_and_tracks(tmp_path, capsys):
    import tracks

    arguments = [str(tmp_path / "drives"), "-o", str(tmp_path / "out"), "--scenes", "overtaking"]
    cells = tracks.main([*arguments, "--sensors", "VLP-16", "--frames", "6", "--threads", "1"])
    found = cells["overtaking_VLP-16"]
    assert found["labels"]["da"] > 0
    assert found["tracks"]["kinds"]["all"]["objects"] > 3
    printed = capsys.readouterr().out
    assert "HOTA" in printed
    assert printed.count("overtaking_VLP-16") == 1
    assert (tmp_path / "out" / "seed0" / "overtaking_VLP-16.json").is_file()


@pytest.mark.nightly
def test_a_car_ahead_of_a_rosette_is_one_track_that_heads_where_it_goes(tmp_path):
    """Its rear alone says little of its heading: registered alone it turned, and was lost."""
    from cells import Cell, ExactDrive

    cell = Cell("city", "Avia", 125, 403, tmp_path)
    run, exact = cell.run(), ExactDrive(cell).drive
    run_classify(run, 2)

    def off(track):  # from the vehicle that carries the LiDAR
        return np.linalg.norm(track.poses[:, :2, 3] - exact.poses[:, :2, 3], axis=1)

    car = min(exact.tracks(), key=lambda track: off(track).max())

    def near(track):
        at = np.searchsorted(car.times, track.times)
        turn = np.linalg.inv(car.poses[at]) @ track.poses
        return np.linalg.norm(turn[:, :2, 3], axis=1) < 4, np.arctan2(turn[:, 1, 0], turn[:, 0, 0])

    track = max(read_tracks(run.path / TRACKS), key=lambda track: near(track)[0].sum())
    is_near, heading = near(track)
    assert is_near.sum() == len(track) > 120
    assert np.abs(heading).max() < 0.5


@pytest.mark.nightly
def test_an_oncoming_car_of_which_each_sweep_of_a_rosette_sees_another_part_is_tracked(tmp_path):
    """It comes at 34 m/s. By the first two parts that are seen of it, it seems 5 m/s slower."""
    from cells import Cell, ExactDrive

    cell = Cell("highway", "Avia", 40, 7, tmp_path)
    run, exact = cell.run(), ExactDrive(cell).drive
    run_classify(run, 2)
    car = next(track for track in exact.tracks() if track.id == 12)
    assert np.linalg.norm(car.velocities[0]) > 33

    def meets(track):
        common, mine, its = np.intersect1d(track.times, car.times, return_indices=True)
        off = track.poses[mine, :2, 3] - car.poses[its, :2, 3]
        return len(common) > 3 and np.linalg.norm(off, axis=1).max() < 2

    assert sum(meets(track) for track in read_tracks(run.path / TRACKS)) == 1
