"""Loop closure on a ring through a town of boxes, whose poses drift by a known amount."""

from __future__ import annotations

import sys
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from docdepth.config import OdometryParameters
from docdepth.datasets import Sweep
from docdepth.errors import MissingExtraError
from docdepth.geometry.se3 import inverse, rotation_exp, se3_exp
from docdepth.odometry import loop_closure
from docdepth.odometry.loop_closure import LEAST_PATH, close_loops, consistent, passes, revisits
from docdepth.odometry.odometry import estimate_poses
from docdepth.odometry.places import Place, Placed, locate
from docdepth.odometry.pose_graph import Edge
from docdepth.odometry.registration_log import RegistrationLog
from docdepth.odometry.sweeps import ThinnedSweeps
from exact_drive import nearest_box
from lidar_rays import scan_rays
from motion import straight

RADIUS, STEP = 30.0, 1.5  # metres; of the ring, and from sweep to sweep
LAP = round(2 * np.pi * RADIUS / STEP)
COUNT = LAP + 45
DRIFT = se3_exp(np.array([2e-5, 2e-5, 1e-4]), np.array([0.015, 0.005, 0.006]))  # of each step
SHARE = 0.03


class Town:
    """Boxes beside the ring, and the plane that they stand on."""

    def __init__(self, seed: int) -> None:
        rng, boxes = np.random.default_rng(seed), []
        for angle in np.arange(0, 2 * np.pi, 2 * np.pi / 26):
            for radius in (rng.uniform(16, 22), rng.uniform(38, 44)):
                centre = radius * np.array([np.cos(angle), np.sin(angle)])
                half = rng.uniform(0.5, 3.0, 2)
                boxes.append((*(centre - half), 0, *(centre + half), rng.uniform(2, 9)))
        boxes.append((-200, -200, -3, 200, 200, 0))
        self.low, self.high = np.hsplit(np.array(boxes), 2)


class Ring:
    """A drive a little more than once around; on the second lap it may see another town."""

    path, poses, cameras = Path("ring"), None, {}

    def __init__(self, later_town: int = 0) -> None:
        angles = STEP / RADIUS * np.arange(COUNT)
        self.times = np.arange(COUNT, dtype=np.int64) * 10**8
        self.exact = np.repeat(np.eye(4)[None], COUNT, axis=0)
        self.exact[:, :3, :3] = rotation_exp(np.stack([0 * angles, 0 * angles, angles], axis=1))
        self.exact[:, 0, 3], self.exact[:, 1, 3] = RADIUS * np.sin(angles), -RADIUS * np.cos(angles)
        self.exact[:, 2, 3] = 1.8
        self.exact = inverse(self.exact[0]) @ self.exact
        self.towns = [Town(0), Town(later_town)]
        self.sweep = cache(self.sweep)  # type: ignore[method-assign]

    def __len__(self) -> int:
        return COUNT

    @property
    def drifted(self) -> np.ndarray:
        steps = inverse(self.exact[:-1]) @ self.exact[1:] @ DRIFT
        poses = [np.eye(4)]
        for step in steps:
            poses.append(poses[-1] @ step)
        return np.array(poses)

    def sweep(self, index: int) -> Sweep:
        rays = scan_rays(np.radians(np.linspace(-20, 14, 18)), np.radians(np.arange(0, 360, 3)))
        rays = rays.reshape(-1, 3)
        pose = self.exact[index]
        origin = pose[:3, 3] + (0, -RADIUS, 1.8)  # the town's frame
        town = self.towns[index >= LAP - 5]
        distance, _ = nearest_box(origin, rays @ pose[:3, :3].T, town.low, town.high)
        points = rays * np.where(np.isfinite(distance), distance, 0)[:, None]
        return Sweep(points.astype(np.float32), f"{index:06d}", int(self.times[index]))


def sweeps_of(ring: Ring) -> ThinnedSweeps:
    return ThinnedSweeps(ring, OdometryParameters(), 0.25, 64)


@pytest.fixture(scope="module")
def ring() -> Ring:
    return Ring()


@pytest.fixture(scope="module")
def closed(ring: Ring) -> np.ndarray:
    return close_loops(sweeps_of(ring), ring.drifted, SHARE)


def off(poses: np.ndarray, ring: Ring) -> np.ndarray:
    return np.linalg.norm((poses - ring.exact)[:, :3, 3], axis=1)


def test_a_street_seen_again_is_one_map(ring: Ring, closed: np.ndarray) -> None:
    again, first = np.arange(LAP, COUNT), np.arange(COUNT - LAP)

    def gap(poses: np.ndarray) -> np.ndarray:
        """Of a pose on the second lap from where the first lap puts it."""
        wanted = inverse(ring.exact[first]) @ ring.exact[again]
        return np.linalg.norm((inverse(poses[first]) @ poses[again] - wanted)[:, :3, 3], axis=1)

    assert gap(ring.drifted).max() > 0.8
    assert gap(closed).max() < 0.2 * gap(ring.drifted).max()
    assert off(closed, ring).max() < 0.6 * off(ring.drifted, ring).max()
    np.testing.assert_allclose(closed[0], np.eye(4), atol=1e-12)


@pytest.mark.slow
def test_another_town_at_the_same_place_is_refused() -> None:
    """Poses stay what they are, to the last bit."""
    ring = Ring(later_town=5)
    poses = ring.drifted
    looked: list[tuple[str, int, int]] = []
    result = close_loops(sweeps_of(ring), poses, SHARE, lambda *call: looked.append(call))
    assert len(looked) > 3
    assert looked[-1] == ("loop closure", len(looked), len(looked))
    assert result is poses


def test_a_drive_that_does_not_come_back(ring: Ring) -> None:
    poses = straight(COUNT, STEP).poses
    assert close_loops(sweeps_of(ring), poses, SHARE) is poses


class Stopped(BaseException):
    """In place of a signal."""


def test_an_interrupted_search_goes_on(ring, closed, tmp_path, monkeypatch) -> None:
    located: list[object] = []
    locate_again = loop_closure.locate_again

    def counted(*arguments):
        located.append(arguments)
        return locate_again(*arguments)

    def stop(step: str, done: int, total: int) -> None:
        if done == 3:
            raise Stopped

    monkeypatch.setattr(loop_closure, "locate_again", counted)
    kept = RegistrationLog(tmp_path / "loops.log")
    with pytest.raises(Stopped):
        close_loops(sweeps_of(ring), ring.drifted, SHARE, stop, kept)
    kept.close()
    kept = RegistrationLog(tmp_path / "loops.log")
    found: list[int] = []
    again = close_loops(
        sweeps_of(ring), ring.drifted, SHARE, lambda step, done, total: found.append(total), kept
    )
    kept.close()
    np.testing.assert_array_equal(again, closed)
    assert len(located) == found[0] == len(found)


def test_a_place_is_found_where_it_lies(ring: Ring) -> None:
    """Also where no registration would start: metres and degrees off."""
    points = ring.sweep(0).points.astype(np.float64)
    true = se3_exp(np.array([0.0, 0.0, 0.06]), np.array([5.3, -2.2, 0.1]))
    moved = points @ true[:3, :3] - true[:3, 3] @ true[:3, :3]
    placed = locate(Place(points), Place(moved), np.zeros(2), 8.0, 0.1)
    np.testing.assert_allclose(placed.pose, true, atol=0.02)
    assert passes(placed)
    beyond = locate(Place(points), Place(moved), np.zeros(2), 3.0, 0.1)
    assert not passes(beyond)


def test_an_empty_place_is_refused(ring: Ring) -> None:
    points = ring.sweep(0).points.astype(np.float64)
    assert not passes(locate(Place(points), Place(points[:40]), np.zeros(2), 8.0, 0.1))
    assert not passes(locate(Place(points[:0]), Place(points), np.zeros(2), 8.0, 0.1))


def test_a_place_that_looks_the_same_elsewhere_is_refused() -> None:
    """Along two walls with a door every 8 m nothing tells where one is."""
    x = np.arange(-45, 45, 0.4)
    walls = [
        np.stack(np.meshgrid(x, [y], np.arange(0, 6, 0.4)), -1).reshape(-1, 3) for y in (-8.0, 8.0)
    ]
    doors = [np.array([d, 7.0, z]) for d in np.arange(-40, 41, 8.0) for z in np.arange(0, 3, 0.4)]
    street = np.concatenate([*walls, doors])
    placed = locate(Place(street), Place(street), np.zeros(2), 12.0, 0.04)
    assert placed.overlap > 0.9
    assert placed.lead < 1.1
    assert not passes(placed)


@pytest.mark.parametrize(
    ("name", "value"),
    [("likeness", 0.2), ("lead", 1.01), ("overlap", 0.3), ("turn", 0.02), ("shift", 0.5)],
)
def test_each_check_refuses(name: str, value: float) -> None:
    right = Placed(np.eye(4), likeness=0.8, lead=1.5, overlap=0.8, turn=0.001, shift=0.01)
    assert passes(right)
    assert not passes(right._replace(**{name: value}))


def test_closures_have_to_agree() -> None:
    arc = 10.0 * np.arange(60)
    poses = straight(60, 10).poses
    drift = se3_exp(np.array([0.0, 0.0, 0.02]), np.array([-395.0, 2.0, 1.0]))
    right = [Edge(k, k + 40, inverse(poses[k]) @ drift @ poses[k + 40]) for k in range(5)]
    wrong = Edge(2, 43, right[2].pose @ se3_exp(np.zeros(3), np.array([12.0, 1.0, 0.0])))
    assert consistent([*right[:3], wrong, *right[3:]], poses, arc) == right
    assert consistent(right[:2], poses, arc) == []
    assert consistent([wrong], poses, arc) == []
    assert consistent([], poses, arc) == []


def test_the_radius_grows_with_the_path() -> None:
    """A plain loop over all pairs says which nodes may be near each other."""
    rng = np.random.default_rng(2)
    positions = np.cumsum(rng.normal(0, 6, (200, 3)) * (1, 1, 0.1), axis=0)
    arc = 10.0 * np.arange(200)
    near: dict[int, list[int]] = {}
    for later in range(200):
        for earlier in range(later):
            path = arc[later] - arc[earlier]
            away = np.hypot(*(positions[earlier] - positions[later])[:2])
            if path >= LEAST_PATH and away <= 2.0 + 0.02 * path + 15.0:
                near.setdefault(later, []).append(earlier)
    expected = set()
    for later, all_earlier in near.items():
        visits = [[all_earlier[0]]]
        for a, b in pairwise(all_earlier):
            if b > a + 1:
                visits.append([])
            visits[-1].append(b)
        for visit in visits[-2:]:
            away = [np.hypot(*(positions[k] - positions[later])[:2]) for k in visit]
            expected.add((visit[int(np.argmin(away))], later))
    found = revisits(positions, arc, 0.02)
    assert {(v.earlier, v.later) for v in found} == expected
    assert len(found) == len(expected) > 20
    for v in found:
        assert v.radius == pytest.approx(2.0 + 0.02 * (arc[v.later] - arc[v.earlier]))


def test_without_scipy_nothing_is_begun(ring: Ring, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "scipy.sparse.linalg", None)
    calls: list[int] = []
    with pytest.raises(MissingExtraError, match=r"pip install 'docdepth\[loops\]'"):
        estimate_poses(ring, OdometryParameters(loop_closure=0.02), lambda *_: calls.append(1))
    assert not calls


def test_one_closure_that_the_others_contradict_is_dropped(ring, closed, monkeypatch) -> None:
    """It passes all checks of its own, and gets by those of consistency."""
    honest = loop_closure.consistent

    def with_a_lie(edges, poses, arc):
        kept = honest(edges, poses, arc)
        lie = kept[4].pose @ se3_exp(np.zeros(3), np.array([3.0, 1.0, 0.0]))
        return [*kept, Edge(kept[4].a, kept[4].b + 1, lie)]

    monkeypatch.setattr(loop_closure, "consistent", with_a_lie)
    found = close_loops(sweeps_of(ring), ring.drifted, SHARE)
    np.testing.assert_array_equal(found, closed)
