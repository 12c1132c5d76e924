import logging
import signal
from concurrent.futures import ThreadPoolExecutor

import ground_reference as reference
import numpy as np
import pytest

import docdepth._core as _core
from docdepth.config import GroundParameters, Parameters, parameters
from docdepth.errors import InputError
from docdepth.geometry.se3 import quaternion_to_matrix
from docdepth.geometry.trajectory import Trajectory
from docdepth.ground import growing
from docdepth.ground.growing import GroundMap, chunks, grow_ground
from motion import pose

pytestmark = pytest.mark.usefixtures("whole_ground_search")

PAPER = parameters("paper").ground
COARSE_GROUND = {"voxel_size": 0.1, "plane_distance": 0.1}
COARSE = PAPER.model_copy(update=COARSE_GROUND)


def ground_of(sweeps, poses, ground=None):
    """Ground labels of a drive; ``ground`` are parameters."""
    trajectory = Trajectory(np.arange(len(poses)), poses)
    return grow_ground(sweeps, trajectory, Parameters(ground=ground or GroundParameters()))


def street(rng, n, noise=0.01):
    """World points: a road, a kerb and its pavement 15 cm up, a facade, a ramp, a box."""
    xy = rng.uniform((-8, -6), (8, 6), (n, 2))
    z = 0.01 * xy[:, 0] + np.where(xy[:, 1] > 3, 0.15, 0.0)
    z += np.where(xy[:, 0] > 5, 0.3 * (xy[:, 0] - 5), 0.0)
    road = np.column_stack([xy, z])
    wall = rng.uniform((-8, 5.9, 0), (8, 6.0, 3), (n // 4, 3))
    box = rng.uniform((1, -3, 0), (2, -2, 1), (n // 10, 3))
    return np.concatenate([road, wall, box]) + rng.normal(0, noise, (n + n // 4 + n // 10, 3))


def street_drive(seed=0, sweeps=4, n=6000, noise=0.01):
    """Sweeps of the street in the frame of a sensor 1.7 m above it, far from the world's origin."""
    rng = np.random.default_rng(seed)
    offset = np.array([4000.0, -900.0, 120.0])
    poses = [pose(i - 1.5, 0.1 * i, 1.7, 0.05 * i) for i in range(sweeps)]
    points = []
    for T in poses:
        T[:3, 3] += offset
        local = (street(rng, n, noise) + offset - T[:3, 3]) @ T[:3, :3]
        points.append(local.astype(np.float32))
    return points, np.array(poses)


def real_sweeps(drive, frames, stride=1, reach=None):
    rows = np.loadtxt(drive / "lidar_poses_tum.txt")
    sweeps, poses = [], []
    for i in frames:
        file = drive / "velodyne_points" / "data" / f"{i:010d}.bin"
        points = np.fromfile(file, np.float32).reshape(-1, 4)[::stride, :3].copy()
        if reach is not None:
            points = points[np.linalg.norm(points[:, :2], axis=1) < reach]
        T = pose(*rows[i, 1:4])
        T[:3, :3] = quaternion_to_matrix(rows[i, 4:])
        sweeps.append(points)
        poses.append(T)
    return sweeps, np.array(poses)


def assert_equals_reference(sweeps, poses, p):
    expected, count = reference.label_sweeps(sweeps, poses, p)
    for threads in (1, 2):
        ground_map = GroundMap(p, threads)
        for points, T in zip(sweeps, poses, strict=True):
            ground_map.insert(points, T)
        assert ground_map.grow() == count
        for points, T, labels in zip(sweeps, poses, expected, strict=True):
            np.testing.assert_array_equal(ground_map.label(points, T), labels)
    return np.concatenate(expected)


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_labels_equal_plain_growing(noise):
    sweeps, poses = street_drive(noise=noise)
    ground = assert_equals_reference(sweeps, poses, COARSE)
    assert 0.3 < ground.mean() < 0.9


@pytest.mark.parametrize(("step_height", "least"), [(0, 0.5), (0.25, 0.99)])
def test_rings_of_a_lidar_that_stands_are_ground(step_height, least):
    """Points err by 2 cm along the rays: those of a ring seem to lie on a slope of 20 degrees."""
    rng = np.random.default_rng(1)
    rays = []
    for depression in np.radians(np.arange(20.0, 8.0, -1.2)):
        azimuth = np.arange(0, 2 * np.pi, 0.005)
        flat = np.cos(depression)
        down = np.full(len(azimuth), -np.sin(depression))
        rays.append(np.column_stack([flat * np.cos(azimuth), flat * np.sin(azimuth), down]))
    rays = np.concatenate(rays)
    box = np.array([4.0, 1.0, -1.5]) + rng.uniform(0, 1, (2000, 3))
    sweeps = []
    for _ in range(8):
        distance = -1.7 / rays[:, 2] + rng.normal(0, 0.02, len(rays))
        sweeps.append(np.concatenate([distance[:, None] * rays, box]).astype(np.float32))
    poses = np.tile(np.eye(4), (8, 1, 1))
    p = GroundParameters(seed_radius=6.0, step_height=step_height)
    ground = assert_equals_reference(sweeps, poses, p).reshape(8, -1)
    assert ground[:, : len(rays)].mean() > least
    assert ground[:, len(rays) :].mean() < 0.1


def test_ground_continues_behind_the_gaps_between_rings_of_a_lidar_that_stands():
    """Rings 2 degrees apart meet the road at 19 and 32 m, and a wall that stands at 25 m."""
    rng = np.random.default_rng(2)
    azimuth = np.arange(0, 2 * np.pi, 0.004)
    depression = np.radians(np.arange(15.0, 0, -2))[:, None]
    across, down = np.cos(depression), np.sin(depression) * np.ones(len(azimuth))
    rays = np.stack([across * np.cos(azimuth), across * np.sin(azimuth), -down], -1).reshape(-1, 3)
    road, wall = -1.7 / rays[:, 2], np.where(rays[:, 0] > 0.7, 25 / rays[:, 0], np.inf)
    rays, road, wall = (of[np.minimum(road, wall) < 60] for of in (rays, road, wall))
    exact = np.minimum(road, wall)
    noisy = [exact + rng.normal(0, 0.02, len(exact)) for _ in range(8)]
    sweeps = [(distance[:, None] * rays).astype(np.float32) for distance in noisy]
    ground = assert_equals_reference(sweeps, np.tile(np.eye(4), (8, 1, 1)), GroundParameters())
    ground = ground.reshape(8, -1)
    far = (road < wall) & (road > 25)
    assert far.sum() > 500
    assert ground[:, far].mean() > 0.95
    assert not ground[:, exact * rays[:, 2] > -1.2].any()


def test_ties_of_distance_are_resolved_alike():
    """A perfect lattice is nothing but ties."""
    x, y = np.meshgrid(np.arange(-15, 15), np.arange(-15, 15))
    lattice = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]) * 0.25
    lattice[(x == 4).ravel()] += (0, 0, 0.0625)
    p = PAPER.model_copy(update={"voxel_size": 0.125, "plane_distance": 0.05})
    for neighbors in (5, 12, 30):
        q = p.model_copy(update={"neighbors": neighbors})
        assert_equals_reference([lattice.astype(np.float32)], pose(z=1.0)[None], q)


STEP = {"step_height": 0.25, "seed_quantile": 0.1}
OTHERS = [
    {"neighbors": 8},
    {"max_slope_deg": 4.0},
    {"seed_radius": 0.2},
    {"seed_quantile": 0.3},
    STEP,
    STEP | {"neighbors": 8},
]


@pytest.mark.parametrize("update", OTHERS)
def test_labels_equal_plain_growing_at_other_parameters(update):
    sweeps, poses = street_drive(seed=3, n=3000)
    assert_equals_reference(sweeps, poses, COARSE.model_copy(update=update))


@pytest.mark.slow
@pytest.mark.parametrize("update", [{}, STEP])
def test_labels_equal_plain_growing_on_real_sweeps(drive_0005, update):
    sweeps, poses = real_sweeps(drive_0005, range(40, 52, 4), stride=3, reach=25.0)
    p = PAPER.model_copy(update={"voxel_size": 0.1} | update)
    assert 0.1 < assert_equals_reference(sweeps, poses, p).mean() < 0.9


def test_road_is_ground_and_the_rest_is_not():
    sweeps, poses = street_drive(n=20000, noise=0.003)
    labels = ground_of(sweeps, poses, COARSE)
    for points, T, ground in zip(sweeps, poses, labels, strict=True):
        x, y, z = (points @ T[:3, :3].T + T[:3, 3] - (4000.0, -900.0, 120.0)).T
        road = (np.abs(y) < 2.5) & (x < 4.5) & (np.abs(z - 0.01 * x) < 0.02)
        road &= (x < 0.5) | (x > 2.5) | (y > -1.5) | (y < -3.5)
        assert ground[road].mean() > 0.99
        assert not ground[z > 1.5].any()
        assert not ground[(y > 5.5) & (z > 0.4) & (x < 4)].any()


@pytest.mark.parametrize(("height", "climbed"), [(0.0, False), (0.1, False), (0.25, True)])
def test_ground_continues_behind_a_kerb_no_higher_than_a_step(height, climbed):
    """A road, a pavement 15 cm higher, and behind it a wall 50 cm high with a lawn on top."""
    x, y = (c.ravel() for c in np.meshgrid(np.arange(-8, 8, 0.08), np.arange(-4, 8, 0.08)))
    z = np.where(y > 5, 0.65, np.where(y > 2, 0.15, 0.0))
    up = np.arange(0.01, 0.65, 0.05)
    kerb, wall = (np.stack(np.meshgrid(x[:200], [at], h), -1) for at, h in ((2, up[:3]), (5, up)))
    faces = np.concatenate([kerb.reshape(-1, 3), wall.reshape(-1, 3)])
    points = np.concatenate([np.column_stack([x, y, z]), faces]) - (0, 0, 1.7)
    p = GroundParameters(step_height=height)
    (ground,) = ground_of([points.astype(np.float32)], np.eye(4)[None], p)
    plane = ground[: len(x)]
    assert plane[y < 1.9].all()
    assert plane[(y > 2.2) & (y < 4.8)].mean() == climbed
    assert not plane[y > 5.2].any()


def test_world_origin_does_not_matter():
    sweeps, poses = street_drive()
    near = poses.copy()
    near[:, :3, 3] -= poses[0, :3, 3]
    for a, b in zip(ground_of(sweeps, poses), ground_of(sweeps, near), strict=True):
        np.testing.assert_array_equal(a, b)


def test_chunks_overlap(monkeypatch):
    path = np.tile(np.eye(4), (9, 1, 1))
    path[:, 0, 3] = 10 * np.arange(9)
    drive = Trajectory(np.arange(9), path)
    monkeypatch.setattr(growing, "CHUNK_OVERLAP", 15)
    found = chunks(drive, GroundParameters(chunk_length=30))
    assert found == [
        ([0, 1, 2], [0, 1, 2, 3]),
        ([3, 4, 5], [2, 3, 4, 5, 6]),
        ([6, 7, 8], [5, 6, 7, 8]),
    ]
    monkeypatch.setattr(growing, "CHUNK_OVERLAP", 0)
    apart = chunks(drive, GroundParameters(chunk_length=30))
    assert all(frames == merged for frames, merged in apart)
    assert sorted(i for frames, _ in found for i in frames) == list(range(9))


def test_labels_do_not_depend_on_where_chunks_begin(monkeypatch):
    rng, sweeps = np.random.default_rng(3), []
    way = np.array([pose(7.013 * i, 0.017 * i, 1.7, 0.01 * i) for i in range(12)])
    for T in way:
        world = street(rng, 6000)
        world[:, 0] += T[0, 3]
        sweeps.append(((world - T[:3, 3]) @ T[:3, :3]).astype(np.float32))
    monkeypatch.setattr(growing, "CHUNK_OVERLAP", 40)  # sweeps reach 10 m
    whole, *parts = (
        ground_of(sweeps, way, GroundParameters(chunk_length=length)) for length in (500, 30, 45)
    )
    assert 0.2 < np.concatenate(whole).mean() < 0.9
    for part in parts:
        np.testing.assert_array_equal(np.concatenate(part), np.concatenate(whole))


def test_warns_when_there_is_almost_no_ground(caplog):
    sweeps, poses = street_drive(sweeps=1)
    hole = np.array([[0.2, 0.1, -9.0]], dtype=np.float32)
    ground_map = GroundMap(COARSE)
    ground_map.insert(np.concatenate([sweeps[0], hole]), poses[0])
    with caplog.at_level(logging.WARNING, "docdepth.ground.growing"):
        assert ground_map.grow() < 100
    assert "almost no ground" in caplog.text


def test_ghost_returns_below_the_road_do_not_take_its_seeds():
    sweeps, poses = street_drive()
    ghosts = np.random.default_rng(1).uniform([-1, -1, -9], [1, 1, -4], (20, 3)).astype(np.float32)
    mirrored = [np.concatenate([s, ghosts]) for s in sweeps]
    robust = COARSE.model_copy(update={"seed_quantile": GroundParameters().seed_quantile})
    expected = np.concatenate(ground_of(sweeps, poses, robust))
    found = np.concatenate([g[:-20] for g in ground_of(mirrored, poses, robust)])
    assert (found == expected).mean() > 0.999
    assert expected.mean() > 0.3
    assert np.concatenate(ground_of(mirrored, poses, COARSE)).mean() < 0.01


def test_the_vehicle_body_is_not_ground():
    sweeps, poses = street_drive(sweeps=1)
    x, down = np.random.default_rng(2).uniform([[-1], [0]], [[1], [0.4]], (2, 60))
    body = np.column_stack([x, np.sign(x) * (1.2 + down / 2), -0.4 - down]).astype(np.float32)
    seen = [np.concatenate([s[np.hypot(*s[:, :2].T) > 3.7], body]) for s in sweeps]
    robust = GroundParameters(**COARSE_GROUND)
    labels = assert_equals_reference(seen, poses, robust)
    assert labels.mean() > 0.3
    assert not labels[-60:].any()
    assert np.concatenate(ground_of(seen, poses, COARSE)).mean() < 0.01


def test_empty_sweeps_have_no_ground():
    nothing = np.empty((0, 3), dtype=np.float32)
    ground_map = GroundMap(COARSE)
    ground_map.insert(nothing, np.eye(4))
    assert ground_map.grow() == 0
    assert ground_map.label(nothing, np.eye(4)).shape == (0,)
    one = np.array([[1, 2, 3]], dtype=np.float32)
    assert not ground_map.label(one, np.eye(4)).any()


def test_bad_input_is_named():
    good, T = np.ones((3, 3), dtype=np.float32), np.eye(4)
    ground_map = GroundMap(COARSE)
    with pytest.raises(ValueError, match=r"\(N, 3\)"):
        ground_map.insert(np.ones((3, 4), dtype=np.float32), T)
    with pytest.raises(InputError, match="not finite"):
        ground_map.insert(np.array([[1, 1, 1], [np.nan, 0, 0]], dtype=np.float32), T)
    with pytest.raises(ValueError, match="not a rotation"):
        ground_map.insert(good, 2 * T)
    with pytest.raises(InputError, match="too far"):
        ground_map.insert(np.full((1, 3), 1e9, dtype=np.float32), T)
    with pytest.raises(InputError, match="2 sweeps"):
        ground_of([good, good], T[None])
    with pytest.raises(InputError, match="0 sweeps"):
        ground_of([], T[None])


def test_growth_of_the_ground_ends_when_it_is_interrupted():
    """A chunk of half a kilometre grows for many seconds."""
    x, y = np.meshgrid(np.arange(1000), np.arange(1000))
    floor = np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3).astype(np.float32) * np.float32(0.03)
    ground_map = _core.GroundMap(_core.GroundParameters(), 1)
    ground_map.insert(floor, np.eye(4))

    def interrupt(*_):
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGALRM, interrupt)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.05)
        with pytest.raises(KeyboardInterrupt):
            ground_map.grow()
    finally:
        signal.signal(signal.SIGALRM, before)
    assert not ground_map.label(floor, np.eye(4)).any(), "it had grown to its end"
    assert ground_map.grow() == len(ground_map)


def test_a_ground_map_is_filled_from_several_threads():
    ground_map = _core.GroundMap(_core.GroundParameters(), 2)
    numbers = np.random.default_rng(0)
    clouds = [numbers.uniform(-9, 9, (5000, 3)).astype(np.float32) for _ in range(24)]

    def use(points: np.ndarray) -> int:
        ground_map.insert(points, np.eye(4))
        ground_map.grow()
        return int(ground_map.label(points, np.eye(4)).sum())

    with ThreadPoolExecutor(6) as pool:
        assert len(list(pool.map(use, clouds))) == len(clouds)
