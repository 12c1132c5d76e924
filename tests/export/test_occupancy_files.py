"""Occupancy as files, read by numpy and json alone."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

import docdepth
from command_line import cli


def test_files_hold_what_the_run_gives(finished: tuple[Path, str], tmp_path: Path) -> None:
    result = cli("convert", finished[0], tmp_path / "voxels", "--to", "occupancy")
    assert result.exit_code == 0, result.output
    run = docdepth.open_run(finished[0])
    assert f"{len(run.sweeps)} sweeps in" in " ".join(result.output.split())
    tree = json.loads((tmp_path / "voxels" / "occupancy.json").read_text())
    assert list(tree["frames"]) == [f"{k:06d}" for k in range(len(run.sweeps))]
    for k, name in enumerate(["000000", "000001"]):
        found, frame = run.occupancy(k), tree["frames"][name]
        with np.load(tmp_path / "voxels" / name / "labels.npz") as file:
            stored = dict(file)
        assert {n: values.dtype.name for n, values in stored.items()} == {
            "semantics": "uint8", "mask_lidar": "uint8", "mask_camera": "uint8",
            "instance": "uint16", "flow": "float32",
        }  # fmt: skip
        assert all(values.shape[:3] == (200, 200, 16) for values in stored.values())
        assert all(np.array_equal(v, getattr(found, n)) for n, v in stored.items())
        assert frame["time"] == run.trajectory.times[k]
        assert np.array_equal(frame["T_world_grid"], found.T_world_grid)
        observed, free = stored["mask_lidar"] > 0, stored["semantics"] == tree["classes"]["free"]
        assert (~free).any()
        assert observed[~free].all()
        assert (observed & free).any()
        assert 0 < stored["mask_camera"].sum() < observed.sum()
