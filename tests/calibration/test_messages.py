"""Each mistake with boards has its own message, with the remedy."""

from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
from boards import BOARD, LENS, all_poses, corners_of, pair, pairs, pose, sweep_of

from docdepth.calibration import calibrate as module
from docdepth.calibration.board import Board
from docdepth.calibration.calibrate import BoardPair, _that_disagree, find
from docdepth.calibration.quality import LeftOutBoard
from docdepth.calibration.sweeps import board_sweep
from docdepth.errors import CalibrationError
from docdepth.geometry.se3 import rotation_exp

SIZE = (LENS.width, LENS.height)


@contextmanager
def refused(code):
    with pytest.raises(CalibrationError) as error:
        yield
    assert error.value.code == code


def find_all(given, board=BOARD, lens=LENS):
    return find(board, given, SIZE, lens)


def with_other(exact_pairs, k, other):
    return [*exact_pairs[:k], other, *exact_pairs[k + 1 :]]


def test_too_few_boards(exact_pairs):
    few = [*exact_pairs[:3], replace(exact_pairs[3], corners=None)]
    with refused("few-boards"):
        find_all(few)


def test_a_board_out_of_the_picture(exact_pairs):
    cut = replace(exact_pairs[4], corners=None)
    found, _, not_used = find_all(with_other(exact_pairs, 4, cut))
    assert len(found) == 7
    assert "partly out of the picture" in not_used["pose4"]


def test_parallel_boards():
    poses = [pose(away, angle, -0.2, 0, 0, 10 * k) for k, (away, angle) in
             enumerate([(2.6, 0), (3.0, 0), (3.4, 1), (3.8, -1), (4.2, 0)])]  # fmt: skip
    with refused("parallel-boards"):
        find_all(pairs(poses))


def test_another_size_of_the_board(exact_pairs):
    wider = replace(BOARD, width=BOARD.width + 0.1)
    with refused("size-of-board"):
        find_all(exact_pairs, wider)


def test_another_size_of_the_squares(exact_pairs):
    larger = replace(BOARD, square=1.08 * BOARD.square)
    with refused("size-of-squares"):
        find_all(exact_pairs, larger)


def test_a_board_of_quite_another_size(exact_pairs):
    small = Board(4, 6, 0.05, 0.3, 0.4)
    with refused("board-not-found"):
        find_all(exact_pairs, small)


def test_another_checkerboard_in_one_image(exact_pairs):
    other = replace(exact_pairs[2], corners=np.roll(exact_pairs[2].corners, 3, axis=0))
    _, _, not_used = find_all(with_other(exact_pairs, 2, other))
    assert "miss the checkerboard by" in not_used["pose2"]


def test_wrong_k(exact_pairs):
    lens = replace(LENS, K=LENS.K * ((1.5,), (1.0,), (1.0,)))
    with refused("board-not-found"):
        find_all(exact_pairs, lens=lens)


def test_corners_of_another_checkerboard(exact_pairs):
    others = [replace(p, corners=np.roll(p.corners, 3, axis=0)) for p in exact_pairs]
    with refused("corners-misfit"):
        find_all(others)


def test_a_wall_behind_the_board_and_a_box(exact_pairs):
    T = all_poses()[3]
    found, _, not_used = find_all(with_other(exact_pairs, 3, pair("pose3", T, wall=0.04)))
    assert len(found) == 7
    assert "a wall or person less than 15 cm from the board" in not_used["pose3"]
    assert "`boxes`" in not_used["pose3"]
    corners = BOARD.outline @ T[:3, :3].T + T[:3, 3]
    box = np.stack([corners.min(axis=0) - 0.02, corners.max(axis=0) + 0.02], axis=1)
    boxed = with_other(exact_pairs, 3, pair("pose3", T, wall=0.04, box=box))
    found, _, not_used = find_all(boxed)
    assert not_used == {}
    np.testing.assert_allclose(found[3].T_lidar_board[:3, 3], T[:3, 3], atol=0.05)


def test_walls_behind_all_boards():
    walled = [pair(f"pose{k}", T, wall=0.04) for k, T in enumerate(all_poses()[:5])]
    with refused("board-not-found"):
        find_all(walled)


def test_a_board_that_moved_far(exact_pairs):
    T = all_poses()[5]
    swept = T.copy()
    swept[:3, 3] += (0.1, 0.6, 0.0)
    _, _, not_used = find_all(with_other(exact_pairs, 5, pair("pose5", T, swept)))
    assert "did it move between image and sweep" in not_used["pose5"]


def test_a_board_outside_the_view_of_the_lidar(exact_pairs):
    points = sweep_of(all_poses()[6])
    cut = np.where((points[:, 1] > 0)[:, None], np.nan, points).astype(np.float32)
    cut = BoardPair("pose6", exact_pairs[6].corners, board_sweep(cut))
    _, _, not_used = find_all(with_other(exact_pairs, 6, cut))
    assert "outside its field of view" in not_used["pose6"]


def test_a_board_hidden_from_the_lidar(exact_pairs):
    T = all_poses()[7]
    nearer = T.copy()
    nearer[:3, 3] *= 0.6
    points = np.minimum.reduce  # the nearer of two sweeps, ray by ray
    two = np.stack([sweep_of(T), sweep_of(nearer)])
    first = points(np.linalg.norm(two, axis=2), axis=0)
    rays = two[0] / np.linalg.norm(two[0], axis=1, keepdims=True)
    hidden = board_sweep((rays * first[:, None]).astype(np.float32))
    hidden = BoardPair("pose7", corners_of(T), hidden)
    _, _, not_used = find_all(with_other(exact_pairs, 7, hidden))
    assert "something in front of the board hides it" in not_used["pose7"]


def test_images_and_sweeps_that_do_not_belong_together():
    poses = all_poses()
    mixed = [pair(f"pose{k}", T, poses[(3 * k + 1) % 8]) for k, T in enumerate(poses)]
    with refused("board-not-found"):
        find_all(mixed)


def test_boards_that_disagree_by_centimetres_are_named_the_worst_first():
    def board(name, metres):
        return LeftOutBoard(name, 10 * metres, metres, np.eye(4))

    alike = [board(f"{k}", 0.01) for k in range(6)]
    assert _that_disagree(alike) == {}
    assert _that_disagree([*alike, board("a", 0.025)]) == {}, "less may be noise"
    told = _that_disagree([*alike, board("a", 0.09), board("b", 0.3), board("c", 0.2)])
    assert list(told) == ["b", "c"], "a bad board moves the extrinsic of the others"
    assert "disagree by 30 cm about its place, usual are 1.0 cm" in told["b"]


def test_boards_that_all_disagree(calibrated, monkeypatch):
    found = calibrated.observations
    left_out = [LeftOutBoard(o.name, 1.0, 0.3 if k < 3 else 0.01, np.eye(4))
                for k, o in enumerate(found)]  # fmt: skip
    monkeypatch.setattr(module, "find", lambda *_: (found, calibrated.solution, {}))
    monkeypatch.setattr(module, "solve_bundle", lambda *_: calibrated.solution)
    monkeypatch.setattr(module, "leave_one_out", lambda *_: left_out)
    with refused("boards-disagree"):
        module.calibrate(BOARD, [], SIZE, LENS)


def test_k_of_images_of_another_size(exact_pairs):
    half = replace(LENS, width=LENS.width // 2, height=LENS.height // 2)
    with refused("size-of-images"):
        find_all(exact_pairs, lens=half)


@pytest.mark.parametrize(
    ("worst", "estimated", "codes"),
    [(0.75, True, []), (1.8, True, ["another-lens"]), (1.8, False, ["lens-misfit"])],
)
def test_a_lens_of_another_kind_is_told_by_the_corners_near_the_border(worst, estimated, codes):
    errors = [*[(0.2, 0.01)] * 3, (worst, 0.01)]
    found = module.check_lens(["a", "b", "c", "d"], errors, LENS, estimated)
    assert [one.code for one in found] == codes


def test_a_turned_board_is_no_other_board(exact_pairs):
    """Half a turn in its plane changes nothing that can be seen."""
    T = all_poses()[1].copy()
    T[:3, :3] = T[:3, :3] @ rotation_exp((0.0, 0.0, np.pi))
    found, _, not_used = find_all(with_other(exact_pairs, 1, pair("pose1", T)))
    assert len(found) == 8
    assert not_used == {}
