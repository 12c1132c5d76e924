"""What other classifiers are given: a stand-in for BeautyMap tells what it has read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

# It keeps points of the map that lie where a sweep has one, and asks that VIEWPOINT is its sensor.
STAND_IN = """
import os, sys
import numpy as np
from utils.pcdpy3 import save_pcd

def read(path):
    content = open(path, "rb").read()
    head, _, data = content.partition(b"DATA binary\\n")
    (seen_from,) = [line.split()[1:4] for line in head.splitlines() if line[:9] == b"VIEWPOINT"]
    return np.frombuffer(data, "f4").reshape(-1, 4), np.array(seen_from, float)

folder = sys.argv[sys.argv.index("--data_dir") + 1]
world, _ = read(folder + "/raw_map.pcd")
kept = np.zeros(len(world), bool)
for name in sorted(os.listdir(folder + "/pcd")):
    points, seen_from = read(folder + "/pcd/" + name)
    apart = np.linalg.norm(world[:, None, :3] - points[None, :, :3], axis=2)
    far = np.linalg.norm(points[:, :3] - seen_from, axis=1) > 6
    kept |= (apart[:, ~far] < 1e-3).any(axis=1)
save_pcd(folder + "/beautymap_output.pcd", world[kept])
"""


def test_beautymap_gets_sweeps_in_the_frame_of_the_map_and_where_they_were_seen_from(
    tmp_path: Path,
) -> None:
    from peer_classifiers import Drive, beautymap

    (tmp_path / "utils").mkdir()
    (tmp_path / "utils" / "pcdpy3.py").write_text("save_pcd = None\n")
    (tmp_path / "main.py").write_text(STAND_IN)
    random = np.random.default_rng(5)
    poses = np.stack([np.eye(4)] * 3)
    poses[1, :3, 3], poses[2, :3, 3] = (30, 4, -2), (60, -3, 1)
    poses[2, :2, :2] = [[0, -1], [1, 0]]
    # Points nearer than 5 m from their sensor, and one of each sweep that is 7 m away.
    sweeps = [random.uniform(-2.5, 2.5, (40, 3)).astype(np.float32) for _ in poses]
    for sweep in sweeps:
        sweep[9] = (7, 0, 0)
    drive = Drive(poses, "exact", sweeps.__getitem__, lambda index: np.zeros(40, np.uint32))
    found, seconds = beautymap(drive, tmp_path)
    assert seconds > 0
    assert [np.flatnonzero(flags).tolist() for flags in found] == [[9]] * 3


def test_a_failing_beautymap_tells_why(tmp_path: Path) -> None:
    from peer_classifiers import Drive, beautymap

    (tmp_path / "utils").mkdir()
    (tmp_path / "utils" / "pcdpy3.py").write_text("")
    (tmp_path / "main.py").write_text("raise ValueError('no points')\n")
    sweep = np.ones((3, 3), np.float32)
    drive = Drive(np.eye(4)[None], "exact", lambda index: sweep, lambda index: np.zeros(3))
    with pytest.raises(SystemExit, match="no points"):
        beautymap(drive, tmp_path)
