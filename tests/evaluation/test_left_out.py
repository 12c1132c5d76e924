"""A LiDAR or beams left out of depth maps: on a synthetic rig whose exact surfaces are known."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from docdepth.cli import app
from docdepth.datasets import kitti_lidar
from docdepth.errors import InputError
from docdepth.evaluation.depth_metrics import DepthErrors
from docdepth.evaluation.held_out import evaluate_held_out
from docdepth.evaluation.left_out import LeftOut, Neighbour, beam_of, between_sides
from docdepth.geometry.lidar_frame import LidarFrame, SensorRig, lidar_views
from docdepth.geometry.scan_mesh import ScanMesh
from docdepth.geometry.se3 import inverse, rotation_exp
from docdepth.io.run_folder import RunFolder

pytestmark = pytest.mark.slow

pytest.importorskip("embreex")
scipy_spatial = pytest.importorskip("scipy.spatial")

SECOND = LeftOut(lidar=1)
FRAMES = 7


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    """The run of a drive by an upright and a rolled LiDAR."""
    from two_lidars import write_rig

    root = tmp_path_factory.mktemp("rig")
    _, both = write_rig(root, "city", FRAMES, 1)
    command = ["run", str(both), "-o", str(root / "run"), "--poses", "dataset"]
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 0, result.output
    return root / "run"


def frame_of(run, index):
    return RunFolder.open(run).frame(index)


@pytest.fixture
def change(rig):
    """Changes the points of one LiDAR in all sweeps; all is as before afterwards."""
    folder = RunFolder.open(rig)
    kept = {k: folder.frame_path(k).read_bytes() for k in range(FRAMES)}
    keys = {k: folder.key(folder.frame_path(k)) for k in kept}

    def scale(lidar, factor):
        for k in kept:
            frame = folder.frame(k)
            factors = np.where(frame.sensor_rig.index == lidar, np.float32(factor), np.float32(1))
            folder.write_frame(k, replace(frame, points=frame.points * factors[:, None]), keys[k])

    yield scale
    for k, content in kept.items():
        folder.write(folder.frame_path(k), lambda stream, c=content: stream.write(c), keys[k])


def test_the_second_lidar_agrees_with_maps_of_the_first(rig):
    result = evaluate_held_out(rig, every=2, left_out=SECOND)
    assert result.sweeps == 3
    assert 0.3 * result.all.pixels < result.clear.pixels < 0.9 * result.all.pixels
    assert result.clear.density > 97
    assert result.clear.rmse < 0.4 < result.all.rmse
    assert result.clear_point_to_point < result.point_to_point < 0.2
    assert "LiDAR 1" in result.table().title


def test_the_left_out_lidar_is_in_no_map(rig, change):
    """Scaled as a whole it must disagree with every map, and its own points must not be drawn."""
    change(1, 1.2)
    result = evaluate_held_out(rig, every=3, left_out=SECOND, max_range=100)
    # It is hidden behind what the first LiDAR sees.
    assert result.clear.pixels < 0.01 * result.all.pixels
    assert result.all.too_near > 90


def test_errors_of_the_drawn_lidar_are_found(rig, change):
    before = evaluate_held_out(rig, every=3, left_out=SECOND).static
    change(0, 1.1)
    after = evaluate_held_out(rig, every=3, left_out=SECOND).static
    assert before.too_far < 4
    assert after.too_far > 80


def test_hidden_returns_are_those_whose_line_to_the_other_lidar_is_blocked(rig):
    from two_lidars import PLACE, SENSOR

    from docdepth.synthetic import Drive, scene, sensor
    from docdepth.synthetic.casting import Rays

    drive = Drive(scene("city", 1), sensor(SENSOR), FRAMES, 1)
    frame = frame_of(rig, 3)
    clear = SECOND.clear(frame)
    own = SECOND.rows(frame)
    pose = drive._scene_poses(drive.times[3:4] / 1e9)[0]
    points = frame.points[own].astype(np.float64)
    assert np.linalg.norm(PLACE) > 0.4
    ranges = np.linalg.norm(points, axis=1)
    directions = points / ranges[:, None] @ pose[:3, :3].T
    origins = np.broadcast_to(pose[:3, 3], directions.shape)
    moment = np.array([drive.times[3] / 1e9])
    rays = Rays(origins, directions, moment, np.zeros(len(points), np.int64))
    hidden = drive.world.cast(rays, 300.0).range < ranges - 0.5
    assert hidden.sum() > 100
    assert clear[own][hidden].mean() < 0.05
    inside = np.abs(np.degrees(np.arcsin(points[:, 2] / ranges))) < 14  # where the first one looks
    assert clear[own][~hidden & inside].mean() > 0.4


@pytest.mark.parametrize("turned_deg", [0, 30])
def test_an_edge_that_only_a_neighbouring_sweep_met_is_not_clear(rig, turned_deg):
    """A return of the first LiDAR stands for a thin post: half as far as all around it."""
    frame = frame_of(rig, 3)
    second = frame.sensor_rig.index == 1
    clear = SECOND.clear(frame)
    unit = frame.points / np.linalg.norm(frame.points, axis=1, keepdims=True)
    tree = scipy_spatial.cKDTree(unit[~second])
    distance, nearest = tree.query(unit)
    distance[~(second & clear)] = np.inf
    assert distance.min() < np.radians(0.05)
    post = np.flatnonzero(~second)[nearest[distance.argmin()]]
    points = frame.points.copy()
    points[post] /= 2
    T = np.eye(4)
    T[:2, :2] = rotation_exp(np.radians((0, 0, turned_deg)))[:2, :2]
    neighbour = Neighbour(replace(frame, points=(points @ T[:3, :3].T).astype("f4")), T)
    lost = clear & ~SECOND.clear(frame, [neighbour])
    apart = np.degrees(np.arccos(np.clip(unit @ unit[post], -1, 1)))
    assert lost[distance.argmin()]
    far = clear & (apart > 3)  # turned points fall at another place in their pixels
    assert lost[far].mean() < (0.01 if turned_deg else 1e-9)
    assert not SECOND.clear(frame, [neighbour])[~clear].any()


def test_points_between_the_sides_of_an_edge_are_those_in_its_triangles(rig):
    """Looked up in a picture, and solved for each of the points and triangles."""
    frame = frame_of(rig, 3)
    view = list(lidar_views(frame.points, frame.sensor_rig))[1]
    points = frame.points[frame.sensor_rig.index == 0][::6]
    found = between_sides(points, view)
    own = points.astype(np.float64) @ inverse(view.T_lidar_sensor)[:3, :3].T
    own += inverse(view.T_lidar_sensor)[:3, 3]
    corners = view.motion_corrected()
    mesh = ScanMesh(corners)

    def angles(p):
        return np.degrees([np.arctan2(p[..., 1], p[..., 0]), np.arcsin(p[..., 2] / norm(p))])

    def norm(p):
        return np.linalg.norm(p, axis=-1)

    at = angles(own)
    least = np.full(len(own), -np.inf)  # how far inside of a triangle, at most [deg]
    for triangle in mesh.triangles[mesh.discontinuity]:
        x, y = angles(corners[triangle].astype(np.float64))
        if np.ptp(x) > 180:
            continue
        sides = []
        for i, j in ((0, 1), (1, 2), (2, 0)):
            along = np.array([x[j] - x[i], y[j] - y[i]])
            across = along[0] * (at[1] - y[i]) - along[1] * (at[0] - x[i])
            sides.append(across / max(np.hypot(*along), 1e-9))
        least = np.maximum(least, np.min(sides, axis=0))
    inside, outside = least > 0.05, least < -0.15
    assert min(inside.sum(), outside.sum()) > 50
    assert found[inside].all()
    assert found[outside & (np.abs(at[0]) < 175)].mean() < 0.01


def test_exact_depth_passes_as_clear(rig):
    """What the evaluation calls clear must fit the truth; of all returns some are metres off."""
    from two_lidars import SENSOR, ExactDepthErrors

    from docdepth.synthetic import Drive, scene, sensor

    drive = Drive(scene("city", 1), sensor(SENSOR), FRAMES, 1)
    exact = ExactDepthErrors(drive, RunFolder.open(rig).calibration()[1])
    evaluate_held_out(rig, every=2, left_out=SECOND, look=exact.look)
    assert exact._sums.errors().rmse > 0.5
    assert exact._sums.errors(interior=1).rmse < 0.1


def test_half_of_the_beams_evaluate_the_others():
    """Bands of elevation are the rings of a LiDAR, and a laser of KITTI's is a beam."""
    from docdepth.synthetic import Drive, scene, sensor

    sweep = Drive(scene("city", 1), sensor("XT-32"), 2).sweep(0)
    (view,) = lidar_views(sweep.points, None)
    beam = beam_of(view, None)
    for ring in range(0, 32, 5):
        values, counts = np.unique(beam[sweep.ring == ring], return_counts=True)
        assert np.ptp(values) <= 2, "a ring may lie on a border, and the vehicle moves"
        assert counts.max() > 0.4 * counts.sum()
    frame = LidarFrame(sweep.points, np.arange(len(beam), dtype=np.uint32), "0", len(beam))
    rows = LeftOut(beams=4).rows(frame)
    assert 0.1 < rows.mean() < 0.4
    lasers = kitti_lidar.sensor_rig(sweep.points)
    np.testing.assert_array_equal(
        beam_of(next(lidar_views(sweep.points, lasers)), lasers), lasers.index
    )


def test_left_out_beams_are_not_drawn(rig):
    """Of the evaluated sweep, the others are whole."""
    folder = RunFolder.open(rig)
    beams = LeftOut(beams=3)
    frame = frame_of(rig, 3)
    rows = beams.rows(frame)
    view = beams.view(frame)
    np.testing.assert_array_equal(np.isfinite(view.points).all(axis=1), rows)
    assert not (rows & (frame.sensor_rig.index == 1)).any()
    before = folder.frame_path(3).read_bytes()
    key = folder.key(folder.frame_path(3))
    factors = np.where(rows, np.float32(0.7), np.float32(1))[:, None]
    seen = []
    evaluate_held_out(rig, every=7, left_out=beams, look=seen.append)
    folder.write_frame(3, replace(frame, points=frame.points * factors), key)
    fixed = replace_beams(rows)
    evaluate_held_out(rig, every=7, left_out=fixed, look=seen.append)
    folder.write(folder.frame_path(3), lambda stream: stream.write(before), key)
    np.testing.assert_array_equal(seen[0].depth, seen[1].depth)
    assert np.nanmedian(seen[1].truth) < 0.8 * np.nanmedian(seen[0].truth)


def test_left_out_sectors_are_every_second_one(rig):
    """Of the evaluated sweep alone, and of the LiDAR that is left out."""
    sectors = LeftOut(sectors=30)
    frame = frame_of(rig, 3)
    rows = sectors.rows(frame)
    first = frame.sensor_rig.index == 0
    azimuth = np.degrees(np.arctan2(frame.points[:, 1], frame.points[:, 0]))[first] % 60
    clearly = (np.abs(azimuth - 30) > 3) & (azimuth > 3) & (azimuth < 57)  # the vehicle moves
    np.testing.assert_array_equal(rows[first][clearly], azimuth[clearly] < 30)
    assert not rows[~first].any()
    seen = []
    result = evaluate_held_out(rig, every=7, left_out=sectors, look=seen.append)
    assert "every second sector of 30 degrees" in result.table().title
    u = np.arange(seen[0].truth.shape[1])
    columns = np.isfinite(seen[0].truth).any(axis=0)
    K = RunFolder.open(rig).calibration()[0].K
    ahead = np.degrees(np.arctan2(K[0, 2] - u, K[0, 0]))  # to the left of the camera's axis
    assert columns[(ahead > 2) & (ahead < 28)].mean() > 0.3
    assert not columns[(ahead < -2) & (ahead > -28)].any()
    assert result.clear.mae < 0.2


def replace_beams(rows):
    """The same rows, whatever the points are."""

    class Fixed(LeftOut):
        def rows(self, frame):
            return rows if len(rows) == len(frame) else super().rows(frame)

    return Fixed(beams=3)


def test_point_to_point_equals_scipy(rig):
    """All pixels of the views as points, nearest neighbours both ways by another tree."""
    views = []
    result = evaluate_held_out(rig, every=4, left_out=SECOND, look=views.append)
    K = RunFolder.open(rig).calibration()[0].K
    distances, errors = [], []
    for view in views:
        both = ~np.isnan(view.depth) & (view.truth <= 80)
        v, u = np.nonzero(both)
        rays = np.column_stack([u, v, np.ones(len(u))]) @ np.linalg.inv(K).T
        clouds = [rays * depth[both][:, None].astype(float) for depth in (view.depth, view.truth)]
        for cloud, other in (clouds, clouds[::-1]):
            distances.append(scipy_spatial.cKDTree(cloud).query(other)[0])
        errors.append((view.truth[both], view.depth[both]))
    assert result.point_to_point == pytest.approx(np.concatenate(distances).mean(), rel=1e-4)
    expected = DepthErrors.of(*(np.concatenate(values) for values in zip(*errors, strict=True)))
    assert result.all.mae == pytest.approx(expected.mae)
    assert result.all.rmse == pytest.approx(expected.rmse)
    d, p, clear = (
        np.concatenate([getattr(view, name)[~np.isnan(view.truth)] for view in views])
        for name in ("truth", "depth", "clear")
    )
    for region, rows in ((result.all, d <= 80), (result.clear, clear & (d <= 80))):
        both = rows & ~np.isnan(p)
        assert (region.pixels, region.compared) == (rows.sum(), both.sum())
        assert region.too_near == pytest.approx(100 * (p < 0.95 * d)[both].mean(), abs=1e-3)
        assert region.too_far == pytest.approx(100 * (p > 1.05 * d)[both].mean(), abs=1e-3)


def test_on_the_command_line(rig):
    def json_of(*options):
        result = CliRunner().invoke(app, ["evaluate", "held-out", str(rig), *options, "--json"])
        assert result.exit_code == 0, result.output
        return json.loads(result.stdout)

    lidar = json_of("--lidar", "1", "--every", "4")
    beams = json_of("--beams", "4", "--every", "4")
    assert "LiDAR 1" in lidar["left_out"]
    assert "4-th beam" in beams["left_out"]
    assert lidar["clear"]["point_to_point"] < lidar["all"]["point_to_point"]


def test_mistakes(rig):
    with pytest.raises(InputError, match="not several of them"):
        LeftOut(lidar=1, beams=2)
    with pytest.raises(InputError, match="sectors of 200 degrees"):
        LeftOut(sectors=200)
    with pytest.raises(InputError, match="every 1-th beam"):
        LeftOut(beams=1)
    with pytest.raises(InputError, match=r"LiDAR 0, 1; LiDAR\s+2"):
        evaluate_held_out(rig, left_out=LeftOut(lidar=2))
    frame = frame_of(rig, 0)
    alone = SensorRig.single((0, 0, 0), len(frame))
    with pytest.raises(InputError, match="cannot be left out"):
        LeftOut(lidar=0).view(replace(frame, sensor_rig=alone))
