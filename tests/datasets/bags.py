"""Writes bags by rosbags: messages as ROS drivers send them."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from docdepth.geometry.se3 import inverse, matrix_to_quaternion

KINDS = {"f4": 7, "f8": 8, "u1": 2, "u2": 4, "u4": 6, "i4": 5}


class BagWriter:
    """A bag of a kind: ``ros1``, ``db3`` or ``mcap``."""

    def __init__(self, path: Path, kind: str) -> None:
        pytest.importorskip("rosbags")
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self.path, self.ros1 = path, kind == "ros1"
        self.types = get_typestore(Stores.ROS1_NOETIC if self.ros1 else Stores.ROS2_HUMBLE)
        if self.ros1:
            text = "geometry_msgs/TransformStamped[] transforms"
            self.types.register(get_types_from_msg(text, "tf2_msgs/msg/TFMessage"))
        self._connections: dict[str, Any] = {}
        if path.is_dir():
            shutil.rmtree(path)
        path.unlink(missing_ok=True)
        if self.ros1:
            from rosbags.rosbag1 import Writer as Writer1

            self._bag: Any = Writer1(path)
        else:
            from rosbags import rosbag2

            if not hasattr(rosbag2, "StoragePlugin"):
                pytest.skip("the older rosbags of ouster-sdk writes bags of ROS 2 in another way")
            plugins = rosbag2.StoragePlugin
            plugin = plugins.MCAP if kind == "mcap" else plugins.SQLITE3
            self._bag = rosbag2.Writer(path, version=9, storage_plugin=plugin)

    def __enter__(self) -> BagWriter:
        self._bag.open()
        return self

    def __exit__(self, *_: object) -> None:
        self._bag.close()

    def write(self, topic: str, message: Any, time: int) -> None:
        kind = message.__msgtype__
        if topic not in self._connections:
            self._connections[topic] = self._bag.add_connection(topic, kind, typestore=self.types)
        serialize = self.types.serialize_ros1 if self.ros1 else self.types.serialize_cdr
        self._bag.write(self._connections[topic], time, serialize(message, kind))

    # ---- messages

    def make(self, kind: str, *values: Any) -> Any:
        return self.types.types[kind](*values)

    def stamp(self, time: int) -> Any:
        return self.make("builtin_interfaces/msg/Time", *divmod(time, 10**9))

    def header(self, time: int, frame: str) -> Any:
        first = [0] if self.ros1 else []
        return self.make("std_msgs/msg/Header", *first, self.stamp(time), frame)

    def cloud(self, rows: np.ndarray, time: int, frame: str = "lidar", big_endian: bool = False):
        """PointCloud2 of structured rows, at the offsets that they have."""
        if big_endian:
            rows = rows.astype(rows.dtype.newbyteorder(">"))
        fields = [
            self.make("sensor_msgs/msg/PointField", name, offset, KINDS[dtype.str[1:]], 1)
            for name, (dtype, offset) in (
                (name, rows.dtype.fields[name][:2]) for name in rows.dtype.names
            )
        ]
        step, data = rows.dtype.itemsize, np.frombuffer(rows.tobytes(), np.uint8)
        return self.make(
            "sensor_msgs/msg/PointCloud2", self.header(time, frame), 1, len(rows), fields,
            big_endian, step, step * len(rows), data, False,
        )  # fmt: skip

    def image(self, image: np.ndarray, time: int, frame: str = "camera", encoding: str = "bgr8"):
        height, width = image.shape[:2]
        data = np.ascontiguousarray(image).ravel()
        return self.make(
            "sensor_msgs/msg/Image", self.header(time, frame), height, width, encoding, 0,
            data.size // height, data,
        )  # fmt: skip

    def compressed(self, data: bytes, time: int, frame: str = "camera", format: str = "png"):
        return self.make(
            "sensor_msgs/msg/CompressedImage", self.header(time, frame), format,
            np.frombuffer(data, np.uint8),
        )  # fmt: skip

    def camera_info(
        self,
        K: np.ndarray,
        distortion: np.ndarray,
        size: tuple[int, int],
        time: int,
        model: str = "plumb_bob",
    ):
        roi = self.make("sensor_msgs/msg/RegionOfInterest", 0, 0, 0, 0, False)
        P = np.hstack([K, np.zeros((3, 1))])
        return self.make(
            "sensor_msgs/msg/CameraInfo", self.header(time, "camera"), size[1], size[0], model,
            np.array(distortion, float), K.ravel(), np.eye(3).ravel(), P.ravel(), 0, 0, roi,
        )  # fmt: skip

    def transform(self, child: str, parent: str, T_parent_child: np.ndarray, time: int = 0):
        x, y, z, w = matrix_to_quaternion(T_parent_child[:3, :3])
        vector = self.make("geometry_msgs/msg/Vector3", *T_parent_child[:3, 3].tolist())
        rotation = self.make("geometry_msgs/msg/Quaternion", x, y, z, w)
        transform = self.make("geometry_msgs/msg/Transform", vector, rotation)
        stamped = self.make(
            "geometry_msgs/msg/TransformStamped", self.header(time, parent), child, transform
        )
        return self.make("tf2_msgs/msg/TFMessage", [stamped])


def write_drive(path: Path, kind: str, truncated: int | None = None, **more: Any) -> Path:
    """The made-up drive as a bag; the cloud of frame ``truncated`` lacks its end.

    Clouds arrive 30 ms after their stamps, fields have gaps between them, and the frames of the
    LiDAR and the camera are connected by way of base_link.
    """
    from made_up import DISTORTION, DRIVE, SIZE, K

    late = 30_000_000
    T_base_lidar = inverse(DRIVE.poses[2])
    T_base_camera = T_base_lidar @ inverse(DRIVE.T_camera_lidar)
    with BagWriter(path, kind) as bag:
        for child, T in (("lidar", T_base_lidar), ("camera", T_base_camera)):
            message = bag.transform(child, "base_link", T)
            bag.write("/tf_static", message, int(DRIVE.times[0]))
        for k, time in enumerate(DRIVE.times.tolist()):
            cloud = bag.cloud(padded_rows(k), time)
            if k == truncated:
                cloud.data = cloud.data[:-999]
            bag.write("/points", cloud, time + late)
        for k, time in enumerate(DRIVE.image_times.tolist()):
            info = bag.camera_info(K, DISTORTION, SIZE, time)
            bag.write("/front/camera_info", info, time)
            bag.write("/front/image_raw", bag.image(DRIVE.image(k), time), time)
    return path


def padded_rows(k: int) -> np.ndarray:
    """Rows as an Ouster driver lays them out: gaps, and times in nanoseconds after the stamp."""
    from made_up import DRIVE

    rows = DRIVE.rows(k)
    columns = {"x": ("<f4", 0), "y": ("<f4", 4), "z": ("<f4", 8), "intensity": ("<f4", 16),
               "time": ("<f8", 24), "ring": ("<u2", 34)}  # fmt: skip
    table = np.zeros(
        len(rows),
        {
            "names": list(columns),
            "formats": [kind for kind, _ in columns.values()],
            "offsets": [offset for _, offset in columns.values()],
            "itemsize": 48,
        },
    )
    for name in ("x", "y", "z", "intensity", "ring"):
        table[name] = rows[name]
    table["time"] = DRIVE.seconds(k)
    return table
