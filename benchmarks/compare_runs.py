"""Are the results of two runs, or of two versions of docdepth, the same bit for bit?

    python benchmarks/compare_runs.py RUN OTHER
    python benchmarks/compare_runs.py --freeze FILE --kitti DIR --work DIR    # before a change
    python benchmarks/compare_runs.py --against FILE --kitti DIR --work DIR   # after it

The first form compares two run folders. The others make twenty runs of real and synthetic drives
(``DIR`` holds ``2011_09_26``) with both presets, given and own poses, and write or compare a hash
of every label file, depth map, layer, track and trajectory. Synthetic drives are made in
``--work`` once and kept. ``--only`` names some of the runs. Exit status 1 if anything differs.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

SYNTHETIC = {"HDL-64": "city", "XT-32": "crossing", "Avia": "residential"}
"""The scene that each sensor sees in the twenty runs."""

LAYERS = "confidence,normal,class,seen,instance"


def runs(kitti: Path, work: Path) -> dict[str, list[str]]:
    """Arguments of ``docdepth run`` for each of the twenty runs, by name."""

    def real(number: str) -> str:
        return str(kitti / "2011_09_26" / f"2011_09_26_drive_{number}_sync")

    given = ["--poses", f"{real('0005')}/lidar_poses_tum.txt"]
    given_9001 = ["--poses", f"{real('9001')}/lidar_poses_tum.txt"]
    oxts = ["--poses", "dataset"]
    paper, layers = ["--preset", "paper"], ["--layers", LAYERS]
    found = {
        "0005": [real("0005"), "--frames", "0:40"],
        "0005 given": [real("0005"), "--frames", "0:40", *given],
        "0005 paper": [real("0005"), "--frames", "0:40", *paper],
        "0005 paper given": [real("0005"), "--frames", "0:40", *paper, *given],
        "9001": [real("9001"), "--frames", "10:40", *layers],
        "9001 given": [real("9001"), "--frames", "10:30", *given_9001],
        "9001 paper": [real("9001"), "--frames", "10:30", *paper],
        "9001 paper given": [real("9001"), "--frames", "10:30", *paper, *given_9001],
        "0013": [real("0013"), "--frames", "60:90"],
        "0013 given": [real("0013"), "--frames", "60:80", *oxts],
        "0013 paper": [real("0013"), "--frames", "60:80", *paper],
        "0013 paper given": [real("0013"), "--frames", "60:80", *paper, *oxts],
    }
    for sensor in SYNTHETIC:
        drive = work / "drives" / sensor / "sequences" / "00"
        exact = ["--poses", "dataset"]
        found[sensor] = [str(drive), *(layers if sensor == "Avia" else [])]
        found[f"{sensor} given"] = [str(drive), *exact]
        if sensor != "Avia":
            found[f"{sensor} paper given"] = [str(drive), *paper, *exact]
    return found


def docdepth(*arguments: str) -> None:
    """Run a command of docdepth."""
    call([sys.executable, "-m", "docdepth", *arguments])


def call(command: list[str]) -> None:
    """Run a command; its output is shown if it fails."""
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{' '.join(command)}\n{done.stdout}{done.stderr}")


def hashes(run: Path, frames: bool = False) -> dict[str, str]:
    """A hash of each file that holds results, and of the frames if wanted."""
    files = [run / "traj_odometry.ply", run / "tracks.csv"]
    for kind in ("labels", "depth", "layers", *(["frames", "classes"] if frames else [])):
        files += sorted((run / kind).rglob("*"))
    return {
        path.relative_to(run).as_posix(): hashlib.blake2b(path.read_bytes()).hexdigest()[:16]
        for path in files
        if path.is_file() and path.name != "depth.json"  # it holds the version
    }


def differences(run: Path, other: Path) -> list[str]:
    """Files of two runs of one version that are not the same, or are missing on one side."""
    return differing(hashes(run, frames=True), hashes(other, frames=True))


def differing(a: dict[str, str], b: dict[str, str]) -> list[str]:
    """Names whose hashes are not the same, or that are missing on one side."""
    return sorted(name for name in {*a, *b} if a.get(name) != b.get(name))


def make_runs(kitti: Path, work: Path, only: list[str]) -> dict[str, dict[str, str]]:
    """Make the runs and hash their results."""
    for sensor, scene in SYNTHETIC.items():
        drive = work / "drives" / sensor
        if not drive.is_dir():
            street = ["--scene", scene, "--sensor", sensor, "--seed", "77"]
            made = [str(drive), "--frames", "30", "--skew", *street]
            call([sys.executable, str(Path(__file__).with_name("synth.py")), *made])
    found = {}
    for name, arguments in runs(kitti, work).items():
        if only and name not in only:
            continue
        place = work / "runs" / name.replace(" ", "_")
        shutil.rmtree(place, ignore_errors=True)
        docdepth("run", *arguments, "-o", str(place))
        found[name] = hashes(place)
        shutil.rmtree(place)
        print(f"{name}: {len(found[name])} files", flush=True)
    return found


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("runs", type=Path, nargs="*", metavar="RUN")
    parser.add_argument("--freeze", type=Path, metavar="FILE")
    parser.add_argument("--against", type=Path, metavar="FILE")
    parser.add_argument("--kitti", type=Path, default=os.environ.get("DOCDEPTH_KITTI_RAW"))
    parser.add_argument("--work", type=Path, metavar="DIR")
    parser.add_argument("--only", nargs="+", default=[], metavar="NAME")
    args = parser.parse_args(arguments)
    if len(args.runs) == 2:
        pairs = {"": tuple(hashes(run, frames=True) for run in args.runs)}
    elif args.kitti and args.work and (args.freeze or args.against):
        now = make_runs(Path(args.kitti).absolute(), args.work.absolute(), args.only)
        if args.freeze:
            args.freeze.write_text(json.dumps(now, indent=1) + "\n")
            return 0
        frozen = json.loads(args.against.read_text())
        pairs = {f"{name}/": (frozen[name], now[name]) for name in now}
    else:
        parser.error("give two runs, or --freeze or --against with --kitti and --work")
    differ = [f"{run}{file}" for run, (a, b) in pairs.items() for file in differing(a, b)]
    files = sum(len(a) for a, _ in pairs.values())
    print(f"{files} files, {len(differ)} differ", *differ, sep="\n")
    return bool(differ)


if __name__ == "__main__":
    sys.exit(main())
