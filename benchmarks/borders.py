"""Labels beside the borders of chunks of ground, when the borders are moved.

    python benchmarks/borders.py OUT [--frames 600] [--lengths 150 200 300] [--sensor VLP-16]

The endless street of benchmarks/endless.py by exact poses, every second sweep. Ground grows over
the whole drive at once, then in chunks of these lengths. Printed is the share of points whose
ground, and whose class, differs from that of the whole: of all sweeps, and of those within 10 m of
a border. Chunks that are cut for workers are not meant: those change nothing.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
import yaml

import docdepth
from docdepth.geometry.points import usable_points
from docdepth.synthetic import EndlessRecording

NEAR = 10.0  # metres of path


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--frames", type=int, default=600)
    parser.add_argument("--lengths", type=float, nargs="+", default=[150, 200, 300])
    parser.add_argument("--sensor", default="VLP-16")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / "drive.endless.yaml"
    about = {"sensor": options.sensor, "columns": 600, "seed": options.seed, "tiles": 40}
    about |= {"frames": options.frames, "image_every": 10, "image_scale": 0.5}
    path.write_text(yaml.safe_dump(about, sort_keys=False))
    recording = EndlessRecording(path)
    chosen = range(0, len(recording), 2)
    trajectory = docdepth.Trajectory(recording.times[chosen], recording.poses[chosen])
    sweeps = [
        points[usable_points(points)] for points in (recording.sweep(i).points for i in chosen)
    ]
    arc = trajectory.arc_length
    whole = None
    for length in [5000.0, *options.lengths]:
        values = docdepth.parameters("default", {"ground.chunk_length": length})
        ground = docdepth.grow_ground(sweeps, trajectory, values)
        labels = docdepth.classify_drive(sweeps, trajectory, values, ground)
        found = ground, [one.classid for one in labels]
        if whole is None:
            whole = found
            continue
        nearest = np.abs(arc - length * np.maximum(np.round(arc / length), 1))
        beside = nearest <= NEAR
        row: dict[str, float] = {"length": length, "path": round(float(arc[-1]))}
        for name, now, before in zip(("ground", "class"), found, whole, strict=True):
            wrong = np.array([np.mean(a != b) for a, b in zip(now, before, strict=True)])
            row |= {f"{name} differs": wrong.mean(), f"{name} at borders": wrong[beside].mean()}
        print(json.dumps(row), flush=True)


if __name__ == "__main__":
    main()
