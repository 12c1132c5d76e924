"""A run on a small disk that fills up: ``unshare -rm python full_disk.py DRIVE FOLDER``.

Runs of the drive go into a file system in memory. At each of some moments the disk becomes full. It
prints for each what was said, and whether files were left that are not whole.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

from docdepth.cli.failures import explain
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline.plan import states
from docdepth.pipeline.run import run

MOMENTS = (("register", 3), ("odometry", 2), ("classify", 2), ("render", 1))
SIZE = 48 << 20  # bytes


def fill(disk: Path, left: int) -> None:
    """Leave so many bytes of the disk."""
    free = shutil.disk_usage(disk).free - left
    with (disk / "ballast").open("wb", buffering=0) as stream:
        while free > 0:
            free -= stream.write(bytes(min(free, 1 << 16)))


def main(drive: Path, disk: Path) -> None:
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={SIZE}", "none", disk], check=True)
    told = []
    for moment in MOMENTS:

        def progress(stage: str, done: int, total: int, moment: tuple[str, int] = moment) -> None:
            if (stage, done) == moment:
                fill(disk, 10_000)

        try:
            run(drive, disk / "run", camera="image_2", threads=2, progress=progress)
            said = ""
        except Exception as error:
            failure = explain(error) or repr(error)
            said = f"{type(error).__name__}: {failure}"
        parts = [path.name for path in (disk / "run").rglob("*.part")]
        known = {s.name: s.frames for s in states(RunFolder.open(disk / "run"))}
        told.append({"moment": moment, "said": said, "parts": parts, "done": known})
        (disk / "ballast").unlink(missing_ok=True)
    run(drive, disk / "run", camera="image_2", threads=2)
    shutil.copytree(disk / "run", Path(sys.argv[3]))
    sys.stdout.write(json.dumps(told) + "\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
