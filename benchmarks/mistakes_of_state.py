"""Mistakes with run folders: files that are gone, damaged, changed, or used by two at once."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

from mistakes_of_inputs import REFUSED, cut, folder, remove, text, write

AGAIN = ["run", "d", "-o", "r"]
EITHER = "refused or repaired"
FRAME = "r/frames/frame_000002.ply"
MAP = "r/depth/000001.png"


def _two_at_once(at: Path) -> subprocess.CompletedProcess:
    """Two runs into one folder; the second is refused, or both end well."""
    command = [sys.executable, "-m", "docdepth", "run", "d", "-o", "n"]
    first, second = (
        subprocess.Popen(command, cwd=at, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
        for _ in range(2)
    )
    messages = [process.communicate(timeout=60)[1] for process in (first, second)]
    codes = [process.returncode for process in (first, second)]
    worst = max(codes, key=lambda code: (code not in (0, 2), code))
    return subprocess.CompletedProcess(command, worst, b"", b"".join(messages))


def _other_recording(at: Path) -> None:
    """A recording with the same names and sizes, of another drive."""
    shutil.copytree(at / "d", at / "d2")
    for file in (at / "d2" / "velodyne").iterdir():
        file.write_bytes(file.read_bytes()[::-1])


def _killed(at: Path) -> None:
    """Kill a run in the middle; the case goes on with it in ``r``."""
    remove("r")(at)
    command = [sys.executable, "-m", "docdepth", "run", "d", "-o", "r"]
    process = subprocess.Popen(command, cwd=at, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    assert process.stderr is not None
    for line in process.stderr:
        if line.startswith(b"classify"):
            process.kill()
            break
    process.wait()


STATES = [
    ("the same command twice", AGAIN, None, EITHER),
    ("a killed run continued", AGAIN, _killed, EITHER),
    ("run.yaml empty", AGAIN, write("r/run.yaml", b""), EITHER),
    ("run.yaml broken", AGAIN, write("r/run.yaml", b"a: [1"), EITHER),
    ("run.yaml a list", AGAIN, write("r/run.yaml", b"- 1\n"), EITHER),
    ("run.yaml binary", AGAIN, write("r/run.yaml", bytes(range(256))), EITHER),
    ("run.yaml without stages", AGAIN, write("r/run.yaml", b"source: {}\nparameters: {}\n"),
     EITHER),
    ("run.yaml cut off", AGAIN, cut("r/run.yaml", 0.5), EITHER),
    ("run.yaml without stages, classify", ["classify", "r"],
     write("r/run.yaml", b"source: {}\nparameters: {}\n"), EITHER),
    ("run.yaml with a list of stages, video", ["video", "r"],
     write("r/run.yaml", b"source: {}\nparameters: {}\nstages: []\n"), EITHER),
    ("run.yaml without parameters, evaluate", ["evaluate", "held-out", "r"],
     write("r/run.yaml", b"source: {}\nstages: {}\n"), EITHER),
    ("run.yaml is gone", AGAIN, remove("r/run.yaml"), EITHER),
    ("the recording was moved", ["run", "d2", "-o", "r"],
     lambda at: (at / "d").rename(at / "d2"), EITHER),
    ("another recording in the same run", ["run", "d2", "-o", "r"], _other_recording, REFUSED),
    ("other parameters in the same run", [*AGAIN, "--set", "dynamics.tolerance=0.3"], None,
     REFUSED),
    ("a frame is missing", AGAIN, remove(FRAME), EITHER),
    ("a frame is cut off", AGAIN, cut(FRAME, 0.5), EITHER),
    ("a frame is empty", AGAIN, write(FRAME, b""), EITHER),
    ("a frame is cut off, render", ["render", "r"], cut(FRAME, 0.5), EITHER),
    ("a frame is missing, evaluate", ["evaluate", "held-out", "r"], remove(FRAME), REFUSED),
    ("all frames are missing", AGAIN, remove("r/frames"), EITHER),
    ("the trajectory is missing", AGAIN, remove("r/traj_odometry.ply"), EITHER),
    ("the trajectory is cut off", AGAIN, cut("r/traj_odometry.ply", 0.7), EITHER),
    ("labels are missing", AGAIN, remove("r/labels"), EITHER),
    ("a label file is cut off", AGAIN, cut("r/labels/000001.label", 0.5), EITHER),
    ("a depth map is missing", AGAIN, remove(MAP), EITHER),
    ("a depth map is cut off", AGAIN, cut(MAP, 0.5), EITHER),
    ("a depth map is empty, evaluate", ["evaluate", "depth", "r", "--depth", "d"], write(MAP, b""),
     REFUSED),
    ("a depth map is missing, video", ["video", "r"], remove(MAP), REFUSED),
    ("depth.json is broken, video", ["video", "r"], write("r/depth/depth.json", b"{"), REFUSED),
    ("depth.json is missing", AGAIN, remove("r/depth/depth.json"), EITHER),
    ("calib.json is broken", AGAIN, write("r/calib.json", b"{"), EITHER),
    ("the calibration is missing, evaluate", ["evaluate", "held-out", "r"], remove("r/calib.json"),
     REFUSED),
    ("a map is a folder", AGAIN, folder(MAP), EITHER),
    ("the recording is gone", AGAIN, remove("d"), REFUSED),
    ("a sweep has changed since", AGAIN, cut("d/velodyne/000001.bin", 0.4999), REFUSED),
    ("the calibration has changed since", AGAIN,
     text("d/calib.txt", lambda t: t.replace("Tr: ", "Tr: 5")), REFUSED),
    ("a video of a run without maps", ["video", "r"], remove("r/depth"), REFUSED),
    ("no run at all, render", ["render", "d"], None, REFUSED),
    ("no run at all, evaluate", ["evaluate", "held-out", "nowhere"], None, REFUSED),
    ("a stage that has no such parameter", ["odometry", "r", "--set", "render.step=1"], None,
     REFUSED),
    ("two runs at once", [], _two_at_once, "refused or repaired"),
]  # fmt: skip
