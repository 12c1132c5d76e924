"""A run as a ROS 2 bag in an MCAP file: Foxglove and RViz show it, ROS nodes read it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from docdepth.concurrency import Progress, null_progress
from docdepth.datasets.files import extra
from docdepth.geometry.lidar_frame import LidarFrame
from docdepth.geometry.se3 import inverse, matrix_to_quaternion
from docdepth.geometry.track import Track
from docdepth.io.images import encode_image
from docdepth.pipeline.run_reader import Run, RunImage

_WORLD, _LIDAR = "world", "lidar"
_FIELDS = {"x": "<f4", "y": "<f4", "z": "<f4", "class": "<u2", "instance": "<u2"}
_POINT = np.dtype([*_FIELDS.items()])
_FIELD_TYPES = {"<f4": 7, "<u2": 4}  # of PointField
_CUBE, _DELETE_ALL = 1, 3  # of Marker
_COLORS = {"vehicle": (1.0, 0.5, 0.1), "person": (0.9, 0.1, 0.3), "other": (0.6, 0.4, 0.9)}
_METADATA_VERSION = 9  # of the YAML file beside the MCAP file


def write_mcap(run: Run, output: Path, progress: Progress = null_progress) -> int:
    """Write a bag with the sweeps and images of a run, each at its time.

    - ``/tf``: ``T_world_lidar`` at each sweep and image; ``/tf_static``: the cameras on the LiDAR;
    - ``/points``: deskewed sweeps in the frame ``lidar``, with ``class`` and ``instance``;
    - ``/objects``: the boxes of the tracks at each sweep, in the frame ``world``;
    - ``/CAMERA/image/compressed``: photos without lens distortion, as PNG;
    - ``/CAMERA/depth``: float32 metres along the optical axis, NaN without depth;
    - ``/CAMERA/camera_info``.
    """
    extra("rosbags", "MCAP needs rosbags", "bags")
    from rosbags.rosbag2 import StoragePlugin, Writer

    if output.is_dir():
        output.rmdir()  # an empty one; the writer makes its own
    cameras, times = list(run.cameras.values()), run.trajectory.times
    sweeps = [(int(time), 0, k) for k, time in enumerate(times)]
    images = [(int(t), n, k) for n, of in enumerate(cameras, 1) for k, t in enumerate(of.times)]
    events = sorted(sweeps + images)
    with Writer(output, version=_METADATA_VERSION, storage_plugin=StoragePlugin.MCAP) as writer:
        bag = _Bag(writer)
        bag.write_transforms("/tf_static", events[0][0], {
            camera.name: (_LIDAR, inverse(camera.T_camera_lidar)) for camera in cameras
        })  # fmt: skip
        for done, (time, of, index) in enumerate(events, 1):
            pose = run.trajectory.interpolate(time)[0]
            bag.write_transforms("/tf", time, {_LIDAR: (_WORLD, pose)})
            if of:
                bag.write_image(cameras[of - 1][index])
            else:
                bag.write_points(time, run.sweeps[index])
                bag.write_boxes(time, run.tracks.between(time, time))
            progress("convert", done, len(events))
    return len(images)


class _Bag:
    """A bag to which messages are written. They are given as dicts; what is left out is 0."""

    def __init__(self, writer: Any) -> None:
        from rosbags.typesys import Stores, get_typestore

        self._writer, self._types = writer, get_typestore(Stores.ROS2_HUMBLE)
        self._connections: dict[str, object] = {}

    def write_transforms(
        self, topic: str, time: int, frames: dict[str, tuple[str, NDArray[np.float64]]]
    ) -> None:
        """Where frames are: by the name of each its parent, and its pose in there."""
        transforms = [
            {
                "header": _header(time, parent),
                "child_frame_id": name,
                "transform": dict(zip(("translation", "rotation"), _pose(T), strict=True)),
            }
            for name, (parent, T) in frames.items()
        ]
        self._write(topic, time, "tf2_msgs/msg/TFMessage", {"transforms": transforms})

    def write_points(self, time: int, frame: LidarFrame) -> None:
        """A sweep."""
        rows = np.zeros(len(frame), _POINT)
        rows["x"], rows["y"], rows["z"] = frame.points.T
        rows["class"] = frame.classes
        rows["instance"] = 0 if frame.instance is None else frame.instance
        offsets = np.cumsum([0, *(np.dtype(kind).itemsize for kind in _FIELDS.values())]).tolist()
        fields = [
            {"name": name, "offset": offset, "datatype": _FIELD_TYPES[kind], "count": 1}
            for (name, kind), offset in zip(_FIELDS.items(), offsets, strict=False)
        ]
        cloud = {
            "header": _header(time, _LIDAR),
            "height": 1,
            "width": len(rows),
            "fields": fields,
            "point_step": _POINT.itemsize,
            "row_step": rows.nbytes,
            "data": rows.view(np.uint8),
            "is_dense": True,
        }
        self._write("/points", time, "sensor_msgs/msg/PointCloud2", cloud)

    def write_boxes(self, time: int, tracks: list[Track]) -> None:
        """The boxes of tracks, in place of those before."""
        markers: list[dict[str, object]] = [{"action": _DELETE_ALL}]
        for track in tracks:
            T = track.pose_at(time).copy()
            T[:3, 3] += T[:3, 2] * track.size[2] / 2  # a track has its origin at the bottom
            place, rotation = _pose(T)
            markers.append({
                "header": _header(time, _WORLD),
                "ns": track.kind,
                "id": track.id,
                "type": _CUBE,
                "pose": {"position": place, "orientation": rotation},
                "scale": _named("xyz", track.size),
                "color": _named("rgba", (*_COLORS[track.kind], 0.5)),
            })  # fmt: skip
        self._write("/objects", time, "visualization_msgs/msg/MarkerArray", {"markers": markers})

    def write_image(self, image: RunImage) -> None:
        """An image with its depth and its camera."""
        camera, time, depth, photo = image.camera, image.time, image.depth, image.image
        header, name = _header(time, image.of.name), f"/{image.of.name}"
        size = {"header": header, "height": camera.height, "width": camera.width}
        K, P = camera.K, np.eye(3, 4)
        P[:, :3] = K
        lens = {"distortion_model": "plumb_bob", "d": np.zeros(5), "k": K, "r": np.eye(3), "p": P}
        self._write(f"{name}/camera_info", time, "sensor_msgs/msg/CameraInfo", size | lens)
        pixels = {"encoding": "32FC1", "step": depth.strides[0], "data": depth.view(np.uint8)}
        self._write(f"{name}/depth", time, "sensor_msgs/msg/Image", size | pixels)
        if photo is not None:
            data = np.frombuffer(encode_image(photo[..., ::-1], ".png"), np.uint8)
            png: dict[str, object] = {"header": header, "format": "png", "data": data}
            self._write(f"{name}/image/compressed", time, "sensor_msgs/msg/CompressedImage", png)

    def _write(self, topic: str, time: int, kind: str, values: dict[str, object]) -> None:
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(
                topic, kind, typestore=self._types
            )
        content = self._types.serialize_cdr(self._message(kind, values), kind)
        self._writer.write(self._connections[topic], time, content)

    def _message(self, kind: str, values: dict[str, Any]) -> Any:
        fields = self._types.fielddefs[kind][1]
        return self._types.types[kind](
            **{name: self._value(node, of, values.get(name)) for name, (node, of) in fields}
        )

    def _value(self, node: Any, of: Any, value: Any) -> Any:
        """A field, by the library's description of its type."""
        if node.name == "NAME":
            return self._message(of, value or {})
        if node.name == "BASE":
            return value if value is not None else "" if of[0] == "string" else 0
        (member, kind), count = of
        if member.name == "NAME":
            return [self._message(kind, one) for one in value or []]
        given = np.zeros(count) if value is None else value
        return np.ascontiguousarray(given, kind[0]).reshape(-1)


def _header(time: int, frame: str) -> dict[str, object]:
    return {"stamp": {"sec": time // 10**9, "nanosec": time % 10**9}, "frame_id": frame}


def _named(names: str, values: ArrayLike) -> dict[str, float]:
    return dict(zip(names, np.asarray(values, np.float64).tolist(), strict=True))


def _pose(T: NDArray[np.float64]) -> tuple[dict[str, float], dict[str, float]]:
    """Position and rotation of a pose."""
    return _named("xyz", T[:3, 3]), _named("xyzw", matrix_to_quaternion(T[:3, :3]))
