"""Mistakes in options, parameters and settings files, and of the system they run on."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from mistakes_of_inputs import NEW, REFUSED, link, write

VIRTUAL = ["render", "r", "--pose", "0,0,1", "--K", "700,700,640,360"]


def _set(value: str) -> list[str]:
    return [*NEW, "--set", value]


def _config(content: bytes) -> tuple:
    return [*NEW, "--config", "c.yaml"], write("c.yaml", content), REFUSED


def shell(command: str):
    """Run a shell line in the place; $DOCDEPTH is the program."""

    def spoil(at: Path) -> subprocess.CompletedProcess:
        surroundings = {**os.environ, "DOCDEPTH": f"{sys.executable} -m docdepth"}
        return subprocess.run(
            ["bash", "-c", command], cwd=at, capture_output=True, env=surroundings, timeout=60
        )

    return spoil


SETTINGS = [
    ("no output named", ["run", "d"], None, REFUSED),
    ("an unknown verb", ["rnu", "d"], None, REFUSED),
    ("an unknown option", [*NEW, "--presett", "paper"], None, REFUSED),
    ("an unknown preset", [*NEW, "--preset", "best"], None, REFUSED),
    ("an unknown dataset", [*NEW, "--dataset", "kiti"], None, REFUSED),
    ("the wrong dataset", [*NEW, "--dataset", "kitti_raw"], None, REFUSED),
    ("an unknown camera", [*NEW, "--camera", "image_9"], None, REFUSED),
    ("an unknown format", [*NEW, "--format", "jpg"], None, REFUSED),
    ("an unknown layer", [*NEW, "--layers", "tiem"], None, REFUSED),
    ("an unknown renderer", [*NEW, "--renderer", "opengl"], None, REFUSED),
    ("a renderer's device that is not there", [*NEW, "--renderer", "egl:99"], None, REFUSED),
    ("an unknown parameter", _set("dynamics.tau=1"), None, REFUSED),
    ("a setting without a value", _set("dynamics.tolerance"), None, REFUSED),
    ("a setting of half a list", _set("odometry.voxel_size=[1"), None, REFUSED),
    ("a setting that is NaN", _set("dynamics.tolerance=.nan"), None, REFUSED),
    ("a pixel of 0.0001 degrees", _set("dynamics.resolution_deg=0.0001"), None, REFUSED),
    ("a step of a nanometre", _set("render.step=1e-9"), None, REFUSED),
    ("a range of a millimetre", _set("odometry.max_range=0.001"), None, REFUSED),
    ("a scale of 1e-7", [*NEW, "--scale", "1e-7"], None, REFUSED),
    ("a depth that PNG cannot hold", _set("render.max_depth=700"), None, REFUSED),
    ("an even window", _set("dynamics.window=4"), None, REFUSED),
    ("no threads: -1", [*NEW, "--threads", "-1"], None, REFUSED),
    ("an image size of one number", [*NEW, "--image-size", "100"], None, REFUSED),
    ("an image size that images do not have", [*NEW, "--image-size", "9x9"], None, REFUSED),
    ("an image size of 50000x50000", [*NEW, "--image-size", "50000x50000"], None, REFUSED),
    ("frames that are not there", [*NEW, "--frames", "90:99"], None, REFUSED),
    ("frames backwards", [*NEW, "--frames", "3:1"], None, REFUSED),
    ("frames in words", [*NEW, "--frames", "a:b"], None, REFUSED),
    ("a settings file that is not there", [*NEW, "--config", "nowhere"], None, REFUSED),
    ("a settings file: a folder", [*NEW, "--config", "d"], None, REFUSED),
    ("a settings file: a sweep", [*NEW, "--config", "d/velodyne/000000.bin"], None, REFUSED),
    ("a settings file: a list", *_config(b"- a\n")),
    ("a settings file: broken", *_config(b"a: [1\n")),
    ("a settings file: a typing error", *_config(b"odometry: {max_rage: 80}\n")),
    ("a settings file: half a run.yaml", *_config(b"source: {dataset: 3}\nparameters: {}\n")),
    ("a virtual camera without --K", ["render", "r", "--pose", "0,0,1"], None, REFUSED),
    ("a virtual camera of 100000x100000", [*VIRTUAL, "--size", "100000x100000"], None, REFUSED),
    ("a virtual camera of 0x0", [*VIRTUAL, "--size", "0x0"], None, REFUSED),
    ("a virtual camera with the name ../x", [*VIRTUAL, "--size", "9x7", "--name", "../x"], None,
     REFUSED),
    ("a virtual camera that is not rigid",
     ["render", "r", "--pose", "0,0,0,0,0,0,0", "--K", "9,9,4,3", "--size", "9x7"], None, REFUSED),
    ("a video of 1e9 images a second", ["video", "r", "--fps", "1e9"], None, REFUSED),
    ("a video of a camera that is not there", ["video", "r", "--camera", "x"], None, REFUSED),
    ("a view of sweep 99", ["view", "r", "--frame", "99", "--image", "v.png"], None, REFUSED),
    ("a view written as v.abc", ["view", "r", "--image", "v.abc"], None, REFUSED),
    ("trials: a folder", ["tune", "r", "--labels", "d", "-o", "t", "--trials", "d"], None, REFUSED),
    ("trials of what labels do not show",
     ["tune", "r", "--labels", "d", "-o", "t", "--vary", "render.behind=5,15"], None, REFUSED),
    ("trials of output",
     ["tune", "r", "--labels", "d", "-o", "t", "--vary", "output.scale=64,256"], None, REFUSED),
    ("a drive written over another", ["synth", "d"], None, REFUSED),
    ("output: a file", ["run", "d", "-o", "d/calib.txt"], None, REFUSED),
    ("output below a file", ["run", "d", "-o", "d/calib.txt/run"], None, REFUSED),
    ("output: the recording itself", ["run", "d", "-o", "d"], None, REFUSED),
    ("output: a dangling link", ["run", "d", "-o", "l"], link("l", "nowhere"), REFUSED),
    ("output: a link to itself", ["run", "d", "-o", "l"], link("l", "l"), REFUSED),
    ("output that nobody may write", ["run", "d", "-o", "/proc/run"], None, REFUSED),
    ("a name of 300 letters", ["run", "d", "-o", "x" * 300], None, REFUSED),
    ("a recording whose name is no text", [], shell("$DOCDEPTH run $'b\\xff' -o n"), REFUSED),
    ("a run whose name is no text", [], shell("$DOCDEPTH video $'b\\xff'"), REFUSED),
    ("files of 64 KB at most", [], shell("ulimit -f 64; trap '' XFSZ; $DOCDEPTH run d -o n"),
     REFUSED),
    ("too few open files", [], shell("ulimit -n 12; $DOCDEPTH run d -o n"),
     "refused or repaired"),
]  # fmt: skip
