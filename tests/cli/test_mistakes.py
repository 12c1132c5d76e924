"""Mistakes that users make, each on a drive ``d`` of four sweeps and a run ``r`` of it.

A case names what was done, the command, how a copy is spoilt, and what must come of it:

- an error class with key words of its message: refused;
- ``REPAIRED``: the run ends with the depth maps and labels of an undisturbed one;
- ``WARNED`` with key words: it ends, and a warning has them.
"""

from __future__ import annotations

import logging
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from command_line import cli
from docdepth.errors import (
    CalibrationError,
    ConfigError,
    DatasetError,
    DocDepthError,
    OdometryError,
    RunError,
)
from small_drive import write_small_drive

USAGE, REPAIRED, WARNED = "usage", "repaired", "warned"

NEW = ["run", "d", "-o", "n"]
AGAIN = ["run", "d", "-o", "r"]
VIRTUAL = ["render", "r", "--pose", "0,0,1", "--K", "60,60,48,20"]
SWEEP, IMAGE = "d/velodyne/000002.bin", "d/image_2/000001.png"
FRAME, MAP = "r/frames/frame_000002.ply", "r/depth/000001.png"

Spoil = Callable[[Path], object]


def remove(name: str) -> Spoil:
    def spoil(at: Path) -> None:
        path = at / name
        shutil.rmtree(path) if path.is_dir() else path.unlink()

    return spoil


def write(name: str, content: bytes) -> Spoil:
    return lambda at: (at / name).write_bytes(content)


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


def text(name: str, change: Callable[[str], str]) -> Spoil:
    return lambda at: (at / name).write_text(change((at / name).read_text()))


def lines(name: str, change: Callable[[list[str]], list[str]]) -> Spoil:
    return text(name, lambda old: "\n".join(change(old.splitlines())) + "\n")


def columns(count: int, dtype: str = "float32") -> Spoil:
    """Rows of another number of values, or of doubles."""

    def spoil(at: Path) -> None:
        for path in (at / "d/velodyne").glob("*.bin"):
            rows = np.fromfile(path, np.float32).reshape(-1, 4)
            padded = np.pad(rows, ((0, 0), (0, max(count - 4, 0))))
            padded[:, :count].astype(dtype).tofile(path)

    return spoil


def extrinsics(change: Callable[[np.ndarray], np.ndarray]) -> Spoil:
    """Change ``Tr`` of calib.txt, shape (3, 4)."""

    def changed(rows: list[str]) -> list[str]:
        *others, Tr = rows
        values = change(np.array(Tr.split()[1:], float).reshape(3, 4))
        return [*others, "Tr: " + " ".join(f"{x:.9e}" for x in values.ravel())]

    return lines("d/calib.txt", changed)


def poses(change: Callable[[np.ndarray], np.ndarray]) -> Spoil:
    """A file p.txt of poses ``T_world_lidar``, spoilt."""

    def spoil(at: Path) -> None:
        steps = np.tile(np.eye(4), (4, 1, 1))
        steps[:, 0, 3] = 0.5 * np.arange(4)
        np.savetxt(at / "p.txt", change(steps)[:, :3].reshape(-1, 12))

    return spoil


def utm_later(steps: np.ndarray) -> np.ndarray:
    """The receiver has no position yet at the first pose."""
    steps[1:, 0, 3] += 2e6
    return steps


def config(content: bytes) -> tuple[list[str], Spoil]:
    return [*NEW, "--config", "c.yaml"], write("c.yaml", content)


def evaluate(kind: str, truth: str) -> list[str]:
    return ["evaluate", kind, "r", f"--{kind}", truth]


def other_recording(at: Path) -> None:
    """A recording with the same names and sizes, of another drive."""
    shutil.copytree(at / "d", at / "d2")
    for file in (at / "d2" / "velodyne").iterdir():
        np.fromfile(file, np.float32).reshape(-1, 4)[::-1].tofile(file)


def relabel(*classes: int) -> Spoil:
    """True labels of these classes in turn."""

    def spoil(at: Path) -> None:
        for file in (at / "d/labels").iterdir():
            np.resize(np.array(classes, "<u4"), file.stat().st_size // 4).tofile(file)

    return spoil


def kilometres(at: Path) -> None:
    for file in (at / "d/velodyne").iterdir():
        (np.fromfile(file, np.float32) / 1000).tofile(file)


def millimetres(at: Path) -> None:
    """True depth as PNG of millimetres, which RGB-D cameras write."""
    (at / "mm").mkdir()
    for file in sorted((at / "d/depth_2").glob("*.npy")):
        depth = np.clip(1000 * np.nan_to_num(np.load(file)), 0, 65535).astype(np.uint16)
        cv2.imwrite(str(at / "mm" / f"{file.stem}.png"), depth)


RECORDINGS = [
    ("no recording", ["run", "no", "-o", "n"], None, DatasetError, "no "),
    ("a file", ["run", "d/calib.txt", "-o", "n"], None, DatasetError, "calib.txt"),
    ("an empty folder", ["run", "e", "-o", "n"], lambda at: (at / "e").mkdir(), DatasetError, "e"),
    ("a dangling link", ["run", "e", "-o", "n"], link("e", "no"), DatasetError, "no"),
    ("no calib.txt", NEW, remove("d/calib.txt"), DatasetError, "calib.txt"),
    ("calib.txt empty", NEW, write("d/calib.txt", b""), DatasetError, "calib.txt"),
    ("calib.txt binary", NEW, write("d/calib.txt", bytes(range(256))), DatasetError, "calib.txt"),
    ("no Tr", NEW, lines("d/calib.txt", lambda x: x[:-1]), DatasetError, "Tr"),
    ("Tr in mm", NEW, extrinsics(lambda Tr: Tr * [1, 1, 1, 1000]), DatasetError, "Tr metres"),
    ("Tr of NaN", NEW, extrinsics(lambda Tr: Tr * np.nan), DatasetError, "Tr finite"),
    ("Tr, rows swapped", NEW, extrinsics(lambda Tr: Tr[[1, 0, 2]]), DatasetError, "Tr"),
    ("Tr of 4 rows", NEW, lines("d/calib.txt", lambda x: [*x[:-1], f"{x[-1]} 0 0 0 1"]),
     DatasetError, "Tr 12"),
    ("no focal length", NEW, text("d/calib.txt", lambda t: t.replace("60", "0")),
     CalibrationError, "P2"),
    ("images mirrored", NEW, text("d/calib.txt", lambda t: t.replace("60 0 48", "-60 0 48")),
     CalibrationError, "K must flip"),
    ("sweeps in km", NEW, kilometres, DatasetError, "0.5 metres"),
    ("no times.txt", NEW, remove("d/times.txt"), DatasetError, "times.txt"),
    ("a time too few", NEW, lines("d/times.txt", lambda x: x[:-1]), DatasetError, "3 times 4"),
    ("times backwards", NEW, lines("d/times.txt", lambda x: x[::-1]), DatasetError, "frame 1"),
    ("times of words", NEW, write("d/times.txt", b"a\nb\n"), DatasetError, "line 1 'a'"),
    ("an empty sweep", NEW, write(SWEEP, b""), DatasetError, "000002.bin empty"),
    ("a sweep cut off", NEW, cut(SWEEP, 0.4999), DatasetError, "000002.bin frame truncated"),
    ("a sweep missing", NEW, remove(SWEEP), WARNED, "missing"),
    ("five floats", NEW, columns(5), DatasetError, "000000.bin float32"),
    ("three floats", NEW, columns(3), DatasetError, "000000.bin float32"),
    ("doubles", NEW, columns(4, "float64"), DatasetError, "000000.bin float64"),
    ("poses, a row short", [*NEW, "--poses", "p.txt"], poses(lambda T: T[[0, 1, 2]]), OdometryError,
     "p.txt 3 4"),
    ("poses, UTM later", [*NEW, "--dry-run", "--poses", "p.txt"], poses(utm_later), DocDepthError,
     "1 of 4 poses km frame 0"),
    ("poses: a folder", [*NEW, "--poses", "d"], None, OdometryError, "poses"),
    ("poses: an image", [*NEW, "--poses", IMAGE], None, OdometryError, "000001.png poses"),
    ("poses mirrored", [*NEW, "--poses", "p.txt"], poses(lambda T: T * [1, -1, 1, 1]),
     OdometryError, "p.txt mirror"),
    ("poses with a scale", [*NEW, "--poses", "p.txt"], poses(lambda T: T * [2, 2, 2, 1]),
     OdometryError, "p.txt rotation"),
    ("poses inverted", [*NEW, "--poses", "p.txt"], poses(np.linalg.inv), WARNED, "poses fit"),
    ("poses with a header", [*NEW, "--poses", "p.txt"], write("p.txt", b"t,x,y\n0,0,0\n"),
     OdometryError, "p.txt"),
    ("image times: a folder", [*NEW, "--camera-times", "d"], None, DatasetError, "folder"),
    ("image times: a sweep", [*NEW, "--camera-times", SWEEP], None, DatasetError, "000002.bin"),
    ("docdepth.yaml broken", NEW, write("d/docdepth.yaml", b"a: [1"), DocDepthError, ".yaml"),
    ("docdepth.yaml a list", NEW, write("d/docdepth.yaml", b"- 1\n"), DocDepthError, ".yaml"),
    ("labels too few", evaluate("labels", "d"), cut("d/labels/000002.label", 0.5), DatasetError,
     "000002.label"),
    ("labels of odd bytes", evaluate("labels", "d"), write("d/labels/000002.label", b"abc"),
     DatasetError, "000002.label uint32"),
    ("labels: one away", evaluate("labels", "d"), remove("d/labels/000002.label"), DatasetError,
     "000002.label read"),
    ("labels of 0 and 1", evaluate("labels", "d"), relabel(0, 1), DatasetError, "no point label"),
    ("ids for training", evaluate("labels", "d"), relabel(1, 9, 17), DatasetError, "class 17"),
    ("nothing moves", evaluate("labels", "d"), relabel(10, 40), WARNED, "no class moves"),
    ("no labels", evaluate("labels", "no"), None, DatasetError, "no is not there"),
    ("no depth", evaluate("depth", "no"), None, DatasetError, "no is not there"),
    ("own labels", evaluate("labels", "r"), None, DocDepthError, "r"),
    ("depth broken", evaluate("depth", "d"), cut("d/depth_2/000001.npy", 0.5), DatasetError,
     "000001.npy"),
    ("depth: sweeps", evaluate("depth", "d/velodyne"), None, DatasetError, "d/velodyne"),
    ("own depth", evaluate("depth", "r/depth"), None, DocDepthError, "r/depth"),
    ("depth in mm", evaluate("depth", "mm"), millimetres, WARNED, "mm scale"),
]  # fmt: skip

OPTIONS = [
    ("nothing to run", ["run"], None, DocDepthError, "RECORDING RUN"),
    ("a verb", ["rnu", "d"], None, USAGE, "rnu run"),
    ("an option", [*NEW, "--presett", "paper"], None, USAGE, "--presett --preset"),
    ("a preset", [*NEW, "--preset", "best"], None, USAGE, "best default paper"),
    ("a dataset", [*NEW, "--dataset", "kiti"], None, USAGE, "kiti kitti_raw"),
    ("the wrong dataset", [*NEW, "--dataset", "kitti_raw"], None, DatasetError, "kitti_raw"),
    ("a camera", [*NEW, "--camera", "image_9"], None, DocDepthError, "image_9 image_2"),
    ("no camera's name", [*NEW, "--camera", ""], None, DocDepthError, "empty"),
    ("a space", [*NEW, "--camera", "image_2, image_2"], None, REPAIRED, ""),
    ("a format", [*NEW, "--format", "jpg"], None, USAGE, "jpg png"),
    ("a layer", [*NEW, "--layers", "tiem"], None, USAGE, "tiem time"),
    ("a decimal comma", [*NEW, "--set", "dynamics.tolerance=0,3"], None, ConfigError, "tolerance"),
    ("a tiny step", [*NEW, "--set", "render.step=1e-9"], None, ConfigError, "render.step 0.01"),
    ("a tiny scale", [*NEW, "--scale", "1e-7"], None, ConfigError, "scale 10000"),
    ("threads: -1", [*NEW, "--threads", "-1"], None, USAGE, "--threads"),
    ("threads: 999", [*NEW, "--threads", "999"], None, USAGE, "--threads 256"),
    ("half a size", [*NEW, "--image-size", "100"], None, DocDepthError, "100"),
    ("no such size", [*NEW, "--image-size", "9x9"], None, DocDepthError, "9 96"),
    ("no config", [*NEW, "--config", "no"], None, ConfigError, "no"),
    ("config: a folder", [*NEW, "--config", "d"], None, ConfigError, "d"),
    ("config: a sweep", [*NEW, "--config", SWEEP], None, ConfigError, "000002.bin"),
    ("config: a list", *config(b"- a\n"), ConfigError, "c.yaml"),
    ("config: broken", *config(b"a: [1\n"), ConfigError, "c.yaml line"),
    ("config: a typo", *config(b"odometry: {max_rage: 80}\n"), ConfigError, "c.yaml max_rage"),
    ("config: twice", *config(b"render: {step: 1}\nrender: {step: 2}\n"), ConfigError, "render"),
    ("config: no recording", *config(b"inputs: {recording: 3}\nparameters: {}\n"), ConfigError,
     "c.yaml run.yaml"),
    ("neither", ["run", "-o", "n"], None, ConfigError, "recording"),
    ("config: half", *config(b"source: {dataset: 3}\nparameters: {}\n"), ConfigError, "c.yaml"),
    ("no --K", ["render", "r", "--pose", "0,0,1"], None, DocDepthError, "--K"),
    ("no --pose", ["render", "r", "--name", "wide"], None, DocDepthError, "--pose"),
    ("no pose", ["render", "r", "--camera-times", "t.txt"], None, DocDepthError, "--pose"),
    ("half a pose", ["render", "r", "--pose", "0,0", "--K", "9,9,4,3", "--size", "9x7"], None,
     DocDepthError, "rigid"),
    ("half a K", ["render", "r", "--pose", "0,0,1", "--K", "9,9,4", "--size", "9x7"], None,
     DocDepthError, "fx,fy,cx,cy"),
    ("half an image", [*VIRTUAL, "--size", "9"], None, DocDepthError, "WIDTHxHEIGHT"),
    ("a name 1.png", [*VIRTUAL, "--size", "9x7", "--name", "1.png"], None, DocDepthError, "folder"),
    ("a huge image", [*VIRTUAL, "--size", "100000x100000"], None, DocDepthError, "GB"),
    ("an empty image", [*VIRTUAL, "--size", "0x0"], None, DocDepthError, "0"),
    ("a name ../x", [*VIRTUAL, "--size", "9x7", "--name", "../x"], None, DocDepthError, "../x"),
    ("a kilometre ahead", ["render", "r", "--pose", "1000,0,1", "--K", "9,9,4,3", "--size", "9x7"],
     None, WARNED, "0.0 %"),
    ("video: 1e9 a second", ["video", "r", "--fps", "1e9"], None, USAGE, "--fps"),
    ("video: a camera", ["video", "r", "--camera", "x"], None, DocDepthError, "x"),
    ("view: sweep 99", ["view", "r", "--frame", "99"], None, DocDepthError, "99"),
    ("view: v.abc", ["view", "r", "--image", "v.abc"], None, DocDepthError, "v.abc"),
    ("tune: a folder", ["tune", "r", "--labels", "d", "-o", "t", "--trials", "d"], None,
     ConfigError, "d"),
    ("tune: inside", ["tune", "r", "-o", "r/depth", "--vary", "render.behind=5,6"], None,
     ConfigError, "r/depth"),
    ("synth over a drive", ["synth", "d"], None, DatasetError, "d not empty"),
    ("output below a file", ["run", "d", "-o", "d/calib.txt/n"], None, DocDepthError, "calib.txt"),
    ("output: a link loop", ["run", "d", "-o", "l"], link("l", "l"), DocDepthError, "l"),
    ("output: read-only", ["run", "d", "-o", "/proc/run"], None, DocDepthError, "/proc/run"),
    ("config: a tag", ["run", "d", "-o", "n", "--config", "c.yaml"],
     write("c.yaml", b"odometry: {max_range: !!float ''}"), ConfigError, "c.yaml tag"),
    ("P2 of 1e308", ["run", "d", "-o", "n"],
     text("d/calib.txt", lambda t: t.replace("60 0 48", "1e308 0 48")), DocDepthError,
     "calib.txt focal pixels"),
    ("poses beyond the Earth", ["run", "d", "-o", "n", "--poses", "p.txt"],
     write("p.txt", b"1 0 0 1e8 0 1 0 0 0 0 1 0\n" * 4), DocDepthError, "p.txt km origin metres"),
    ("not this stage's", ["render", "r", "--set", "odometry.min_range=1"], None, DocDepthError,
     "odometry.min_range render"),
]  # fmt: skip

RUNS = [
    ("the same again", AGAIN, None, REPAIRED, ""),
    ("run.yaml gone", AGAIN, remove("r/run.yaml"), REPAIRED, ""),
    ("run.yaml, a typo", ["run", "r"],
     text("r/run.yaml", lambda t: t.replace("tolerance:", "tolerence:")), ConfigError, "tolerence"),
    ("no stages", ["run", "r"], write("r/run.yaml", b"source: {}\nparameters: {}\n"),
     REPAIRED, ""),
    ("another recording", ["run", "d2", "-o", "r"], other_recording, RunError, "d d2"),
    ("frame cut off, render", ["render", "r"], cut(FRAME, 0.5), RunError, "frame_000002.ply"),
    ("frame missing, evaluate", ["evaluate", "held-out", "r", "--camera", "image_2"],
     remove(FRAME), RunError, "frame_000002.ply"),
    ("map a folder", AGAIN, folder(MAP), WARNED, "000001.png.old"),
    ("map missing, video", ["video", "r", "--camera", "image_2"], remove(MAP), RunError,
     "000001.png"),
    ("no recording", AGAIN, remove("d"), DatasetError, "d"),
    ("a sweep changed", AGAIN, cut("d/velodyne/000001.bin", 0.4999), DatasetError, "000001.bin"),
    ("no run, render", ["render", "d"], None, RunError, "d"),
    ("no run, evaluate", ["evaluate", "held-out", "no"], None, RunError, "no"),
]  # fmt: skip

CASES = [
    pytest.param(*case[1:], id=case[0], marks=[pytest.mark.slow] * (case[3] in (REPAIRED, WARNED)))
    for case in (*RECORDINGS, *OPTIONS, *RUNS)
]


def products(run: Path) -> dict[str, bytes]:
    """Depth maps and labels of a run."""
    files = [*run.glob("depth/**/0*.png"), *run.glob("labels/*.label")]
    return {str(f.relative_to(run)): f.read_bytes() for f in files if f.is_file()}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the drive and its run."""
    at = tmp_path_factory.mktemp("mistakes")
    drive = write_small_drive(at / "d")
    for kind in ("labels", "depth_2"):
        (drive / kind).mkdir()
    for sweep in sorted((drive / "velodyne").iterdir()):
        np.full(sweep.stat().st_size // 16, 40, "<u4").tofile(drive / f"labels/{sweep.stem}.label")
        np.save(drive / f"depth_2/{sweep.stem}.npy", np.full((40, 96), 5, np.float32))
    ended = cli("run", drive, "-o", at / "r")
    assert ended.exit_code == 0, ended.output
    return at


@pytest.mark.parametrize(("words", "spoil", "expected", "key_words"), CASES)
def test_a_mistake_is_answered(
    made: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    words: list[str],
    spoil: Spoil | None,
    expected: type[DocDepthError] | str,
    key_words: str,
) -> None:
    for name in ("d", "r"):
        shutil.copytree(made / name, tmp_path / name)
    manifest = tmp_path / "r" / "run.yaml"  # a run knows its recording by an absolute path
    manifest.write_text(manifest.read_text().replace(str(made), str(tmp_path)))
    if spoil:
        spoil(tmp_path)
    monkeypatch.chdir(tmp_path)
    with caplog.at_level(logging.WARNING):
        ended = cli(*words)
    if expected == REPAIRED:
        assert ended.exit_code == 0, ended.output
        new = tmp_path / ("n" if (tmp_path / "n").exists() else "r")
        assert products(new) == products(made / "r")
        return
    if expected == WARNED:
        assert ended.exit_code == 0, ended.exception or ended.output
        message = caplog.text
    else:
        assert ended.exit_code == 2, ended.output
        message = ended.output if expected == USAGE else str(ended.exception)
        assert expected == USAGE or isinstance(ended.exception, expected), repr(ended.exception)
    missing = [word for word in key_words.split() if word not in message]
    assert not missing, message


@pytest.mark.slow
def test_a_limit_to_the_size_of_files_is_answered(made: Path, tmp_path: Path):
    command = f"ulimit -f 4; trap '' XFSZ; {sys.executable} -m docdepth run {made / 'd'} -o n"
    ended = subprocess.run(["bash", "-c", command], cwd=tmp_path, capture_output=True, text=True)
    assert ended.returncode == 2, ended.stderr
    assert "too large" in ended.stderr
