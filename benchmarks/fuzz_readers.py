"""Every reader of docdepth, and small files that it reads, which ``fuzz.py`` changes."""

from __future__ import annotations

import io
import struct
import tempfile
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from docdepth import open_dataset, run
from docdepth.cli.config_file import read_config
from docdepth.datasets import kitti_files
from docdepth.datasets.cloud_files import RowFormat, read_cloud, read_viewpoint
from docdepth.datasets.formats.bag import ros_images, ros_points
from docdepth.datasets.kitti_files import Calibration
from docdepth.datasets.pose_tables import poses_of_matrices, read_pose_table
from docdepth.datasets.settings import RecordingSettings, read_settings
from docdepth.datasets.times import read_times
from docdepth.errors import DocDepthError
from docdepth.geometry.lidar_frame import LidarFrame
from docdepth.geometry.sensor_rig import SensorRig
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.calibration import read_camera_calibration
from docdepth.io.depth import encode_depth, read_depth
from docdepth.io.frames import read_frame, read_trajectory, write_frame
from docdepth.io.frames import write_trajectory as write_ply_trajectory
from docdepth.io.labels import read_classes
from docdepth.io.pcd import write_pcd
from docdepth.io.poses import read_poses, read_timed_poses, write_kitti, write_tum
from docdepth.io.run_folder import RunFolder
from docdepth.io.tracks import read_tracks
from docdepth.pipeline.plan import states

_POINTS = np.random.default_rng(3).normal(0, 20, (6, 3)).astype(np.float32)
_POSES = np.repeat(np.eye(4)[None], 3, axis=0)
_POSES[:, 0, 3] = (0.0, 0.5, 1.0)
_TRAJECTORY = Trajectory(np.arange(3) * 10**8 + 10**18, _POSES)
_FRAME = LidarFrame(
    _POINTS, np.arange(6, dtype=np.uint32), "000003", 9,
    np.zeros(6, np.float32), SensorRig.single((0, 0, 1), 6),
    *(np.arange(6, dtype=np.uint16) for _ in range(4)),
)  # fmt: skip


@cache
def sample_run() -> Path:
    """A run of a tiny drive (tests/small_drive.py); its files are changed, too."""
    from small_drive import write_small_drive

    root = Path(tempfile.mkdtemp())
    return run(write_small_drive(root / "drive"), root / "run", camera="image_2").path


def _of_run(*names: str) -> Callable[[Path], list[bytes]]:
    return lambda folder: [(sample_run() / name).read_bytes() for name in names]


@dataclass(frozen=True)
class Reader:
    """What is fuzzed.

    Attributes
    ----------
    name : str
    file : str
        Name of the file in a folder of its own.
    read : callable
        Reads the file; every error but one of docdepth is a find.
    seeds : callable
        Writes files into a folder and returns their contents.
    """

    name: str
    file: str
    read: Callable[[Path], object]
    seeds: Callable[[Path], Sequence[bytes]]


def _written(*writers: Callable[[Path], object]) -> Callable[[Path], list[bytes]]:
    """Contents of files that these write."""

    def seeds(folder: Path) -> list[bytes]:
        contents = []
        for k, write in enumerate(writers):
            path = folder / f"seed{k}"
            write(path)
            contents.append(path.read_bytes())
        return contents

    return seeds


def _texts(*texts: str) -> Callable[[Path], list[bytes]]:
    return lambda folder: [text.encode() for text in texts]


def _bytes(*contents: bytes) -> Callable[[Path], list[bytes]]:
    return lambda folder: list(contents)


def _array(values: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, values)
    return stream.getvalue()


# ---- point clouds

_PCD = (
    "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z intensity _\nSIZE 4 4 4 4 1\nTYPE F F F F U\n"
    "COUNT 1 1 1 1 {pad}\nWIDTH 2\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 2\nDATA {data}\n"
)


def _pcd(folder: Path) -> list[bytes]:
    import lzf

    write_pcd(folder / "a.pcd", _POINTS, _POINTS[:, 0], np.array([0, 0, 0, 1.0, 0, 0, 0]))
    whole = np.zeros((6, 4), "<f4").tobytes()
    packed = lzf.compress(whole)
    head = (folder / "a.pcd").read_bytes().split(b"DATA")[0] + b"DATA binary_compressed\n"
    ascii_rows = "1 2 3 0.5 0\n4 5 6 0.25 0\n"
    return [
        (folder / "a.pcd").read_bytes(),
        head + struct.pack("<II", len(packed), len(whole)) + packed,
        (_PCD.format(pad=1, data="ascii") + ascii_rows).encode(),
        _PCD.format(pad=0, data="binary").encode() + bytes(32),
    ]


_PLY_TEXT = (
    "ply\nformat ascii 1.0\ncomment name 7\nelement face 1\nproperty list uchar int v\n"
    "element vertex 2\nproperty float x\nproperty float y\nproperty double z\nproperty uchar i\n"
    "end_header\n3 0 1 0\n1 2 3 4\n5 6 7 8\n"
)
_PLY_LISTS = (
    b"ply\nformat binary_big_endian 1.0\nelement face 2\nproperty list uint8 int32 v\n"
    b"element vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
    b"\x01\0\0\0\x01\x02\0\0\0\x01\0\0\0\x02" + bytes(12)
)


def _ply(folder: Path) -> list[bytes]:
    write_frame(folder / "f.ply", _FRAME)
    write_ply_trajectory(folder / "t.ply", _TRAJECTORY, np.arange(3))
    files = [(folder / name).read_bytes() for name in ("f.ply", "t.ply")]
    return [*files, _PLY_TEXT.encode(), _PLY_LISTS]


def _read_ply(path: Path) -> None:
    for read in (
        read_frame,
        read_trajectory,
        lambda p: read_cloud(p, str(p), RowFormat()),
    ):
        _tolerant(read, path)


def _tolerant(read: Callable[[Path], object], path: Path) -> None:
    """Read, whether an error of docdepth comes of it or not."""
    with suppress(DocDepthError):
        read(path)


def _read_pcd(path: Path) -> None:
    _tolerant(lambda p: read_viewpoint(p, 3), path)
    _tolerant(lambda p: read_classes(p, 6, 3, lambda: np.arange(6)), path)
    read_cloud(path, "sweep (frame 3)", RowFormat())


def _read_bin(path: Path) -> None:
    _tolerant(lambda p: kitti_files.read_sweep(p, 3), path)
    read_cloud(path, "sweep (frame 3)", RowFormat())


def _read_npy(path: Path) -> None:
    for read in (
        read_poses, read_depth, lambda p: read_classes(p, 6, 3),
        lambda p: read_cloud(p, str(p), RowFormat()),
    ):  # fmt: skip
        _tolerant(read, path)


# ---- fields of ROS messages

_HEAD, _FIELD = struct.Struct("<4IBB"), struct.Struct("<4sIBI")


def _message_bytes(order: bool) -> bytes:
    head = _HEAD.pack(4, 1, 16, 64, order, 4)
    fields = b"".join(
        _FIELD.pack(name, 4 * k, 7, 1) for k, name in enumerate((b"x", b"y", b"z", b"time"))
    )
    return head + fields + bytes(64)


def _read_message(path: Path) -> None:
    data = path.read_bytes().ljust(_HEAD.size, b"\0")
    width, height, step, row, order, count = _HEAD.unpack_from(data)
    at, fields = _HEAD.size, []
    for _ in range(min(count, (len(data) - at) // _FIELD.size)):
        name, offset, datatype, several = _FIELD.unpack_from(data, at)
        text = name.rstrip(b"\0").decode("latin-1")
        fields.append(SimpleNamespace(name=text, offset=offset, datatype=datatype, count=several))
        at += _FIELD.size
    rest = np.frombuffer(data, np.uint8, offset=at)
    cloud = SimpleNamespace(
        fields=fields, is_bigendian=bool(order & 1), point_step=step, row_step=row, width=width,
        height=height, data=rest,
    )  # fmt: skip
    read = ros_points.reader_of(ros_points.POINT_CLOUD)
    _tolerant(lambda p: read(cloud, "a bag"), path)
    encoding = list(ros_images._ENCODINGS)[order % len(ros_images._ENCODINGS)]
    image = SimpleNamespace(
        __msgtype__=ros_images.IMAGES[0], encoding=encoding, width=width, height=height, step=row,
        data=rest,
    )  # fmt: skip
    ros_images.decode_image(image, "a bag")


def _bag(kind: str, suffix: str) -> Callable[[Path], list[bytes]]:
    def seeds(folder: Path) -> list[bytes]:
        from bags import BagWriter  # of tests/datasets

        rows = np.zeros(40, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("t", "<u4")])
        rows["x"], rows["t"] = np.arange(40), np.arange(40) * 2_000_000
        path = folder / f"bag{suffix}"
        with BagWriter(path, kind) as bag:
            for k in range(2):
                bag.write("/points", bag.cloud(rows, k * 10**8), k * 10**8)
        files = [path] if path.is_file() else sorted(path.glob(f"*{suffix}"))
        return [file.read_bytes() for file in files]

    return seeds


def _read_bag(path: Path) -> None:
    recording = open_dataset(path, "bag")
    for k in range(min(len(recording), 3)):
        recording.sweep(k)


# ---- calibration, poses, tables


def _read_kitti(path: Path) -> None:
    calibration = Calibration(path, "restore it")
    for name in ("P2", "Tr"):
        _tolerant(lambda p, name=name: calibration.matrix(name, 3, 4), path)
    calibration.transform("Tr")


def _read_poses(path: Path) -> None:
    for read in (lambda p: read_poses(p, 3), read_timed_poses, read_times):
        _tolerant(read, path)
    _, rows = read_pose_table(path, (7, 12), "restore it")
    if rows.shape[1] == 12:
        poses_of_matrices(rows, path)


_TIMES = "0.1\n1317000000.123456789\n2011-09-26 13:02:25.951199337\n"
_TABLE = "stamp,x,y\n" + "\n".join(f"{10**18 + k} 1 0 0 {k} 0 1 0 0 0 0 1 0" for k in range(3))
_SETTINGS = (
    "motion_compensated: false\nsensor_origin: [0, 0, 1.7]\nup: [0, 0, 1]\nstamp: middle\n"
    "point_time_unit: ns\nsweep_duration: 0.1\nego_boxes: [[-1, 1], [-1, 1], [-2, 0]]\n"
    "poses: poses.txt\n"
)
_CONFIG = (
    "preset: default\nodometry: {max_range: 80}\ndynamics:\n  tolerance: 0.3\n"
    "output: {format: [png, exr], scale: 256}\n"
)

# ---- run folders


def _read_run(path: Path) -> None:
    _tolerant(read_config, path)
    states(RunFolder.open(path.parent))


def _read_records(path: Path) -> None:
    """One content for all notes of a run: records of frames, what stages are made of, inputs."""
    from docdepth.pipeline.input_files import InputFiles

    content, root = path.read_bytes(), path.parent
    notes = root / ".docdepth"
    for name in ("records/frames.jsonl", "records/run.jsonl", "stage_inputs.json", "inputs.json"):
        (notes / name).parent.mkdir(parents=True, exist_ok=True)
        (notes / name).write_bytes(content)
    (root / "run.yaml").write_bytes((sample_run() / "run.yaml").read_bytes())
    run = RunFolder.open(root)
    states(run)
    InputFiles(run).changed()
    for name in run.records(root / "frames").names():
        run.frame_key(0)
        run.records(root / "frames").state(name)


def _rig(folder: Path) -> list[bytes]:
    run = RunFolder(folder)
    run.write_sensors(SensorRig.single((0, 0, 1), 6), {})
    depth = np.full((4, 6), 3.0, np.float32)
    return [run.sensors_path.read_bytes(), encode_depth(depth, "npz")]


def _read_npz(path: Path) -> None:
    _tolerant(read_depth, path)
    content = path.read_bytes()
    (path.parent / "sensors.npz").write_bytes(content)
    run = RunFolder(path.parent)
    run.write_frame(0, _FRAME)
    run.frame(0)


def _read_image(path: Path) -> None:
    for suffix in (".png", ".tiff"):
        other = path.with_suffix(suffix)
        other.write_bytes(path.read_bytes())
        _tolerant(lambda p: read_depth(p, 256.0), other)


def _labels(folder: Path) -> list[bytes]:
    classes = np.array([0, 50, 100, 9, 251, 40], np.uint16)
    return [_array(classes), _array(classes > 99), _array(_POSES), _array(np.ones((6, 4), "<f4"))]


READERS = {
    reader.name: reader
    for reader in (
        Reader("ply", "a.ply", _read_ply, _ply),
        Reader("pcd", "a.pcd", _read_pcd, _pcd),
        Reader("bin", "a.bin", _read_bin, _bytes(np.ones((6, 4), "<f4").tobytes())),
        Reader("npy", "a.npy", _read_npy, _labels),
        Reader("npz", "a.npz", _read_npz, _rig),
        Reader(
            "label", "a.label", lambda p: read_classes(p, 6, 3),
            _bytes(np.array([9, 251, 40, 1, 0, 1 << 16], "<u4").tobytes()),
        ),
        Reader(
            "poses", "poses.txt", _read_poses,
            lambda folder: [
                *_written(
                    lambda p: write_tum(p, _TRAJECTORY), lambda p: write_kitti(p, _POSES)
                )(folder),
                _TIMES.encode(), _TABLE.encode(),
            ],
        ),
        Reader("calib.json", "calib.json", read_camera_calibration, _of_run("calib.json")),
        Reader(
            "calib.txt", "calib.txt", _read_kitti,
            _texts("P2: 60 0 48 -30 0 60 20 0 0 0 1 0\nTr: 0 -1 0 0.02 0 0 -1 -0.06 1 0 0 -0.3\n"),
        ),
        Reader("tracks", "tracks.csv", read_tracks, _of_run("tracks.csv")),
        Reader(
            "docdepth.yaml", "docdepth.yaml", lambda p: read_settings(p.parent, RecordingSettings),
            _texts(_SETTINGS),
        ),
        Reader("parameters", "settings.yaml", read_config, _texts(_CONFIG)),
        Reader("run.yaml", "run.yaml", _read_run, _of_run("run.yaml")),
        Reader(
            "records", "content", _read_records,
            _of_run(*(f".docdepth/{name}" for name in (
                "records/frames.jsonl", "records/run.jsonl", "stage_inputs.json", "inputs.json"
            ))),
        ),
        Reader(
            "message", "message", _read_message,
            _bytes(_message_bytes(False), _message_bytes(True)),
        ),
        Reader("ros1", "a.bag", _read_bag, _bag("ros1", ".bag")),
        Reader("mcap", "a.mcap", _read_bag, _bag("mcap", ".mcap")),
        Reader("depth", "a.img", _read_image, _of_run("depth/000001.png")),
    )
}  # fmt: skip
"""By name."""
