"""Layers beside depth, against plain numpy and against exact scenes."""

from __future__ import annotations

import numpy as np
import pytest
from render_reference import (
    PAPER,
    TRIANGLES,
    compose_depth,
    compose_layers,
    drawing,
    drive,
    followed,
    render_sweep,
    small_camera,
    splats_of,
)

from docdepth.errors import InputError
from docdepth.geometry.camera import Camera, View
from docdepth.geometry.track import Tracks
from docdepth.render.layers import _CONFIDENCE, LAYERS, confidence
from docdepth.render.selection import static_sweeps
from lidar_rays import scan_rays
from motion import moving_track, straight

OF_SPLATS = tuple(
    name for name in LAYERS if name not in ("normal", "normal_confidence", "instance", "seen")
)
GROUND, WALL = -1.7, 25.0


def test_layers_of_splats_equal_plain_numpy():
    camera, time = small_camera(), 130_000_000
    trajectory, frames, clouds = drive(np.random.default_rng(5), time, PAPER)
    scene = drawing(frames, trajectory, time, PAPER, camera=camera)
    depth = compose_depth(*scene)
    kept = depth.copy()
    one, two = (compose_layers(OF_SPLATS, depth, *scene, threads=t) for t in (1, 2))
    np.testing.assert_array_equal(depth, kept)
    for name in OF_SPLATS:
        np.testing.assert_array_equal(one[name], two[name])

    agreeing = [[[] for _ in range(camera.width)] for _ in range(camera.height)]
    seen_from = {}
    sweeps = [*static_sweeps(trajectory, time, PAPER), trajectory.nearest(time)]
    for sweep, cloud in zip(sweeps, clouds, strict=True):
        for i, u, v, z, h in zip(*splats_of(camera, *cloud), strict=True):
            for b in range(max(v - h, 0), min(v + h + 1, camera.height)):
                for a in range(max(u - h, 0), min(u + h + 1, camera.width)):
                    if 9 * (a - u) ** 2 + 4 * (b - v) ** 2 > h * h:
                        continue
                    if abs((z - depth[b, a]) / depth[b, a]) <= np.float32(0.02):
                        agreeing[b][a].append(z)
                    if z == depth[b, a]:
                        distance = np.linalg.norm(cloud[0][i])
                        seen_from.setdefault((b, a), set()).add((sweep, distance))
    counts = [[len(cell) for cell in row] for row in agreeing]
    np.testing.assert_array_equal(one["support"], counts)
    deviations = [[np.std(c, ddof=1) if len(c) > 1 else np.nan for c in row] for row in agreeing]
    np.testing.assert_allclose(one["std"], deviations, atol=1e-4)
    for (b, a), sources in seen_from.items():
        if len(sources) == 1:
            sweep, distance = next(iter(sources))
            delay = (trajectory.times[sweep] - time) * 1e-9
            assert one["time"][b, a] == pytest.approx(delay)
            assert one["range"][b, a] == pytest.approx(distance, rel=1e-5)
    nothing = np.isnan(depth)
    assert (one["class"][nothing] == 255).all()
    assert np.isin(one["class"][~nothing], [0, 50, 100]).all()
    assert np.isnan(one["time"][nothing]).all()


def sweep_at(x, box_at=None):
    """A sweep of a road that ends at a wall, optionally with a box that moves ahead of the ego."""
    elevations, azimuths = np.arange(-22, 6, 0.4), np.arange(-60, 60, 0.25)
    ray = scan_rays(np.radians(elevations), np.radians(azimuths)).reshape(-1, 3)
    with np.errstate(divide="ignore"):
        road = np.where(ray[:, 2] < 0, GROUND / ray[:, 2], np.inf)
        distance = np.minimum(road, (WALL - x) / ray[:, 0])
    classid = np.where(distance == road, 0, 50)
    if box_at is not None:
        near = (box_at - x) / ray[:, 0]
        place = near[:, None] * ray
        hit = (np.abs(place[:, 1]) < 1) & (np.abs(place[:, 2] + 0.5) < 0.7) & (near < distance)
        distance, classid = np.where(hit, near, distance), np.where(hit, 100, classid)
    return (ray * distance[:, None]).astype(np.float32), classid.astype(np.uint16)


def street(box=False):
    trajectory, time = straight(5), 50_000_000
    sweeps = [sweep_at(float(i), 10.0 + i if box else None) for i in range(5)]
    track = moving_track(trajectory, (10.5, 0, -1.2), (10, 0, 0), (1, 2, 1.4), of=7)
    frames = [followed(*seen, i, trajectory, track, TRIANGLES) for i, seen in enumerate(sweeps)]
    camera = Camera(np.array([[200.0, 0, 160], [0, 200, 50], [0, 0, 1]]), 320, 120)
    scene = drawing(frames, trajectory, time, camera=camera)
    return scene, compose_depth(*scene, tracks=Tracks([track])), Tracks([track])


def test_layers_of_an_exact_street():
    scene, depth, _ = street()
    view, trajectory, *_ = scene
    time = view.time
    found, again = (compose_layers(LAYERS, depth, *scene, threads=t) for t in (1, 3))
    for name in LAYERS:
        np.testing.assert_array_equal(found[name], again[name])
    u, v = np.meshgrid(np.arange(320), np.arange(120))
    ray = np.stack([(u - 160) / 200, (v - 50) / 200, np.ones(u.shape)], axis=-1)
    seen = np.isfinite(depth)
    wall_depth = WALL - 0.5
    on_wall = seen & (ray[..., 1] * wall_depth < -GROUND - 0.3)
    on_road = seen & (ray[..., 1] * wall_depth > -GROUND + 1.0)
    assert on_wall.sum() > 5000
    assert on_road.sum() > 5000
    assert (found["class"][on_wall] == 50).all()
    assert (found["class"][on_road] == 0).all()
    assert (found["class"][~seen] == 255).all()
    np.testing.assert_allclose(found["normal"][on_wall] @ [0, 0, -1], 1, atol=1e-3)
    np.testing.assert_allclose(found["normal"][on_road] @ [0, -1, 0], 1, atol=1e-3)
    # The sweep that the time layer names measured this range from its pose.
    sweep = np.searchsorted(trajectory.times, time + np.nan_to_num(found["time"]) * 1e9 - 1)
    place = ray * depth[..., None]  # x right, y down, z ahead of x = 0.5
    x = place[..., 2] + 0.5 - trajectory.poses[np.minimum(sweep, 4), 0, 3]
    distance = np.sqrt(x**2 + place[..., 0] ** 2 + place[..., 1] ** 2)
    np.testing.assert_allclose(found["range"][seen], distance[seen], rtol=1e-4)
    # All five sweeps measured the wall straight ahead.
    common = on_wall & (np.abs(ray[..., 0]) < 0.5) & (np.abs(v - 50) < 5)
    assert (found["support"][common] == len(static_sweeps(trajectory, time, TRIANGLES))).all()
    assert found["std"][common].max() < 0.01
    assert (found["support"][~seen] == 0).all()
    single = seen & (found["support"] < 2)
    assert np.isnan(found["std"][single]).all()


def test_support_of_a_moving_box_comes_from_dynamic_points():
    scene, depth, tracks = street(box=True)
    names = ("class", "instance", "support", "range")
    found = compose_layers(names, depth, *scene, tracks=tracks)
    box = np.abs(depth - 10.0) < 0.2
    box &= found["class"] == 100
    assert box.sum() > 200
    # All five sweeps saw the box: those around the image, and one more.
    assert found["support"][box].max() == 5
    assert (found["support"][box] == 5).mean() > 0.5
    assert (found["instance"][box] == 7).all()
    assert (found["instance"][found["class"] != 100] == 0).all()
    # The box stays 10 m ahead of the sensor.
    assert np.abs(found["range"][box] - 10).max() < 1


def test_unknown_layers_are_refused():
    scene, depth, _ = street()
    with pytest.raises(InputError, match="unknown layer 'colour'; there are class,"):
        compose_layers(("colour",), depth, *scene)
    with pytest.raises(InputError, match="of shape \\(120, 320\\)"):
        compose_layers(("class",), depth[:-1], *scene)


def test_confidence_equals_its_formula():
    rng = np.random.default_rng(2)
    depth = np.full((20, 30), 10, np.float32) + rng.normal(0, 0.02, (20, 30)).astype(np.float32)
    depth[:, 18:] = 30
    depth[3:6, 4:7] = np.nan
    measures = rng.integers(1, 9, depth.shape).astype(np.uint16)
    support = np.minimum(rng.integers(0, 9, depth.shape), measures).astype(np.uint16)
    bend = np.ones(depth.shape)
    near = 1 / depth.astype(np.float64)
    for v in range(20):
        for u in range(30):
            known = []
            for dv, du in ((0, 1), (1, 0)):
                if v - dv >= 0 and v + dv < 20 and u - du >= 0 and u + du < 30:
                    known.append(near[v - dv, u - du] + near[v + dv, u + du] - 2 * near[v, u])
            known = [abs(k) / near[v, u] for k in known if np.isfinite(k)]
            bend[v, u] = max(known) if known else 1
    seen = rng.integers(0, 3, depth.shape).astype(np.uint8)
    a, b, c, *doubt = _CONFIDENCE["triangles"]
    doubt = dict(zip((1, 0, 2), (0, *doubt), strict=True))
    found = confidence(depth, support, measures, seen)
    for v in range(20):
        for u in range(30):
            if np.isnan(depth[v, u]):
                assert np.isnan(found[v, u])
                continue
            worst = bend[max(v - 3, 0) : v + 4, max(u - 3, 0) : u + 4].max()
            edge = np.log10(min(max(worst, 1e-3), 1)) / 3 + 1
            s, m = int(support[v, u]), int(measures[v, u])
            odds = max((max(s - 1, 0) + 0.25) / (m - s + 1), 0.25)  # itself confirms nothing
            log_odds = a + b * np.log(odds) - c * edge - doubt[int(seen[v, u])]
            expected = 1 / (1 + np.exp(-log_odds))
            assert found[v, u] == pytest.approx(expected, abs=2e-4)


@pytest.mark.slow
@pytest.mark.parametrize("preset", [TRIANGLES, PAPER])
def test_error_falls_as_confidence_rises(preset):
    """A synthetic crossing with exact classes and depth, not among those of the fit."""
    pytest.importorskip("embreex")
    from docdepth.geometry.trajectory import Trajectory
    from docdepth.synthetic import Drive, scene, sensor

    drive = Drive(scene("crossing", 7), sensor("XT-32"), 25, 7)
    trajectory, camera = Trajectory(drive.times, drive.poses), drive.rig.camera
    frames = {}

    def frame(i):
        if i not in frames:
            sweep = drive.sweep(i)
            classid = np.where(sweep.moving, 100, 50).astype(np.uint16)
            frames[i] = render_sweep(sweep.points, classid, preset)
        return frames[i]

    time = int(drive.camera_times[8])
    view = View.at(camera, drive.rig.T_camera_lidar, trajectory, time)
    scene_of = (view, trajectory, frame, preset)
    depth, truth = compose_depth(*scene_of), drive.image(8).depth
    sure = compose_layers(("confidence",), depth, *scene_of)["confidence"]
    np.testing.assert_array_equal(np.isnan(sure), np.isnan(depth))
    known = np.isfinite(depth) & (truth < 80)
    wrong = np.abs(depth - truth)[known] > 0.05 * truth[known]
    edges = np.unique(np.quantile(sure[known], [0.03, 0.1, 0.3, 0.6]))
    bins = np.digitize(sure[known], edges)
    shares = [wrong[bins == b].mean() for b in np.unique(bins)]
    assert len(shares) > 3
    assert (np.diff(shares) < 0.005).all(), shares
    assert shares[0] > 5 * shares[-1]
    assert abs(sure[known].mean() - (1 - wrong.mean())) < 0.1
