"""Mistakes that a new user invented after the code was finished, without a look at the others.

Twelve of them were answered wrongly at first, seven with a sentence that did not help.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
from mistakes_of_inputs import NEW, REFUSED, WARNED, Spoil, lines, points, remove, text, write
from mistakes_of_settings import VIRTUAL, shell
from mistakes_of_state import AGAIN, EITHER

MARK = "\ufeff"  # byte order mark, which Windows writes at the begin of a text


def _apple_double(at: Path) -> None:
    """The files that a Mac puts beside those that it copies."""
    for folder in ("velodyne", "image_2"):
        for file in sorted((at / "d" / folder).glob("0*.*")):
            file.with_name(f"._{file.name}").write_bytes(b"\0\5\26\7")


def _a_copy(at: Path) -> None:
    shutil.copy(at / "d/velodyne/000001.bin", at / "d/velodyne/000001 (1).bin")


def _same_sweep(at: Path) -> None:
    for file in sorted((at / "d/velodyne").glob("*.bin"))[1:]:
        shutil.copy(at / "d/velodyne/000000.bin", file)


def _camera_axes(rows: np.ndarray) -> np.ndarray:
    return np.column_stack([-rows[:, 1], -rows[:, 2], rows[:, 0], rows[:, 3]])


def _in_millimetres(at: Path) -> None:
    """True depth as PNG of millimetres, which RGB-D cameras write."""
    (at / "mm").mkdir()
    for file in sorted((at / "d/depth_2").glob("*.npy")):
        depth = np.nan_to_num(np.load(file), posinf=0.0)
        millimetres = np.clip(depth * 1000, 0, 65535).astype(np.uint16)
        cv2.imwrite(str(at / "mm" / f"{file.stem}.png"), millimetres)


def _poses(change) -> Spoil:
    """A file p.txt of poses ``T_world_lidar``, spoilt."""

    def spoil(at: Path) -> None:
        steps = np.tile(np.eye(4), (4, 1, 1))
        steps[:, 0, 3] = np.arange(4.0)
        rows = [" ".join(f"{v:.9g}" for v in T[:3].ravel()) for T in change(steps)]
        (at / "p.txt").write_text("\n".join(rows) + "\n")

    return spoil


def _mirrored(poses: np.ndarray) -> np.ndarray:
    return poses * np.array([1, -1, 1, 1])


def _twice_as_large(poses: np.ndarray) -> np.ndarray:
    return poses * np.array([[2.0]] * 3 + [[1.0]])


def _run_above(at: Path) -> None:
    """A run of the folder above the recording; the case gives the same command again."""
    (at / "above").mkdir()
    (at / "d").rename(at / "above" / "d")
    shutil.rmtree(at / "r")
    command = [sys.executable, "-m", "docdepth", "run", "above", "-o", "r", "-q"]
    subprocess.run(command, cwd=at, check=True, env=os.environ)


STRANGERS = [
    ("times with a byte order mark and CR LF", NEW,
     lines("d/times.txt", lambda x: [f"{MARK if not k else ''}{t}\r" for k, t in enumerate(x)]),
     EITHER),
    ("the files of a Mac beside the sweeps", NEW, _apple_double, EITHER),
    ("a copy of a sweep: 000001 (1).bin", NEW, _a_copy, REFUSED),
    ("every sweep is the same file", NEW, _same_sweep, WARNED),
    ("points in the axes of the camera", NEW, points(_camera_axes, every=True), WARNED),
    ("times in milliseconds", NEW,
     lines("d/times.txt", lambda x: [f"{1000 * float(t):.3f}" for t in x]), REFUSED),
    ("P2 of an image of width 1", NEW,
     text("d/calib.txt", lambda t: t.replace("7.215377000000e+02", "0.9")), WARNED),
    ("Tr with its fourth row", NEW,
     lines("d/calib.txt", lambda x: [y + " 0 0 0 1" if y[:2] == "Tr" else y for y in x]), REFUSED),
    ("mirrored poses", [*NEW, "--poses", "p.txt"], _poses(_mirrored), REFUSED),
    ("poses with a scale", [*NEW, "--poses", "p.txt"], _poses(_twice_as_large), REFUSED),
    ("poses that stand still", [*NEW, "--poses", "p.txt"], _poses(lambda T: T[[0, 0, 0, 0]]),
     WARNED),
    ("the inverse of the poses", [*NEW, "--poses", "p.txt"], _poses(np.linalg.inv), WARNED),
    ("poses with a heading", [*NEW, "--poses", "p.txt"], write("p.txt", b"t,x,y,z\n0,0,0,0\n"),
     REFUSED),
    ("a decimal comma", [*NEW, "--set", "dynamics.tolerance=0,3"], None, REFUSED),
    ("minutes: 1:20", [*NEW, "--set", "render.max_depth=1:20"], None, REFUSED),
    ("a stage twice in a settings file", [*NEW, "--config", "c.yaml"],
     write("c.yaml", b"dynamics: {tolerance: 0.3}\ndynamics: {window: 3}\n"), REFUSED),
    ("999 threads", [*NEW, "--threads", "999"], None, REFUSED),
    ("an empty name of a camera", [*NEW, "--camera", ""], None, REFUSED),
    ("a space in a list of cameras", [*NEW, "--camera", "image_2, image_2"], None, EITHER),
    ("an image size the wrong way round", [*NEW, "--image-size", "375x1242"], remove("d/image_2"),
     REFUSED),
    ("a virtual camera called 000000.png", [*VIRTUAL, "--size", "99x99", "--name", "000000.png"],
     None, REFUSED),
    ("a virtual camera a kilometre ahead",
     ["render", "r", "--pose", "1000,0,1", "--K", "9,9,4,3", "--size", "9x7"], None, WARNED),
    ("a name without a virtual camera", ["render", "r", "--name", "wide"], None, REFUSED),
    ("times without a virtual camera", ["render", "r", "--camera-times", "d/image_2/times.txt"],
     None, REFUSED),
    ("true depth in millimetres", ["evaluate", "depth", "r", "--depth", "mm"], _in_millimetres,
     WARNED),
    ("the run's own depth as truth", ["evaluate", "depth", "r", "--depth", "r/depth"], None,
     REFUSED),
    ("the run's own labels as truth", ["evaluate", "labels", "r", "--labels", "r"], None, REFUSED),
    ("two judges", ["tune", "r", "-o", "t", "--labels", "d", "--depth", "d", "--vary",
                    "render.behind=5,6"], None, REFUSED),
    ("results of tune inside the run", ["tune", "r", "-o", "r/depth", "--vary",
                                        "render.behind=5,6"], None, REFUSED),
    ("the recording was moved, the run alone", ["run", "r"],
     lambda at: (at / "d").rename(at / "d2"), REFUSED),
    ("the folder above, twice", ["run", "above", "-o", "r"], _run_above, EITHER),
    ("a map renamed to .jpg", AGAIN,
     lambda at: (at / "r/depth/000001.png").rename(at / "r/depth/000001.jpg"), EITHER),
    ("a typing error in run.yaml", ["run", "r"],
     text("r/run.yaml", lambda t: t.replace("tolerance:", "tolerence:")), REFUSED),
    ("a folder that was deleted meanwhile", [],
     shell("mkdir gone; cd gone; rmdir ../gone; $DOCDEPTH run d -o n"), REFUSED),
    ("a renderer of the environment that there is not", [],
     shell("DOCDEPTH_RENDERER=vulkan $DOCDEPTH run d -o n"), REFUSED),
]  # fmt: skip
