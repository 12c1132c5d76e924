"""Mistakes in recordings: what was done, the command, how a copy is spoilt, what may come of it.

``d`` is the sequence, ``r`` a finished run of it; a new run goes into ``n``.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

NEW = ["run", "d", "-o", "n"]
SWEEP, IMAGE = "d/velodyne/000002.bin", "d/image_2/000001.png"

Spoil = Callable[[Path], None]


def remove(name: str) -> Spoil:
    def spoil(at: Path) -> None:
        path = at / name
        shutil.rmtree(path) if path.is_dir() else path.unlink()

    return spoil


def write(name: str, content: bytes) -> Spoil:
    return lambda at: (at / name).write_bytes(content) and None


def folder(name: str) -> Spoil:
    """A folder where a file should be."""

    def spoil(at: Path) -> None:
        (at / name).unlink()
        (at / name).mkdir()

    return spoil


def cut(name: str, keep: float) -> Spoil:
    """Keep a share of a file."""

    def spoil(at: Path) -> None:
        content = (at / name).read_bytes()
        (at / name).write_bytes(content[: int(len(content) * keep)])

    return spoil


def link(name: str, target: str) -> Spoil:
    def spoil(at: Path) -> None:
        (at / name).unlink(missing_ok=True)
        (at / name).symlink_to(target)

    return spoil


def points(change: Callable[[np.ndarray], np.ndarray], every: bool = False) -> Spoil:
    """Change the points of one sweep, or of all."""

    def spoil(at: Path) -> None:
        for path in sorted((at / "d/velodyne").glob("*.bin")) if every else [at / SWEEP]:
            change(np.fromfile(path, np.float32).reshape(-1, 4)).tofile(path)

    return spoil


def columns(count: int, dtype: str = "float32") -> Spoil:
    """Rows of another number of values, or of doubles."""

    def change(rows: np.ndarray) -> np.ndarray:
        more = np.zeros((len(rows), max(count - 4, 0)), np.float32)
        return np.hstack([rows, more])[:, :count].astype(dtype)

    return points(change, every=True)


def text(name: str, change: Callable[[str], str]) -> Spoil:
    return lambda at: (at / name).write_text(change((at / name).read_text())) and None


def lines(name: str, change: Callable[[list[str]], list[str]]) -> Spoil:
    return text(name, lambda old: "\n".join(change(old.splitlines())) + "\n")


def extrinsics(change: Callable[[np.ndarray], np.ndarray]) -> Spoil:
    """Change ``Tr`` of calib.txt, shape (3, 4)."""

    def spoil(at: Path) -> None:
        path = at / "d/calib.txt"
        rows = dict(line.split(":", 1) for line in path.read_text().splitlines())
        Tr = change(np.array(rows["Tr"].split(), float).reshape(3, 4))
        rows["Tr"] = " ".join(f"{x:.9e}" for x in Tr.ravel())
        path.write_text("".join(f"{k}: {v.strip()}\n" for k, v in rows.items()))

    return spoil


def image(height: int, width: int) -> Spoil:
    return lambda at: cv2.imwrite(str(at / IMAGE), np.zeros((height, width, 3), np.uint8)) and None


def _first(value: float) -> Callable[[np.ndarray], np.ndarray]:
    def change(Tr: np.ndarray) -> np.ndarray:
        Tr[0, 0] = value
        return Tr

    return change


def _without_focal_length(rows: list[str]) -> list[str]:
    words = {row.split()[0]: row.split() for row in rows}
    words["P2:"][1] = "0.0"
    return [" ".join(row) for row in words.values()]


def _half_nan(rows: np.ndarray) -> np.ndarray:
    rows[::2, :3] = np.nan
    return rows


def _inverse(Tr: np.ndarray) -> np.ndarray:
    return np.hstack([Tr[:, :3].T, -Tr[:, :3].T @ Tr[:, 3:]])


REFUSED, WARNED = "refused", "refused or warned"

INPUTS = [
    ("no such recording", ["run", "nowhere", "-o", "n"], None, REFUSED),
    ("a file as the recording", ["run", "d/calib.txt", "-o", "n"], None, REFUSED),
    ("an empty folder", ["run", "e", "-o", "n"], lambda at: (at / "e").mkdir(), REFUSED),
    ("a dangling link", ["run", "e", "-o", "n"], link("e", "nowhere"), REFUSED),
    ("a link to itself", ["run", "e", "-o", "n"], link("e", "e"), REFUSED),
    ("no calib.txt", NEW, remove("d/calib.txt"), REFUSED),
    ("calib.txt empty", NEW, write("d/calib.txt", b""), REFUSED),
    ("calib.txt binary", NEW, write("d/calib.txt", bytes(range(256))), REFUSED),
    ("Tr missing", NEW, lines("d/calib.txt", lambda x: [y for y in x if y[:2] != "Tr"]), REFUSED),
    ("Tr begins with 5.0", NEW, extrinsics(_first(5.0)), REFUSED),
    ("Tr all zeros", NEW, extrinsics(lambda Tr: Tr * 0), REFUSED),
    ("Tr in millimetres", NEW, extrinsics(lambda Tr: Tr * [1, 1, 1, 1000]), REFUSED),
    ("Tr holds NaN", NEW, extrinsics(lambda Tr: Tr * np.nan), REFUSED),
    ("Tr with two rows swapped", NEW, extrinsics(lambda Tr: Tr[[1, 0, 2]]), WARNED),
    ("Tr the wrong way round", NEW, extrinsics(_inverse), WARNED),
    ("P2 without focal length", NEW, lines("d/calib.txt", _without_focal_length), WARNED),
    ("no times.txt", NEW, remove("d/times.txt"), REFUSED),
    ("times.txt too short", NEW, lines("d/times.txt", lambda x: x[:-1]), REFUSED),
    ("times.txt backwards", NEW, lines("d/times.txt", lambda x: x[::-1]), REFUSED),
    ("times.txt of words", NEW, write("d/times.txt", b"a\nb\nc\nd\n"), REFUSED),
    ("a sweep is empty", NEW, write(SWEEP, b""), REFUSED),
    ("a sweep is cut off", NEW, cut(SWEEP, 0.4999), REFUSED),
    ("a sweep is missing", NEW, remove(SWEEP), WARNED),
    ("a sweep is a dangling link", NEW, link(SWEEP, "nowhere"), REFUSED),
    ("a sweep is a folder", NEW,
     folder(SWEEP), REFUSED),
    ("a sweep of NaN alone", NEW, points(lambda rows: rows * np.nan), REFUSED),
    ("half a sweep is NaN", NEW, points(_half_nan), "refused, warned or repaired"),
    ("a sweep of one point", NEW, points(lambda rows: rows[:1]), WARNED),
    ("a sweep in centimetres", NEW, points(lambda rows: rows * 100, every=True), WARNED),
    ("sweeps of five floats a point", NEW, columns(5), REFUSED),
    ("sweeps of three floats a point", NEW, columns(3), REFUSED),
    ("sweeps of doubles", NEW, columns(4, "float64"), REFUSED),
    ("an image is cut off", NEW, cut(IMAGE, 0.5), WARNED),
    ("an image is text", NEW, write(IMAGE, b"hello"), REFUSED),
    ("an image of another size", NEW, image(10, 20), REFUSED),
    ("image times after the drive", NEW,
     lines("d/image_2/times.txt", lambda x: [f"{float(t) + 1e4:.9f}" for t in x]), REFUSED),
    ("image times too few", NEW, lines("d/image_2/times.txt", lambda x: x[:1]), REFUSED),
    ("poses with a row too few", [*NEW, "--poses", "d/poses.txt"],
     lines("d/poses.txt", lambda x: x[:-1]), REFUSED),
    ("poses that are no rotations", [*NEW, "--poses", "d/poses.txt"],
     text("d/poses.txt", lambda t: t.replace("9.", "5.").replace("1.0", "3.0")), REFUSED),
    ("poses: a folder", [*NEW, "--poses", "d"], None, REFUSED),
    ("poses: an image", [*NEW, "--poses", IMAGE], None, REFUSED),
    ("image times: a folder", [*NEW, "--camera-times", "d"], None, REFUSED),
    ("image times: a sweep", [*NEW, "--camera-times", SWEEP], None, REFUSED),
    ("docdepth.yaml broken", NEW, write("d/docdepth.yaml", b"a: [1"), REFUSED),
    ("docdepth.yaml a list", NEW, write("d/docdepth.yaml", b"- 1\n"), REFUSED),
    ("labels of another drive", ["evaluate", "labels", "r", "--labels", "d"],
     cut("d/labels/000002.label", 0.5), REFUSED),
    ("labels that are not there", ["evaluate", "labels", "r", "--labels", "nowhere"], None,
     REFUSED),
    ("a true depth map is broken", ["evaluate", "depth", "r", "--depth", "d"],
     cut("d/depth_2/000001.npy", 0.5), REFUSED),
    ("true depth: a folder of sweeps", ["evaluate", "depth", "r", "--depth", "d/velodyne"], None,
     REFUSED),
]  # fmt: skip
