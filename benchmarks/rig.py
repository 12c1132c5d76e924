"""A rig of three cameras with made-up errors: what is left once a run has corrected it.

    python benchmarks/rig.py FOLDER --seed 1

The drive, a city by HDL-64, has exact sweeps, poses and images; each camera is given with an error
of its own in turn, place and time.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import yaml
from camera_fit import Floats, made_up
from results import parser_of, publish, script

import docdepth
from docdepth.evaluation import Table
from docdepth.evaluation.camera_error import edges_of_run
from docdepth.geometry.se3 import inverse, rotation_exp, rotation_log
from docdepth.io.poses import write_kitti
from docdepth.synthetic import Drive, scene, sensor
from docdepth.synthetic.photo import photograph

CAMERAS = {"front": 0, "left": 55, "right": -55}  # degrees to the left
SWEEPS, EVERY = 90, 2  # an image between every second and its next sweep
BEGIN = 1_500_000_000_000_000_000  # nanoseconds; names of files are times


def places(drive: Drive) -> dict[str, Floats]:
    """``T_camera_lidar`` of each camera."""
    found = {}
    for name, degrees in CAMERAS.items():
        T = np.eye(4)
        T[:3, :3] = rotation_exp((0, 0, -np.radians(degrees)))
        found[name] = drive.rig.T_camera_lidar @ T
    return found


def transform(change: Floats) -> Floats:
    """What a change (7,) of a camera does to points in its frame."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation_exp(change[:3]), change[3:6]
    return T


def write_rig(folder: Path, drive: Drive, changes: dict[str, Floats]) -> None:
    """Write a recording whose cameras have to be changed by these (7,) to be right."""
    camera, settings = drive.rig.camera, {}
    for k, time in enumerate(drive.times):
        sweep = folder / "sweeps" / f"{BEGIN + time}.npy"
        sweep.parent.mkdir(parents=True, exist_ok=True)
        np.save(sweep, drive.sweep(k).points.astype(np.float32))
    write_kitti(folder / "poses.txt", drive.poses)
    for name, T_camera_lidar in places(drive).items():
        (folder / name).mkdir(exist_ok=True)
        for time in drive.camera_times[::EVERY]:
            pose = drive.T_scene_world @ drive.pose_at(time)[0] @ inverse(T_camera_lidar)
            view = photograph(drive.world_at(time * 1e-9), camera, pose, time * 1e-9)
            given = BEGIN + time - round(1e9 * changes[name][6])
            cv2.imwrite(str(folder / name / f"{given}.png"), view.colour[..., ::-1])
        settings[name] = {
            "images": name,
            "K": camera.K.ravel().tolist(),
            "T_camera_lidar": (inverse(transform(changes[name])) @ T_camera_lidar).ravel().tolist(),
        }
    about = {"sweeps": "sweeps", "poses": "poses.txt", "motion_compensated": True}
    text = yaml.safe_dump(about | {"cameras": settings})
    (folder / "docdepth.yaml").write_text(text)


def row(run: docdepth.Run, name: str, drive: Drive, change: Floats) -> tuple[str, ...]:
    """What was wrong and what is left of it: pixels, degrees, centimetres, milliseconds."""
    images = run.cameras[name]
    T = places(drive)[name] @ inverse(images.T_camera_lidar)
    late = (BEGIN + int(drive.camera_times[0]) - int(images.times[0])) * 1e-9
    left = np.concatenate([rotation_log(T[:3, :3]), T[:3, 3], [late]])
    seen, cells = edges_of_run(run.path, name).seen, []
    for one in (change, left):
        parts = np.degrees(np.linalg.norm(one[:3])), 100 * np.linalg.norm(one[3:6]), 1e3 * one[6]
        cells += [f"{seen.moved(one):.2f}", *(f"{abs(part):.2f}" for part in parts)]
    return name, *cells


HEADER = ("camera", "wrong px", "degrees", "cm", "ms", "left px", "degrees", "cm", "ms")


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    drive = Drive(scene("city", args.seed), sensor("HDL-64"), SWEEPS, args.seed)
    rng = np.random.default_rng(args.seed)
    changes = {name: made_up(rng) for name in CAMERAS}
    recording = args.folder / "recording"
    write_rig(recording, drive, changes)
    names = tuple(CAMERAS)
    run = docdepth.run(recording, args.folder / "run", camera=names, poses="dataset")
    rows = [row(run, name, drive, change) for name, change in changes.items()]
    title = f"A rig of three cameras with made-up errors, seed {args.seed}"
    publish([Table(title, HEADER, tuple(rows))], args.results)


if __name__ == "__main__":
    script(main)
