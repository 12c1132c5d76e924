"""Loop closure on a street driven twice, and on streets that only look alike.

    python benchmarks/loops.py OUT [--share 0.02] [--frames 2400] [--columns 360]

``drift`` estimates the poses of a drive that comes round after 1.2 km, and closes the loop.
``alike`` does the same on a ring that comes round after 1,234 m and whose houses come again after
1,200: the place is another one, and the one that looks the same is 34 m away. ``bent`` bends the
poses of the first drive, so that its second visit lies so many metres beside the first: within the
search radius it has to be found, beyond it may as well be a street that is built the same.
``visits`` labels a part of both visits and draws depth maps of the second, as docdepth does, and
with sweeps of the first visit too.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import yaml
from endless import depth, iou
from numpy.typing import NDArray

from docdepth.config import DynamicsParameters, OdometryParameters, Parameters, RenderParameters
from docdepth.datasets.frame_range import FrameRange
from docdepth.dynamics import sweep_classifier
from docdepth.dynamics.key_frames import key_frames
from docdepth.geometry.se3 import inverse
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.run_folder import RunFolder
from docdepth.odometry.loop_closure import close_loops
from docdepth.odometry.odometry import estimate_poses
from docdepth.odometry.places import KEPT_SWEEPS
from docdepth.odometry.sweeps import FINE_SAMPLING, ThinnedSweeps
from docdepth.pipeline import run_classify, run_odometry, run_render
from docdepth.render import selection
from docdepth.synthetic import EndlessRecording

PARTS = ("drift", "alike", "bent", "visits")
LAP = 1200.0  # metres, of two tiles
VISIT = 200  # sweeps of a visit that are labelled; the last hundred of the second are judged
ALIKE = 2000  # sweeps at most; the second time around begins at 1,370
BESIDE = (10.0, 20.0, 40.0)  # metres
NEAR = 20.0  # metres from a sweep to those of the other visit

Poses = NDArray[np.float64]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--share", type=float, default=0.02, help="odometry.loop_closure")
    parser.add_argument("--frames", type=int, default=2400)
    parser.add_argument("--columns", type=int, default=360)
    parser.add_argument("--sensor", default="VLP-16")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    for part in options.parts:
        _PARTS[part](options)


def recording_of(
    options: argparse.Namespace, name: str, frames: int, turn_deg: float | None = None
) -> EndlessRecording:
    about = {k: getattr(options, k) for k in ("sensor", "columns", "seed")}
    about |= {
        "frames": frames,
        "tiles": 2,
        "turn_deg": turn_deg,
        "image_every": 10,
        "image_scale": 0.5,
    }
    path = options.out / f"{name}.endless.yaml"
    if not path.is_file():
        path.write_text(yaml.safe_dump(about, sort_keys=False))
    elif yaml.safe_load(path.read_text()) != about:
        raise SystemExit(f"{path} describes another drive; choose another folder")
    return EndlessRecording(path)


def own_poses(options: argparse.Namespace, recording: EndlessRecording) -> Poses:
    """Of odometry alone; kept in a file."""
    file = recording.path.with_suffix(".npy")
    if not file.is_file():
        np.save(file, estimate_poses(recording, checkpoint=file.with_suffix(".notes")))
    return np.load(file)


def closed(options: argparse.Namespace, recording: EndlessRecording, poses: Poses) -> Poses:
    sweeps = ThinnedSweeps(recording, OdometryParameters(), FINE_SAMPLING, KEPT_SWEEPS)
    return close_loops(sweeps, poses, options.share)


def _closed_file(recording: EndlessRecording) -> Path:
    """Poses with the loop closed, for ``visits``."""
    return recording.path.with_suffix(".closed.npy")


def figures(recording: EndlessRecording, poses: Poses, lap: float = LAP) -> dict[str, float]:
    """Errors [m]: at the end, of one visit against the other, and of 1 and 80 sweeps [mm]."""
    exact = recording.poses
    error = np.linalg.norm((poses - exact)[:, :3, 3], axis=1)
    arc = np.concatenate([[0], np.linalg.norm(np.diff(exact[:, :3, 3], axis=0), axis=1).cumsum()])
    again = np.flatnonzero(arc > lap)
    first = np.searchsorted(arc, arc[again] - lap)
    gap = inverse(inverse(exact[first]) @ exact[again]) @ inverse(poses[first]) @ poses[again]
    gaps = np.linalg.norm(gap[:, :3, 3], axis=1)
    told = {"end": error[-1], "largest": error.max()}
    told |= {"visits apart": np.median(gaps), "at most": gaps.max()}
    for step in (1, 80):
        way, true = (inverse(p[:-step]) @ p[step:] for p in (poses, exact))
        off = np.linalg.norm((inverse(true) @ way)[:, :3, 3], axis=1)
        told[f"{step} sweeps mm"] = 1e3 * np.sqrt((off**2).mean())
    return {name: round(float(value), 3) for name, value in told.items()}


def report(**told: object) -> None:
    print(json.dumps(told), flush=True)


def compare(options: argparse.Namespace, recording: EndlessRecording, **about: object) -> None:
    poses = own_poses(options, recording)
    report(**about, closure="without", **figures(recording, poses))
    start = time.process_time()
    result = closed(options, recording, poses)
    spent = 1e3 * (time.process_time() - start) / len(poses)
    np.save(_closed_file(recording), result)
    same = bool(np.array_equal(result, poses))
    report(**about, closure="with", same_bits=same, ms=round(spent, 1),
           **figures(recording, result))  # fmt: skip


def drift(options: argparse.Namespace) -> None:
    compare(options, recording_of(options, "loop", options.frames), drive="loop")


def alike(options: argparse.Namespace) -> None:
    compare(
        options, recording_of(options, "alike", min(options.frames, ALIKE), 175.0), drive="alike"
    )


def bent(options: argparse.Namespace) -> None:
    recording = recording_of(options, "loop", options.frames)
    poses = own_poses(options, recording)
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    path = np.concatenate([[0], steps.cumsum()])
    for beside in BESIDE:
        moved = poses.copy()
        moved[:, 0, 3] += beside * path / LAP
        result = closed(options, recording, moved)
        for name, found in (("without", moved), ("with", result)):
            same = bool(np.array_equal(found, moved))
            report(drive=f"bent by {beside:g} m", closure=name, same_bits=same,
                   **figures(recording, found))  # fmt: skip


def visits(options: argparse.Namespace) -> None:
    recording = recording_of(options, "loop", options.frames)
    poses, result = own_poses(options, recording), np.load(_closed_file(recording))
    last, positions = len(poses) - VISIT, recording.poses[:, :3, 3]
    begin = int(np.argmin(np.linalg.norm(positions[: last - VISIT] - positions[last], axis=1)))
    between = range(begin + VISIT, last)
    part = FrameRange(recording, f"{begin}:", without=between)
    for across in (False, True):
        for name, known in (("without", poses), ("with", result)):
            run = RunFolder(options.out / f"{name}_{'both' if across else 'own'}")
            run.start({}, Parameters())
            run_odometry(run, part, known[part.indices])
            with sweeps_of_both_visits() if across else nullcontext():
                run_classify(run)
                run_render(run, list(part.cameras.values()))
            first = len(poses) - 100
            found = {"IoU": iou(recording, run, first, begin + len(between))}
            found |= depth(recording, run, first)
            report(closure=name, sweeps="of both visits" if across else "of its own", **found)


@contextmanager
def sweeps_of_both_visits() -> Iterator[None]:
    """Votes and maps that use the other visit, too, for a trial."""
    static_frames = _static_of_both(selection.static_frames)
    with (
        mock.patch.object(sweep_classifier, "key_frames", _keys_of_both),
        mock.patch.object(selection, "static_frames", static_frames),
    ):
        yield


def _keys_of_both(
    trajectory: Trajectory, parameters: DynamicsParameters
) -> list[NDArray[np.int64]]:
    """Key frames as they are, and those of the nearest sweep of the other visit."""
    own, every = key_frames(trajectory, parameters), []
    for k, keys in enumerate(own):
        other = _other_visit(trajectory, k)
        both = keys if other is None else np.union1d(keys, own[other])
        every.append(both[both != k].astype(np.int64))
    return every


def _static_of_both(static_frames: Callable[..., Any]) -> Callable[..., Any]:
    """Static sweeps as they are, and behind them those of the other visit."""

    def both(trajectory: Trajectory, time_ns: int, parameters: RenderParameters) -> Any:
        own = static_frames(trajectory, time_ns, parameters)
        other = _other_visit(trajectory, trajectory.nearest(time_ns))
        if other is None:
            return own
        more = static_frames(trajectory, int(trajectory.times[other]), parameters)
        return np.concatenate([own, more[~np.isin(more, own)]])

    return both


def _other_visit(trajectory: Trajectory, index: int) -> int | None:
    """The nearest sweep of the other visit, if it is near."""
    half = len(trajectory) // 2
    others = np.arange(half) if index >= half else np.arange(half, len(trajectory))
    positions = trajectory.poses[:, :3, 3]
    away = np.linalg.norm(positions[others] - positions[index], axis=1)
    return int(others[away.argmin()]) if away.min() < NEAR else None


_PARTS = {"drift": drift, "alike": alike, "bent": bent, "visits": visits}


if __name__ == "__main__":
    main()
