"""Classes from votes, against an independent numpy implementation and exact scenes."""

from dataclasses import replace

import numpy as np
import pytest
from dynamics_reference import reference_moving
from things import with_options

from docdepth.config import parameters
from docdepth.dynamics import voting
from docdepth.dynamics.classes import classify, confidence
from docdepth.dynamics.classifier import classify_drive
from docdepth.dynamics.voting import NEVER, OccupancyIntervals, Votes
from docdepth.errors import InputError

PAPER, DEFAULT = parameters("paper"), parameters("default")
BY_POINTS = parameters(settings={"dynamics.evidence": "points"}).dynamics


def test_moving_box_is_dynamic_and_the_yard_static_without_ground(yard):
    trajectory, sweeps, what = yard
    for ground in ([np.zeros(len(w), bool) for w in what], [w != 1 for w in what]):
        labels = classify_drive(sweeps, trajectory, DEFAULT, ground=ground)
        for label, w, g in zip(labels, what, ground, strict=True):
            # What stands within 8 cm of the ground is taken for it; with three key frames the rim
            # of the box has ties.
            assert (label.classid[w == 2] == 100).mean() > 0.92
            assert (label.classid[w != 2] < 100).mean() > 0.999
            assert (
                label.classid[label.classid != 100] == np.where(g, 0, 50)[label.classid != 100]
            ).all()


def test_feet_labelled_ground_are_dynamic_with_their_object(yard, monkeypatch):
    trajectory, sweeps, what = yard
    above = [sweep[:, 2] + 1.7 for sweep in sweeps]
    ground = [(w == 0) | ((w == 2) & (z < 0.1)) for z, w in zip(above, what, strict=True)]
    constants = voting._surface_parameters
    for margin in (0.03, 0.08):

        def changed(p, margin=margin):
            core = constants(p)
            core.ground_tolerance = margin
            return core

        monkeypatch.setattr(voting, "_surface_parameters", changed)
        labels = classify_drive(sweeps, trajectory, DEFAULT, ground=ground)
        for label, z, w in zip(labels, above, what, strict=True):
            feet = (w == 2) & (z < 0.1)
            assert ((label.classid == 100) == (z > margin))[feet].all()
            assert (label.classid[w == 0] == 0).all()


def test_feet_just_above_labelled_ground_are_dynamic_with_their_object(yard):
    """Their own label is not ground, but that of the returns below them in key frames is."""
    trajectory, sweeps, what = yard
    feet = [(w == 2) & (sweep[:, 2] + 1.7 < 0.08) for sweep, w in zip(sweeps, what, strict=True)]
    assert sum(f.sum() for f in feet) > 400
    for known in (True, False):
        ground = [known & (w == 0) for w in what]
        labels = classify_drive(sweeps, trajectory, DEFAULT, ground=ground)
        for label, f, w in zip(labels, feet, what, strict=True):
            assert ((label.classid[f] == 100) == known).all()
            assert (label.classid[w == 0] != 100).all()


def test_moving_box_is_dynamic_and_the_yard_static_with_the_paper_preset(yard):
    trajectory, sweeps, what = yard
    labels = classify_drive(sweeps, trajectory, PAPER, ground=[w == 0 for w in what])
    for label, sweep, w in zip(labels, sweeps, what, strict=True):
        assert (label.classid[w == 0] == 0).all()
        # Around ground pixels the paper's tau is 0, which costs the foot of a wall.
        above = sweep[:, 2] > -1.2
        assert (label.classid[(w == 1) & above] == 50).all()
        assert (label.classid[w == 1] == 50).mean() > 0.99
        assert (label.classid[w == 2] == 100).mean() > 0.95


def random_votes(points, seed, patches=40):
    """Votes that agree in patches and are wrong here and there, with every share and ratio."""
    rng = np.random.default_rng(seed)
    centres = points[rng.integers(0, len(points), patches)]
    patch = np.linalg.norm(points[:, None] - centres, axis=2).argmin(axis=1)
    static = rng.poisson(rng.choice([0, 0.3, 2, 8], patches)[patch])
    dynamic = rng.poisson(rng.choice([0, 0.3, 2, 8], patches)[patch])
    once = (rng.random(len(points)) < rng.choice([0.1, 0.3, 0.4, 0.9], patches)[patch]) & (
        dynamic > 0
    )
    return in_order(Votes(static.astype(np.uint16), dynamic.astype(np.uint16)), once)


def in_order(votes, once):
    """Votes that tell which places were occupied in one stretch of time."""
    ends = np.full(len(once), NEVER, np.uint16)
    return replace(votes, occupancy=OccupancyIntervals(once, ~once, ends, ends))


@pytest.mark.parametrize("seed", range(4))
def test_shared_evidence_equals_the_reference(yard, seed):
    _, sweeps, what = yard
    rng = np.random.default_rng(seed)
    rows = np.sort(rng.permutation(len(sweeps[seed]))[:15_000])
    points, ground = sweeps[seed][rows], what[seed][rows] == 0
    votes = random_votes(points, seed)
    expected = reference_moving(
        points, ground, votes.static, votes.dynamic, votes.occupancy.occupied_once
    )
    assert 0.05 < expected.mean() < 0.95
    found = classify(ground, votes, DEFAULT.dynamics, points)
    np.testing.assert_array_equal(found == 100, expected)


def test_an_object_is_dynamic_as_a_whole_and_isolated_points_are_not(yard):
    _, sweeps, what = yard
    points, ground = sweeps[6], what[6] == 0
    box = np.flatnonzero(what[6] == 2)
    wall = np.flatnonzero(what[6] == 1)
    votes = Votes(*np.zeros((2, len(points)), np.uint16))
    votes.static[:] = 9
    votes.static[box[::4]] = 20
    votes.dynamic[box] = 12
    votes.dynamic[wall[::100]] = 11
    classid = classify(ground, votes, DEFAULT.dynamics, points)
    assert (classid[box] == 100).all()
    assert (classid[wall] == 50).all()
    # It stands for most of the drive, and two thirds of its place were seen free by two key frames.
    votes.static[box], votes.dynamic[box] = 7, 2
    votes.dynamic[box[::3]] = 0
    left = in_order(votes, votes.dynamic > 0)
    assert (classify(ground, left, DEFAULT.dynamics, points)[box] == 100).all()
    assert (classify(ground, left, BY_POINTS, points)[box] == 50).all()
    # Places that were found free and occupied in turn are porous; so may be all, as far as votes
    # without their order tell.
    few = left.occupancy.occupied_once & (np.arange(len(points)) % 4 == 0)
    for porous in (in_order(votes, few), votes):
        assert (classify(ground, porous, DEFAULT.dynamics, points)[box] == 50).all()


def test_points_without_votes_do_not_count_against_their_object(yard, monkeypatch):
    _, sweeps, what = yard
    points, ground = sweeps[6], what[6] == 0
    box = np.flatnonzero(what[6] == 2)
    votes = Votes(*np.zeros((2, len(points)), np.uint16))
    seen = box[np.argsort(points[box, 2])[-(len(box) // 3) :]]  # the rest stands before the sky
    votes.dynamic[seen] = 3
    assert (classify(ground, votes, DEFAULT.dynamics, points)[box] == 100).all()
    with monkeypatch.context() as patch:
        with_options(patch, min_dynamic_share=0.5)
        assert (classify(ground, votes, DEFAULT.dynamics, points)[box] == 100).mean() < 0.9
    # But where most of those who looked saw it stand, or hardly anybody looked, it does not move.
    votes.static[np.setdiff1d(box, seen)] = 3
    assert (classify(ground, votes, DEFAULT.dynamics, points)[box] == 100).mean() < 0.9
    votes.static[:], votes.dynamic[:] = 0, 0
    votes.dynamic[seen[-len(box) // 8 :]] = 3
    with monkeypatch.context() as patch:
        with_options(patch, min_dynamic_share=0.2)
        assert (classify(ground, votes, DEFAULT.dynamics, points)[box] == 100).mean() < 0.9
    assert (classify(ground, votes, DEFAULT.dynamics, points)[box] == 100).all()
    votes.dynamic[:] = 0
    votes.dynamic[seen[-len(box) // 16 :]] = 3
    assert (classify(ground, votes, DEFAULT.dynamics, points)[box] == 100).mean() < 0.9


def test_an_always_occupied_part_of_a_moving_object_stays_static(yard):
    _, sweeps, what = yard
    points, ground = sweeps[6], what[6] == 0
    box = np.flatnonzero(what[6] == 2)
    mover, beside = box[len(box) // 3 :], box[: len(box) // 3]
    votes = Votes(*np.zeros((2, len(points)), np.uint16))
    votes.dynamic[mover], votes.static[beside] = 9, 8
    classid = classify(ground, votes, DEFAULT.dynamics, points)
    assert (classid[mover] == 100).all()
    assert (classid[beside] == 50).all()
    votes.static[beside] = 7  # not enough looked
    assert (classify(ground, votes, DEFAULT.dynamics, points)[box] == 100).all()
    votes.static[beside], votes.dynamic[beside] = 15, 2  # its place was free at times
    assert (classify(ground, votes, DEFAULT.dynamics, points)[box] == 100).all()


def test_a_flat_object_that_was_observed_free_at_times_is_static():
    """Boughs and signs that key frames look past; as wide as a car, two rows of returns high."""
    for height, classid in ((0.1, 50), (0.5, 100)):
        y, z = np.meshgrid(np.arange(-1, 1, 0.05), np.arange(1, 1 + height, 0.05))
        points = np.stack([np.full(y.shape, 10), y, z], -1).reshape(-1, 3).astype(np.float32)
        votes = Votes(*np.full((2, len(points)), 3, np.uint16))
        votes.static[:] = 9
        ground = np.zeros(len(points), bool)
        left = in_order(votes, votes.dynamic > 0)
        assert set(classify(ground, left, DEFAULT.dynamics, points)) == {classid}


def test_ties_and_unseen_points_are_static():
    votes = Votes(np.array([0, 1, 1, 0, 0], np.uint16), np.array([0, 1, 2, 1, 9], np.uint16))
    ground = np.array([False, False, False, False, True])
    assert list(classify(ground, votes, PAPER.dynamics)) == [50, 50, 100, 100, 0]


def test_wheels_labelled_ground_are_dynamic_where_surfaces_vote():
    votes = Votes(np.array([0, 3], np.uint16), np.array([9, 1], np.uint16))
    assert list(classify(np.ones(2, bool), votes, DEFAULT.dynamics)) == [100, 0]


def test_confidence_of_points_grows_with_agreement():
    static = np.array([0, 5, 1, 0, 0, 30, 60000], np.uint16)
    dynamic = np.array([0, 5, 0, 1, 2, 1, 0], np.uint16)
    expected = [0, 0, 1 / 3, 1 / 3, 1 / 2, 29 / 33, 60000 / 60002]
    found = confidence(Votes(static, dynamic))
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    assert found.dtype == np.float32
    with pytest.raises(InputError, match="differ in shape"):
        confidence(Votes(static, dynamic[:-1]))
