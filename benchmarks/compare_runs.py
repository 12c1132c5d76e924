"""Are two runs the same, bit for bit?

    python benchmarks/compare_runs.py RUN OTHER

Compares poses, deskewed points, votes, classes, labels, depth maps and layers of two run folders,
also of different versions of docdepth. Exit status 1 if anything differs.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docdepth.io.frames import FrameRecord, read_frame, read_trajectory

_COLUMNS = [n for n in FrameRecord.__dataclass_fields__ if n not in ("name", "key")]


def arrays_of(path: Path) -> dict[str, NDArray]:
    """The content of a file of a run by name."""
    if path.parent.name == "frames":
        frame = read_frame(path)
        return {name: np.asarray(getattr(frame, name)) for name in _COLUMNS}
    if path.suffix == ".ply":
        trajectory, _ = read_trajectory(path)
        return {"times": trajectory.times, "poses": trajectory.poses}
    if path.suffix == ".npz":
        with np.load(path) as stored:
            return dict(stored)
    return {"bytes": np.frombuffer(path.read_bytes(), np.uint8)}


def files_of(run: Path) -> Iterator[Path]:
    """Files that hold results, relative to the run."""
    yield Path("traj_odometry.ply")
    for kind, pattern in (("frames", "*.ply"), ("labels", "*"), ("depth", "*"), ("layers", "*")):
        for path in sorted((run / kind).rglob(pattern)):
            if path.is_file() and path.name != "depth.json":  # it holds the version
                yield path.relative_to(run)


def differences(run: Path, other: Path) -> Iterator[str]:
    """A line for each file that is not the same."""
    for file in sorted({*files_of(run), *files_of(other)}):
        missing = [str(r / file) for r in (run, other) if not (r / file).is_file()]
        if missing:
            yield f"{missing[0]} is missing"
            continue
        a, b = arrays_of(run / file), arrays_of(other / file)
        names = [
            name
            for name in {**a, **b}
            if name not in a
            or name not in b
            or (a[name].dtype, a[name].shape) != (b[name].dtype, b[name].shape)
            or a[name].tobytes() != b[name].tobytes()
        ]
        if names:
            yield f"{file}: {', '.join(names)}"


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("run", type=Path)
    parser.add_argument("other", type=Path)
    args = parser.parse_args(arguments)
    found = list(differences(args.run, args.other))
    print(f"{sum(1 for _ in files_of(args.run))} files, {len(found)} differ", *found, sep="\n")
    return bool(found)


if __name__ == "__main__":
    sys.exit(main())
