"""The sweeps of an image, against the same rules on the whole trajectory."""

from __future__ import annotations

import numpy as np
import pytest
from render_reference import PAPER, TRIANGLES, compose_depth, drawing, render_sweep

from docdepth.geometry.track import Tracks
from docdepth.geometry.trajectory import Trajectory
from docdepth.render.selection import (
    STEP_GROWTH,
    _roundest,
    drawn_sweeps,
    needed_sweeps,
    static_sweeps,
    times_needed,
)
from motion import moving_track


def reference(trajectory, time, p):
    """Whole arrays, without any search."""
    arc = trajectory.arc_length
    ahead = arc - trajectory.arc_length_at(time)[0]
    window = np.flatnonzero((-p.behind < ahead) & (ahead < p.ahead))
    delay = np.abs(trajectory.times - np.int64(time))
    kept = []
    if p.primitive == "splats":
        for place in np.unique(arc[window]):
            if not kept or place - arc[kept[-1]] >= p.step:
                here = window[arc[window] == place]
                kept.append(int(here[np.argmin(delay[here])]))
        return kept
    nearest = int(np.argmin(delay))
    multiple = (arc // p.step).astype(np.int64)
    for k in window[np.diff(multiple, prepend=-1)[window] > 0]:
        passed = range(multiple[k - 1] + 1 if k else 0, multiple[k] + 1)
        spacing = p.step * max(n & -n or np.inf for n in passed)
        apart = abs(arc[k] - arc[nearest]) >= p.step / 2
        if apart and STEP_GROWTH * abs(ahead[k]) <= spacing:
            kept.append(int(k))
    kept.sort(key=lambda k: abs(ahead[k]))
    return [nearest, *kept]


def random_drive(rng, n):
    """Stop and go, with a tunnel that no sweep was recorded in."""
    speed = (
        np.clip(np.cumsum(rng.normal(0, 0.3, n)) + 3, 0, 30)
        * rng.integers(0, 2, n // 50 + 1)[np.arange(n) // 50]
    )
    poses = np.repeat(np.eye(4)[None], n, axis=0)
    poses[:, 0, 3] = np.cumsum(0.1 * speed) + 1e-3 * rng.normal(size=n)
    poses[n // 2 :, 0, 3] += 400
    times = np.arange(n) * 100_000_000 + rng.integers(-20_000_000, 20_000_000, n)
    return Trajectory(times, poses)


@pytest.mark.parametrize("parameters", [PAPER, TRIANGLES])
@pytest.mark.parametrize(("seed", "n"), [(0, 1), (1, 2), (2, 60), (3, 400), (4, 4000)])
def test_selection_equals_the_rules_on_the_whole_trajectory(parameters, seed, n):
    rng = np.random.default_rng(seed)
    trajectory = random_drive(rng, n)
    times = rng.integers(trajectory.times[0], trajectory.times[-1] + 1, 12)
    for time in [*trajectory.times[[0, n // 3, n // 2, -1]], *times]:
        for step in (parameters.step, 2.0):
            p = parameters.model_copy(update={"step": step})
            assert static_sweeps(trajectory, time, p).tolist() == reference(trajectory, time, p)


class Whole(np.ndarray):
    """An array of the whole drive: it can be indexed, and nothing else."""

    def __getitem__(self, key):
        return np.asarray(self)[key]

    def __array_ufunc__(self, *_, **__):
        raise AssertionError("arithmetic on the whole drive")


class Watched(Trajectory):
    @property
    def arc_length(self):
        return self.kept.view(Whole)


@pytest.mark.parametrize("parameters", [PAPER, TRIANGLES])
def test_an_image_costs_the_same_however_long_the_drive_is(parameters):
    trajectory = random_drive(np.random.default_rng(9), 500)
    empty = render_sweep(np.empty((0, 3), np.float32), np.empty(0, np.uint16), parameters)
    watched = Watched(trajectory.times, trajectory.poses)
    object.__setattr__(watched, "kept", trajectory.arc_length)
    object.__setattr__(watched, "poses", trajectory.poses.view(Whole))
    time = int(trajectory.times[200])
    assert drawn_sweeps(watched, time, parameters) == drawn_sweeps(trajectory, time, parameters)
    compose_depth(*drawing(empty, watched, time, parameters))


def random_tracks(rng, trajectory):
    """Vehicles higher than the beams beside the ego, each for a while."""
    found = []
    for number in range(1, 30):
        first, end = np.sort(rng.integers(0, len(trajectory) + 1, 2))
        if end <= first:
            continue
        part = Trajectory(trajectory.times[first:end], trajectory.poses[first:end])
        start = part.poses[0, :3, 3] + (rng.uniform(-20, 20), 4, -1.7)
        kind = ("vehicle", "person", "other")[number % 3]
        found.append(moving_track(part, start, (1, 0, 0), (9, 2.5, 3.6), of=number, kind=kind))
    return Tracks(found)


@pytest.mark.parametrize("parameters", [PAPER, TRIANGLES])
@pytest.mark.parametrize(("seed", "n"), [(0, 1), (1, 2), (2, 60), (3, 400)])
def test_all_sweeps_of_some_images_lie_between_the_times_that_they_need(parameters, seed, n):
    rng = np.random.default_rng(seed)
    trajectory = random_drive(rng, n)
    tracks, further = random_tracks(rng, trajectory), 0
    for _ in range(20):
        images = np.sort(rng.integers(trajectory.times[0], trajectory.times[-1] + 1, 5)).tolist()
        low, high = times_needed(trajectory, images[0], images[-1], parameters, tracks)
        some = Tracks(tracks.between(low, high))
        for time in images:
            needed = needed_sweeps(trajectory, time, parameters, tracks)
            stamps = trajectory.times[list(needed)]
            assert low <= stamps.min()
            assert stamps.max() <= high
            assert needed == needed_sweeps(trajectory, time, parameters, some)
            further += not all(needed.values())
    assert further or n < 60 or parameters is PAPER


def test_tracks_of_a_time_equal_a_plain_loop():
    rng = np.random.default_rng(0)
    trajectory = random_drive(rng, 300)
    tracks = random_tracks(rng, trajectory)
    assert list(tracks) == sorted(tracks) == tracks.ids.tolist()
    times = trajectory.times
    for _ in range(50):
        first, last = np.sort(rng.integers(times[0] - 10**9, times[-1] + 10**9, 2)).tolist()
        right = [t for t in tracks.values() if t.times[0] <= last and t.times[-1] >= first]
        assert tracks.between(first, last) == right
    edge = tracks[tracks.ids[3]]
    assert edge in tracks.between(int(edge.times[-1]), int(edge.times[-1]))
    assert edge not in tracks.between(int(edge.times[-1]) + 1, int(times[-1]))
    assert Tracks().between(0, 1) == []
    assert not Tracks()


def test_the_roundest_number_between_two():
    for first in range(-1, 40):
        for last in range(first + 1, 80):
            by_hand = max(n & -n or np.inf for n in range(first + 1, last + 1))
            assert _roundest(first, last) == by_hand
    assert _roundest(1, 10**18) == 2**59, "at once, however far the poses jump"
