"""The map: one mean point a voxel, classes by majority, objects in the frame of their boxes."""

import shutil
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest

from command_line import cli
from docdepth.errors import InputError
from docdepth.geometry.points import DYNAMIC, STATIC
from docdepth.io.ply import read_vertices
from docdepth.io.run_folder import RunFolder
from docdepth.io.tracks import read_tracks
from docdepth.pipeline import cloud_map
from docdepth.pipeline.cloud_map import VoxelCloud, _shade
from docdepth.visualization.image_views import track_color


def test_a_voxel_has_the_mean_of_its_points(monkeypatch):
    monkeypatch.setattr(cloud_map, "_LEAST_MERGED", 700)
    rng = np.random.default_rng(1)
    origin = np.array([4e6, -3e5, 12.0])  # as in a national grid
    voxels = VoxelCloud(0.5, origin)
    plain = defaultdict(list)
    for _ in range(5):
        points = origin + rng.normal(0, 2, (900, 3))
        ground = rng.random(900) < 0.5
        voxels.add(points, ground)
        for point, on_ground in zip(points, ground, strict=True):
            plain[tuple(np.floor((point - origin) / 0.5))].append((*point, on_ground))
    found, is_ground, counts = voxels.cloud()
    assert len(found) == len(plain)
    for point, on_ground, count in zip(found, is_ground, counts, strict=True):
        own = np.array(plain[tuple(np.floor((point - origin) / 0.5))])
        assert count == len(own)
        np.testing.assert_allclose(point, own[:, :3].mean(axis=0), atol=1e-5)
        assert on_ground == (own[:, 3].mean() > 0.5)
    with pytest.raises(InputError, match="524 km"):
        voxels.add(origin + 1e6, ground[:1])


def test_no_points_are_no_cloud():
    points, is_ground, counts = VoxelCloud(0.1, np.zeros(3)).cloud()
    assert points.shape == (0, 3)
    assert len(is_ground) == len(counts) == 0


def test_points_get_lighter_upwards_from_the_foot_of_their_column():
    heights = np.array([7.0, 5.0, 9.0, 14.0, 5.0])
    points = np.column_stack([[0.2, 0.9, 0.5, 0.5, 1.5], np.full(5, -3.5), heights])
    light = _shade(points)[:, 0]
    np.testing.assert_allclose(light, [0.7, 0.4, 1, 1, 0.4])
    assert _shade(np.empty((0, 3))).shape == (0, 1)


def test_the_map_of_a_run(finished, tmp_path):
    run = tmp_path / "run"
    shutil.copytree(finished[0], run)
    result = cli("map", run, "--voxel", "0.2")
    assert result.exit_code == 0, result.output
    assert Path(result.output.strip().splitlines()[-1]) == run / "map" / "map.ply"
    rows, _ = read_vertices(run / "map" / "map.ply")
    assert set(np.unique(rows["classid"])) == {0, 50}
    folder = RunFolder.open(run)
    poses, world, static, objects = folder.trajectory().poses, [], 0, defaultdict(int)
    for k, pose in enumerate(poses):
        record, classid = folder.classified_frame(k)
        still = classid < DYNAMIC
        static += int((still & (classid >= STATIC)).sum())
        world.append(record.points[still] @ pose[:3, :3].T + pose[:3, 3])
        for number in np.unique(record.instance[~still]):
            objects[int(number)] += int((record.instance == number).sum())
    world = np.concatenate(world)
    assert rows["points"].sum() == len(world)
    assert static * 0.8 < rows["points"][rows["classid"] == STATIC].sum() < static * 1.2
    cells = np.floor((world - poses[0, :3, 3]) / 0.2)
    assert abs(len(np.unique(cells, axis=0)) - len(rows)) < 0.001 * len(rows)
    ends = np.column_stack([rows["x"], rows["y"], rows["z"]])
    np.testing.assert_allclose(ends.min(axis=0), world.min(axis=0), atol=0.2)
    tracks = {track.id: track for track in read_tracks(run / "tracks.csv")}
    clouds = {int(path.name[:5]): path for path in (run / "map" / "objects").glob("*.ply")}
    assert set(clouds) == set(objects) - {0}
    for number, path in clouds.items():
        cloud, _ = read_vertices(path)
        assert path.stem.endswith(tracks[number].kind)
        high = np.argmax(cloud["z"])
        colour, bright = np.array(track_color(number)), np.array(track_color(number)) > 60
        shade = np.array([cloud[c][high] for c in ("blue", "green", "red")])[bright]
        assert np.ptp(shade / colour[bright]) < 0.02, "the colour of its track"
        assert cloud["points"].sum() >= objects[number]
        # In the frame of its box, most of it lies in the box.
        outside = np.abs(np.column_stack([cloud["x"], cloud["y"]])) - tracks[number].size[:2] / 2
        assert np.median(outside.max(axis=1)) < 0.2


def test_a_new_map_replaces_the_old_and_a_foreign_file_stays(finished, tmp_path):
    run = tmp_path / "run"
    shutil.copytree(finished[0], run)
    assert cli("map", run).exit_code == 0
    first = {p: p.read_bytes() for p in (run / "map").rglob("*.ply")}
    (run / "map" / "objects" / "mine.ply").write_bytes(b"mine")
    folder = RunFolder.open(run)
    folder.write(run / "map" / "objects" / "old.ply", lambda stream: stream.write(b"old"), {})
    assert cli("map", run).exit_code == 0
    assert {p: p.read_bytes() for p in first} == first
    assert (run / "map" / "objects" / "mine.ply").read_bytes() == b"mine"
    assert not (run / "map" / "objects" / "old.ply").exists()
    assert cli("map", run, "--voxel", "0").exit_code == 2
