"""Which image and which sweep show the same pose of the board."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from docdepth.calibration import pairs as pairs_module
from docdepth.calibration.board import Board
from docdepth.calibration.pairs import board_pairs
from docdepth.datasets import image_streams, open_dataset
from docdepth.errors import CalibrationError, DatasetError

BOARD = Board(4, 3, 0.1, 0.6, 0.5)
GRID = np.stack(np.meshgrid(np.arange(4.0), np.arange(3.0)), axis=-1).reshape(-1, 2)


def write(folder: Path, images, sweeps, image_times=None, sweep_times=None, size=(32, 24)):
    """A folder whose images and sweeps have the number k in their first pixel and point."""
    for name in ("images", "sweeps"):
        (folder / name).mkdir(parents=True)
    for k, name in enumerate(images):
        picture = np.full((size[1], size[0], 3), k, np.uint8)
        cv2.imwrite(str(folder / "images" / f"{name}.png"), picture)
    for k, name in enumerate(sweeps):
        np.save(folder / "sweeps" / f"{name}.npy", np.full((5, 3), 1.0 + k, np.float32))
    settings = {"sweeps": "sweeps", "motion_compensated": True,
                "cameras": {"front": {"images": "images"}}}  # fmt: skip
    if sweep_times is None:
        settings["rate"] = 1
        settings["cameras"]["front"]["times"] = "sweeps"
    else:
        settings["times"] = "sweeps.txt"
        settings["cameras"]["front"]["times"] = "images.txt"
        for name, times in (("sweeps", sweep_times), ("images", image_times)):
            (folder / f"{name}.txt").write_text("".join(f"{t:.3f}\n" for t in times))
    (folder / "docdepth.yaml").write_text(yaml.safe_dump(settings))
    return open_dataset(folder)


def pair_up(recording, monkeypatch, corners=None, counts=None):
    """Names of images, and numbers of their sweeps; ``corners`` gives them by the first pixel."""
    corners = corners or (lambda k: GRID + 10.0 * k)
    monkeypatch.setattr(pairs_module, "counted_corners", lambda image, board, found: counts)
    monkeypatch.setattr(
        pairs_module, "find_corners", lambda image, board, thorough: corners(int(image[0, 0, 0]))
    )
    stream = image_streams(recording)["front"]
    found, size = board_pairs(recording, stream, BOARD)
    assert size == (32, 24)
    return [(pair.name, round(pair.sweep.points[0, 0]) - 1) for pair in found]


def test_numbers_in_names_tell(tmp_path, monkeypatch):
    """In order of their names a2 comes before b1."""
    recording = write(tmp_path, ["b1", "a2", "c3", "d4"], ["s1", "s2", "s3", "s4"])
    assert pair_up(recording, monkeypatch) == [("a2", 1), ("b1", 0), ("c3", 2), ("d4", 3)]


def test_numbers_without_a_partner(tmp_path, monkeypatch):
    recording = write(tmp_path, ["a1", "a2", "a3", "a4"], ["b1", "b2", "b3", "b5"])
    with pytest.raises(DatasetError, match="image a4 has no sweep of the same number"):
        pair_up(recording, monkeypatch)


def test_names_without_numbers_go_in_order(tmp_path, monkeypatch):
    recording = write(tmp_path, ["a", "b", "c", "d"], ["k", "l", "m", "n"])
    assert pair_up(recording, monkeypatch) == [("a", 0), ("b", 1), ("c", 2), ("d", 3)]


def test_stills_go_by_time(tmp_path, monkeypatch):
    names = [f"{k:06d}" for k in range(4)]
    recording = write(tmp_path, names, names[:3], [0.1, 5.2, 9.9, 30.0], [0.0, 5.0, 10.0])
    monkeypatch.setattr(pairs_module, "FEWEST_BOARDS", 3)
    assert pair_up(recording, monkeypatch) == [("000000", 0), ("000001", 1), ("000002", 2)]


def test_moments_of_a_drive_at_which_the_board_stands(tmp_path, monkeypatch):
    """12 s: the board stands in four poses for two seconds each, and moves for one between."""
    times = np.arange(0, 12, 0.2)
    names = [f"{k:06d}" for k in range(len(times))]
    recording = write(tmp_path, names, names, times + 0.03, times)

    def corners(k):
        pose, phase = divmod(times[k], 3.0)
        shift = 100 * pose + (100 * (phase - 2) if phase > 2 else 0.02 * np.sin(9 * phase))
        found = GRID + 20 * shift
        return found[::-1] if k % 3 else found

    found = pair_up(recording, monkeypatch, corners)
    assert len(found) == 4
    for k, (name, sweep) in enumerate(found):
        assert int(name) == sweep
        assert 3 * k < times[sweep] < 3 * k + 2
    # Images that are slower than the sweeps, and come between them.
    slow = np.arange(0.02, 12, 0.4)
    rare = write(tmp_path / "slow", [f"{k:06d}" for k in range(30)], names, slow, times)
    found = pair_up(rare, monkeypatch, lambda k: corners(2 * k))
    assert [round(slow[int(name)] - times[sweep], 3) for name, sweep in found] == [0.02] * 4


def test_a_board_that_never_stands_still(tmp_path, monkeypatch):
    times = np.arange(0, 6, 0.2)
    names = [f"{k:06d}" for k in range(len(times))]
    recording = write(tmp_path, names, names, times, times)
    with pytest.raises(CalibrationError, match=r"still for a second at 0 moments.*rate: 1"):
        pair_up(recording, monkeypatch)


def test_clocks_that_differ(tmp_path, monkeypatch):
    names = [f"{k:06d}" for k in range(4)]
    recording = write(tmp_path, names, names, np.arange(4) + 1000.0, np.arange(4.0))
    with pytest.raises(DatasetError, match=r"no image of front is of the time of a sweep.*clock"):
        pair_up(recording, monkeypatch)


def test_another_checkerboard(tmp_path, monkeypatch):
    names = [f"{k:06d}" for k in range(4)]
    recording = write(tmp_path, names, names)
    with pytest.raises(CalibrationError, match="a checkerboard of 6x9 inner corners, not 4x3"):
        pair_up(recording, monkeypatch, lambda k: None, (6, 9))
    with pytest.raises(CalibrationError, match="count the points where four squares meet"):
        pair_up(recording, monkeypatch, None, (6, 9))  # found, but as a part of a larger one


def test_images_of_two_sizes(tmp_path, monkeypatch):
    names = [f"{k:06d}" for k in range(4)]
    recording = write(tmp_path, names, names)
    cv2.imwrite(str(tmp_path / "images" / "000002.png"), np.zeros((24, 40, 3), np.uint8))
    with pytest.raises(DatasetError, match=r"000002.png is 40x24 pixels, others of front are"):
        pair_up(recording, monkeypatch)


def test_a_box_of_one_image(tmp_path, monkeypatch):
    names = [f"{k:06d}" for k in range(4)]
    recording = write(tmp_path, names, names)
    box = np.array([(0, 2.5)] * 3)
    monkeypatch.setattr(pairs_module, "find_corners", lambda image, board, thorough: GRID)
    stream = image_streams(recording)["front"]
    found, _ = board_pairs(recording, stream, BOARD, {"000001": box, "": 2 * box})
    inside = [pair.sweep.may_be_board.all() for pair in found]
    assert inside == [True, True, True, True]
    found, _ = board_pairs(recording, stream, BOARD, {"000002": box})
    assert [p.sweep.may_be_board is not None for p in found] == [False, False, True, False]
    assert not found[2].sweep.may_be_board.any()
    with pytest.raises(CalibrationError, match="`boxes` names pose7, but front has no such image"):
        board_pairs(recording, stream, BOARD, {"pose7": box})
