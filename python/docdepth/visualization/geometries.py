"""A scene of a drive as geometries of Open3D."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.base import CameraStream
from docdepth.errors import InputError, MissingExtraError
from docdepth.geometry.se3 import inverse
from docdepth.geometry.track import Track
from docdepth.io.run_folder import RunFolder
from docdepth.io.tracks import tracks_in
from docdepth.visualization.drive_scene import (
    CameraView,
    Coloring,
    back_project,
    camera_views,
    class_colors,
    sweep_scene,
)
from docdepth.visualization.image_views import BOX_EDGES, box_corners, track_color
from docdepth.visualization.pictures import Picture, colorize

# Length of a drawn camera frustum [m].
_FRUSTUM = 2.0
_TRAJECTORY_COLOR = (1.0, 0.75, 0.0)
_CAMERA_COLOR = (0.1, 0.5, 1.0)


def scene_geometries(
    points: NDArray[np.float32],
    classid: NDArray[np.uint16],
    poses: NDArray[np.float64] | None = None,
    views: Sequence[CameraView] = (),
    colors: NDArray[np.float64] | None = None,
    boxes: Sequence[tuple[Track, NDArray[np.float64]]] = (),
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
        Drawn as frusta, with the image in the frustum; their depth maps are back-projected, in the
        colours of the image or else of the depth.
    colors : ndarray of float64, shape (N, 3), optional
        RGB of the points, 0..1; by class if absent.
    boxes : sequence of (Track, ndarray of float64, shape (4, 4))
        Tracks and ``T_world_object``.

    Returns
    -------
    dict of str to open3d.geometry.Geometry
        ``points``, ``tracks``, ``trajectory``, ``camera 0`` ..., ``image 0`` ..., ``depth 0`` ...,
        world frame.

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
    colors = class_colors(classid) if colors is None else colors
    geometries = {"points": _cloud(o3d, points[finite], colors[finite])}
    if boxes:
        geometries["tracks"] = _boxes(o3d, boxes)
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
        if view.image is not None:
            geometries[f"image {k}"] = _picture(o3d, view, view.image)
    return geometries


def run_geometries(
    run: RunFolder,
    frame: int | None = None,
    camera: str | None = None,
    around: int = 0,
    depth: bool = True,
    color: Coloring = "class",
    stream: CameraStream | None = None,
) -> dict[str, Any]:
    """Geometries of a sweep of a run: see :func:`view_run` for the arguments."""
    trajectory = run.trajectory()
    count = len(trajectory)
    frame = count // 2 if frame is None else frame
    if not 0 <= frame < count:
        raise InputError(f"{run.path} has sweeps 0 to {count - 1}, not {frame}")
    scene = sweep_scene(run, trajectory, frame, color, tracks_in(run.path), around)
    time = int(trajectory.times[frame])
    views = camera_views(run, trajectory, camera, stream, time) if depth else ()
    T = scene.T_world_lidar
    return scene_geometries(
        (scene.points @ T[:3, :3].T + T[:3, 3]).astype(np.float32),
        scene.classid,
        trajectory.poses,
        [view for _, view in views],
        scene.colors,
        scene.boxes,
    )


def _cloud(o3d: Any, points: NDArray[Any], colors: NDArray[np.float64]) -> Any:
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points.astype(np.float64)))
    cloud.colors = o3d.utility.Vector3dVector(colors)
    return cloud


def _boxes(o3d: Any, boxes: Sequence[tuple[Track, NDArray[np.float64]]]) -> Any:
    """The edges of the boxes, in the colours of the tracks, each with a line ahead."""
    points, edges, colors = [], [], []
    for k, (track, T_world_object) in enumerate(boxes):
        nose = np.array([(0.5, 0, 0.5), (1.0, 0, 0.5)]) * track.size
        local = np.concatenate([box_corners(track), nose])
        points.append(local @ T_world_object[:3, :3].T + T_world_object[:3, 3])
        edges.append(np.array([*BOX_EDGES, (8, 9)]) + 10 * k)
        colors += [track_color(track.id)[::-1]] * (len(BOX_EDGES) + 1)
    lines = o3d.geometry.LineSet(
        o3d.utility.Vector3dVector(np.concatenate(points)),
        o3d.utility.Vector2iVector(np.concatenate(edges).astype(np.int32)),
    )
    lines.colors = o3d.utility.Vector3dVector(np.array(colors) / 255)
    return lines


def _picture(o3d: Any, view: CameraView, image: Picture) -> Any:
    """The image at the end of its frustum."""
    camera, T = view.camera, view.T_world_camera
    corners = np.array(
        [(0, 0), (camera.width, 0), (camera.width, camera.height), (0, camera.height)]
    )
    local = np.column_stack([corners - 0.5, np.ones(4)]) @ np.linalg.inv(camera.K).T
    world = _FRUSTUM * local @ T[:3, :3].T + T[:3, 3]
    rectangle = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(world),
        o3d.utility.Vector3iVector(np.array([(0, 1, 2), (0, 2, 3)], np.int32)),
    )
    places = np.array([(0, 0), (1, 0), (1, 1), (0, 0), (1, 1), (0, 1)], np.float64)
    rectangle.triangle_uvs = o3d.utility.Vector2dVector(places)
    rectangle.triangle_material_ids = o3d.utility.IntVector([0, 0])
    rectangle.textures = [o3d.geometry.Image(np.ascontiguousarray(image[:, :, ::-1]))]
    return rectangle


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
