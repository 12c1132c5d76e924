"""Open3D geometries of a run: classified points, trajectory, cameras and a depth map."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import InputError, MissingExtraError
from docdepth.geometry.camera import Camera
from docdepth.geometry.points import DYNAMIC, STATIC
from docdepth.geometry.se3 import inverse
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.depth import DESCRIPTION, maps_in, read_depth
from docdepth.io.run_folder import RunFolder
from docdepth.visualization.pictures import (
    DYNAMIC_COLOR,
    GROUND_COLOR,
    STATIC_COLOR,
    colorize,
)

# Length of a drawn camera frustum [m].
_FRUSTUM = 0.5
_TRAJECTORY_COLOR = (1.0, 0.75, 0.0)
_CAMERA_COLOR = (0.1, 0.5, 1.0)


@dataclass(frozen=True)
class CameraView:
    """A camera in the world, with or without a depth map.

    Attributes
    ----------
    camera : Camera
    T_world_camera : ndarray of float64, shape (4, 4)
    depth : ndarray of float32, shape (h, w), optional
        Metres along the optical axis; NaN = none.
    image : ndarray of uint8, shape (h, w, 3), optional
        Rectified, BGR; colours the points of the depth map.
    """

    camera: Camera
    T_world_camera: NDArray[np.float64]
    depth: NDArray[np.float32] | None = None
    image: NDArray[np.uint8] | None = None


def back_project(camera: Camera, depth: NDArray[np.float32]) -> NDArray[np.float64]:
    """3D points of the pixels with depth.

    Parameters
    ----------
    camera : Camera
    depth : ndarray of float32, shape (h, w)
        Metres along the optical axis; NaN = none.

    Returns
    -------
    ndarray of float64, shape (k, 3)
        Camera frame [m], row by row.
    """
    if depth.shape != (camera.height, camera.width):
        raise InputError(
            f"depth {depth.shape} does not fit the camera, {camera.height} x {camera.width}"
        )
    v, u = np.nonzero(np.isfinite(depth))
    z = depth[v, u].astype(np.float64)
    fx, fy, cx, cy = camera.K[[0, 1, 0, 1], [0, 1, 2, 2]]
    return np.column_stack([(u - cx) / fx * z, (v - cy) / fy * z, z])


def class_colors(classid: NDArray[np.uint16]) -> NDArray[np.float64]:
    """RGB colour of each point by its class, float64 (N, 3), 0..1."""
    palette = np.array([GROUND_COLOR, STATIC_COLOR, DYNAMIC_COLOR], np.float64)[:, ::-1] / 255
    return palette[(classid >= STATIC).astype(int) + (classid >= DYNAMIC)]


def scene_geometries(
    points: NDArray[np.float32],
    classid: NDArray[np.uint16],
    poses: NDArray[np.float64] | None = None,
    views: Sequence[CameraView] = (),
) -> dict[str, Any]:
    """Open3D geometries of a classified sweep or map, a trajectory and cameras.

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)
        World frame [m].
    classid : ndarray of uint16, shape (N,)
        Below 50 ground, below 100 static, else dynamic.
    poses : ndarray of float64, shape (n, 4, 4), optional
        ``T_world_lidar``, drawn as a line.
    views : sequence of CameraView
        Drawn as frusta; their depth maps are back-projected, in the colours of the image or else
        of the depth.

    Returns
    -------
    dict of str to open3d.geometry.Geometry
        ``points``, ``trajectory``, ``camera 0`` ..., ``depth 0`` ..., world frame.

    Raises
    ------
    InputError
        There is not one class per point, or a depth map does not fit its camera.
    MissingExtraError
        Open3D is not installed.
    """
    o3d = open3d_module()
    if points.ndim != 2 or points.shape[1] != 3 or classid.shape != points.shape[:1]:
        raise InputError(f"points {points.shape} and classes {classid.shape} must be (N, 3), (N,)")
    finite = np.isfinite(points).all(axis=1)
    geometries = {"points": _cloud(o3d, points[finite], class_colors(classid[finite]))}
    if poses is not None and len(poses) > 1:
        ends = np.column_stack([np.arange(len(poses) - 1), np.arange(1, len(poses))])
        line = o3d.geometry.LineSet(
            o3d.utility.Vector3dVector(np.ascontiguousarray(poses[:, :3, 3])),
            o3d.utility.Vector2iVector(ends.astype(np.int32)),
        )
        line.paint_uniform_color(_TRAJECTORY_COLOR)
        geometries["trajectory"] = line
    for k, view in enumerate(views):
        frustum = o3d.geometry.LineSet.create_camera_visualization(
            view.camera.width,
            view.camera.height,
            view.camera.K,
            inverse(view.T_world_camera),
            scale=_FRUSTUM,
        )
        frustum.paint_uniform_color(_CAMERA_COLOR)
        geometries[f"camera {k}"] = frustum
        if view.depth is not None:
            T, local = view.T_world_camera, back_project(view.camera, view.depth)
            picture = colorize(view.depth, bar=False) if view.image is None else view.image
            colors = picture[np.isfinite(view.depth)][:, ::-1] / 255.0
            geometries[f"depth {k}"] = _cloud(o3d, local @ T[:3, :3].T + T[:3, 3], colors)
    return geometries


def run_geometries(
    run: RunFolder,
    frame: int | None = None,
    camera: str | None = None,
    around: int = 0,
    depth: bool = True,
) -> dict[str, Any]:
    """Geometries of a run folder: see :func:`view_run` for the arguments."""
    trajectory = run.trajectory()
    count = len(trajectory)
    frame = count // 2 if frame is None else frame
    if not 0 <= frame < count:
        raise InputError(f"{run.path} has sweeps 0 to {count - 1}, not {frame}")
    merged, classes = [], []
    for k in range(max(frame - around, 0), min(frame + around + 1, count)):
        record, classid = run.classified_frame(k)
        pose = trajectory.poses[k]
        # Moving objects of other sweeps would leave trails.
        kept = np.ones(len(classid), bool) if k == frame else classid < DYNAMIC
        merged.append((record.points[kept] @ pose[:3, :3].T + pose[:3, 3]).astype(np.float32))
        classes.append(classid[kept])
    views = _camera_views(run, trajectory, frame, camera) if depth else []
    return scene_geometries(
        np.concatenate(merged), np.concatenate(classes), trajectory.poses, views
    )


def _camera_views(
    run: RunFolder, trajectory: Trajectory, frame: int, camera: str | None
) -> list[CameraView]:
    """The pose of each image of a camera; the one nearest to the sweep has its depth map."""
    if not maps_in(run.path / "depth") and not run.cameras:
        return []
    folder = run.depth_folder(camera)
    pinhole, T_camera_lidar, _ = run.calibration(folder)
    files = maps_in(run.path / "depth" / folder)
    maps = json.loads((run.path / "depth" / folder / DESCRIPTION).read_text())["maps"]
    times = {name: int(known["time_ns"]) for name, known in maps.items() if name in files}
    if not times:
        return []
    nearest = min(times, key=lambda name: abs(times[name] - int(trajectory.times[frame])))
    poses = trajectory.interpolate(list(times.values())) @ inverse(T_camera_lidar)
    return [
        CameraView(pinhole, pose, read_depth(files[name]) if name == nearest else None)
        for name, pose in zip(times, poses, strict=True)
    ]


def _cloud(o3d: Any, points: NDArray[Any], colors: NDArray[np.float64]) -> Any:
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points.astype(np.float64)))
    cloud.colors = o3d.utility.Vector3dVector(colors)
    return cloud


def open3d_module() -> Any:
    """Open3D, imported when it is needed.

    Raises
    ------
    MissingExtraError
        It, or a system library that it needs, is not installed.
    """
    try:
        import open3d
    except ImportError as error:
        raise MissingExtraError(
            f'the 3D view needs Open3D: pip install "docdepth[viz]" ({error}; on Debian also '
            "apt install libusb-1.0-0 libgl1 libgomp1)"
        ) from None
    return open3d
