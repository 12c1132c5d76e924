"""Classify your own point clouds: deskewed sweeps and poses in, one class per point out.

    python examples/arrays_to_labels.py FOLDER -o labels

FOLDER holds ``sweeps/*.npy`` (float32 (N, 3), LiDAR frame, metres, deskewed), ``poses.npy``
(float64 (n, 4, 4), ``T_world_lidar``) and ``times.npy`` (int64 (n,), nanoseconds). Writes a
``.npy`` file for each sweep: uint16 (N,), 0 = ground, 50 = static, 100 = dynamic.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import docdepth


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("-o", "--output", type=Path, default=Path("labels"))
    args = parser.parse_args(arguments)

    files = sorted((args.folder / "sweeps").glob("*.npy"))
    sweeps = [np.load(file) for file in files]
    times, poses = np.load(args.folder / "times.npy"), np.load(args.folder / "poses.npy")

    labels = docdepth.classify_drive(sweeps, docdepth.Trajectory(times, poses))

    args.output.mkdir(parents=True, exist_ok=True)
    for file, found in zip(files, labels, strict=True):
        np.save(args.output / file.name, found.classid)
        print(f"{file.stem}: {(found.classid >= 100).sum()} dynamic points")


if __name__ == "__main__":
    main()
