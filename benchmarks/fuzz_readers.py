"""Every reader of docdepth, and small files that it reads, which ``fuzz.py`` changes."""

from __future__ import annotations

import io
import struct
import tempfile
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

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
from docdepth.geometry.lidar_frame import LidarFrame, SensorRig
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


Seed = bytes | str | Callable[[Path], object]
"""The content of a file, or what writes one to a path."""


class Reader(NamedTuple):
    """What is fuzzed: a file of this name, all that reads it, and contents to begin with."""

    file: str
    reads: Sequence[Callable[[Path], object]]
    seeds: Sequence[Seed]

    def contents(self, folder: Path) -> list[bytes]:
        """The seeds as bytes; they are written in a folder."""
        found = []
        for k, seed in enumerate(self.seeds):
            if callable(seed):
                path = folder / f"seed{k}{Path(self.file).suffix}"
                seed(path)
                files = [path] if path.is_file() else path.glob(f"*{path.suffix}")
                found += [file.read_bytes() for file in files]
            else:
                found.append(seed.encode() if isinstance(seed, str) else seed)
        return found


@cache
def sample_run() -> Path:
    """A run of a tiny drive (tests/small_drive.py); its files are changed, too."""
    from small_drive import write_small_drive

    root = Path(tempfile.mkdtemp())
    return run(write_small_drive(root / "drive"), root / "run", camera="image_2").path


def _of_run(name: str) -> Seed:
    return lambda path: path.write_bytes((sample_run() / name).read_bytes())


def _array(values: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, values)
    return stream.getvalue()


def _cloud(path: Path) -> object:
    return read_cloud(path, str(path), RowFormat())


# ---- point clouds

_PCD = (
    "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z intensity _\nSIZE 4 4 4 4 1\nTYPE F F F F U\n"
    "COUNT 1 1 1 1 {pad}\nWIDTH 2\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 2\nDATA {data}\n"
)


def _write_pcd(path: Path) -> None:
    write_pcd(path, _POINTS, _POINTS[:, 0], np.array([0, 0, 0, 1.0, 0, 0, 0]))


def _write_compressed_pcd(path: Path) -> None:
    import lzf

    _write_pcd(path)
    whole = np.zeros((6, 4), "<f4").tobytes()
    packed = lzf.compress(whole)
    head = path.read_bytes().split(b"DATA")[0] + b"DATA binary_compressed\n"
    path.write_bytes(head + struct.pack("<II", len(packed), len(whole)) + packed)


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


# ---- fields of ROS messages

_HEAD, _FIELD = struct.Struct("<4IBB"), struct.Struct("<4sIBI")


def _message_bytes(order: bool) -> bytes:
    head = _HEAD.pack(4, 1, 16, 64, order, 4)
    fields = b"".join(
        _FIELD.pack(name, 4 * k, 7, 1) for k, name in enumerate((b"x", b"y", b"z", b"time"))
    )
    return head + fields + bytes(64)


def _message(path: Path) -> tuple[SimpleNamespace, SimpleNamespace]:
    """A cloud and an image with the fields and the data of a file."""
    data = path.read_bytes().ljust(_HEAD.size, b"\0")
    width, height, step, row, order, count = _HEAD.unpack_from(data)
    at, fields = _HEAD.size, []
    for _ in range(min(count, (len(data) - at) // _FIELD.size)):
        name, offset, datatype, several = _FIELD.unpack_from(data, at)
        text = name.rstrip(b"\0").decode("latin-1")
        fields.append(SimpleNamespace(name=text, offset=offset, datatype=datatype, count=several))
        at += _FIELD.size
    common = {"width": width, "height": height, "data": np.frombuffer(data, np.uint8, offset=at)}
    encoding = list(ros_images._ENCODINGS)[order % len(ros_images._ENCODINGS)]
    return (
        SimpleNamespace(
            fields=fields, is_bigendian=bool(order & 1), point_step=step, row_step=row, **common
        ),
        SimpleNamespace(
            __msgtype__=ros_images.IMAGES[0], encoding=encoding, step=row, **common
        ),
    )  # fmt: skip


def _read_points(path: Path) -> None:
    read = ros_points.reader_of(ros_points.POINT_CLOUD)
    assert read is not None
    read(_message(path)[0], "a bag")


def _read_image(path: Path) -> None:
    ros_images.decode_image(_message(path)[1], "a bag")


def _bag(kind: str) -> Seed:
    def write(path: Path) -> None:
        from bags import BagWriter  # of tests/datasets

        rows = np.zeros(40, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("t", "<u4")])
        rows["x"], rows["t"] = np.arange(40), np.arange(40) * 2_000_000
        with BagWriter(path, kind) as bag:
            for k in range(2):
                bag.write("/points", bag.cloud(rows, k * 10**8), k * 10**8)

    return write


def _read_bag(path: Path) -> None:
    recording = open_dataset(path, "bag")
    for k in range(min(len(recording), 3)):
        recording.sweep(k)


# ---- calibration, poses, tables


def _read_calibration(path: Path) -> None:
    extrinsics = "calib_lidar_ref_cam.txt"
    (path.parent / extrinsics).write_bytes((sample_run() / extrinsics).read_bytes())
    read_camera_calibration(path)


def _matrix(name: str) -> Callable[[Path], object]:
    return lambda path: Calibration(path, "restore it").matrix(name, 3, 4)


def _read_table(path: Path) -> None:
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


_NOTES = tuple(f".docdepth/{name}" for name in (
    "records/frames.jsonl", "records/run.jsonl", "stage_inputs.json", "inputs.json"
))  # fmt: skip


def _read_records(path: Path) -> None:
    """One content for all notes of a run: records of frames, what stages are made of, inputs."""
    from docdepth.pipeline.plan import InputFiles

    content, root = path.read_bytes(), path.parent
    for name in _NOTES:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_bytes(content)
    (root / "run.yaml").write_bytes((sample_run() / "run.yaml").read_bytes())
    run = RunFolder.open(root)
    states(run)
    InputFiles(run).changed("sweeps")
    for name in run.records(root / "frames").names():
        run.key(run.frame_path(0))
        run.records(root / "frames").state(name)


def _write_rig(path: Path) -> None:
    run = RunFolder(path.parent)
    run.write_sensors(SensorRig.single((0, 0, 1), 6), {})
    path.write_bytes(run.sensors_path.read_bytes())


def _read_rig(path: Path) -> None:
    (path.parent / "sensors.npz").write_bytes(path.read_bytes())
    run = RunFolder(path.parent)
    run.write_frame(0, _FRAME)
    run.frame(0)


def _depth_as(suffix: str) -> Callable[[Path], object]:
    def read(path: Path) -> None:
        other = path.with_suffix(suffix)
        other.write_bytes(path.read_bytes())
        read_depth(other, 256.0)

    return read


_CLASSES = np.array([0, 50, 100, 9, 251, 40], np.uint16)

READERS = {
    "ply": Reader("a.ply", [read_frame, read_trajectory, _cloud], [
        lambda p: write_frame(p, _FRAME),
        lambda p: write_ply_trajectory(p, _TRAJECTORY, np.arange(3)), _PLY_TEXT, _PLY_LISTS,
    ]),
    "pcd": Reader("a.pcd", [
        lambda p: read_viewpoint(p, 3), lambda p: read_classes(p, 6, 3, lambda: np.arange(6)),
        _cloud,
    ], [
        _write_pcd, _write_compressed_pcd,
        _PCD.format(pad=1, data="ascii") + "1 2 3 0.5 0\n4 5 6 0.25 0\n",
        _PCD.format(pad=0, data="binary").encode() + bytes(32),
    ]),
    "bin": Reader("a.bin", [lambda p: kitti_files.read_sweep(p, "sweep 3"), _cloud],
                  [np.ones((6, 4), "<f4").tobytes()]),
    "npy": Reader("a.npy", [read_poses, read_depth, lambda p: read_classes(p, 6, 3), _cloud], [
        _array(a) for a in (_CLASSES, _CLASSES > 99, _POSES, np.ones((6, 4), "<f4"))
    ]),
    "csv": Reader("a.csv", [_cloud], [
        "x,y,z,intensity\n1,2,3,0.5\n4,,6,nan\n", "# x y z\n1 2 3\n", "3\n1;2,5;3\n",
    ]),
    "npz": Reader("a.npz", [read_depth, _read_rig],
                  [_write_rig, encode_depth(np.full((4, 6), 3.0, np.float32), "npz")]),
    "label": Reader("a.label", [lambda p: read_classes(p, 6, 3)],
                    [np.array([9, 251, 40, 1, 0, 1 << 16], "<u4").tobytes()]),
    "poses": Reader("poses.txt", [
        lambda p: read_poses(p, 3), read_timed_poses, read_times, _read_table
    ], [lambda p: write_tum(p, _TRAJECTORY), lambda p: write_kitti(p, _POSES), _TIMES, _TABLE]),
    "calib.json": Reader("calib.json", [_read_calibration], [_of_run("calib.json")]),
    "calib.txt": Reader("calib.txt", [
        _matrix("P2"), _matrix("Tr"), lambda p: Calibration(p, "restore it").transform("Tr")
    ], ["P2: 60 0 48 -30 0 60 20 0 0 0 1 0\nTr: 0 -1 0 0.02 0 0 -1 -0.06 1 0 0 -0.3\n"]),
    "tracks": Reader("tracks.csv", [read_tracks], [_of_run("tracks.csv")]),
    "docdepth.yaml": Reader("docdepth.yaml", [
        lambda p: read_settings(p.parent, RecordingSettings)
    ], [_SETTINGS]),
    "parameters": Reader("settings.yaml", [read_config], [_CONFIG]),
    "run.yaml": Reader("run.yaml", [read_config, lambda p: states(RunFolder.open(p.parent))],
                       [_of_run("run.yaml")]),
    "records": Reader("content", [_read_records], [_of_run(name) for name in _NOTES]),
    "message": Reader("message", [_read_points, _read_image],
                      [_message_bytes(False), _message_bytes(True)]),
    "ros1": Reader("a.bag", [_read_bag], [_bag("ros1")]),
    "mcap": Reader("a.mcap", [_read_bag], [_bag("mcap")]),
    "depth": Reader("a.img", [_depth_as(".png"), _depth_as(".tiff")],
                    [_of_run("depth/000001.png")]),
}  # fmt: skip
