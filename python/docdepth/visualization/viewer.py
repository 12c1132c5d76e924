"""Shows a run in 3D with Open3D, in a window or as an image."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import InitVar, dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias, get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.base import CameraStream
from docdepth.errors import BackendError, InputError, MissingExtraError, RunError
from docdepth.geometry.se3 import inverse, transform_points
from docdepth.geometry.track import BOX_EDGES, Track
from docdepth.io.atomic import replace_output
from docdepth.io.run_folder import RunFolder
from docdepth.io.tracks import tracks_in
from docdepth.visualization.drive_scene import (
    CameraView,
    Coloring,
    back_project,
    camera_views,
    sweep_scene,
)
from docdepth.visualization.image_views import track_color, write_text
from docdepth.visualization.pictures import colorize

Scene: TypeAlias = tuple[dict[str, object], NDArray[np.float64]]
"""Geometries, and the pose of the LiDAR that they belong to."""

_FRUSTUM = 2.0  # length of a camera's frustum [m]
_TRAJECTORY_COLOR, _CAMERA_COLOR = (1.0, 0.75, 0.0), (0.1, 0.5, 1.0)
_STEPS = {262: 1, 263: -1, 266: -10, 267: 10}  # GLFW: right, left, page up, page down
_BACKGROUND = (0.09, 0.09, 0.09)
_POINT_SIZE = 2.0  # pixels
_WINDOW, _IMAGE = (1200, 700), (1600, 900)  # pixels; the window fits on a small screen
_LINE = 24  # between two lines of text [pixels]
_POINTS = {
    "class": "blue ground, light grey static, orange moving",
    "votes": "light grey static to orange moving, dark without votes",
    "instance": "coloured as their boxes, dark without an instance",
}
_DOWN = 0.3  # how far the viewer looks down [rad]
_T_LIDAR_VIEWER = np.array([
    (0, -np.sin(_DOWN), np.cos(_DOWN), -14.0),
    (-1, 0, 0, 0),
    (0, -np.cos(_DOWN), -np.sin(_DOWN), 7.0),
    (0, 0, 0, 1),
])  # fmt: skip


@dataclass
class RunView:
    """A sweep of a run in 3D, with tracks, trajectory, cameras and a depth map.

    Ground is blue, static points are light grey, dynamic points orange. Boxes have the colours of
    their tracks, with a line ahead. The depth map nearest in time to the sweep is back-projected,
    in the colours of its image or else of depth. The image stands in its frustum.
    """

    run: RunFolder  # with classified sweeps
    frame: InitVar[int | None] = None  # index of the sweep; the middle of the drive by default
    camera: str | None = None  # whose depth map; needed if the run has several
    around: int = 0  # also show the static points of as many sweeps before and after
    depth: bool = True  # show cameras and the depth map
    # what the colours of points say. Votes go from grey, static, to orange, dynamic
    color: Coloring = "class"
    stream: CameraStream | None = None  # the camera; its images are shown
    # called with what is shown, whenever that changes: Open3D writes no text into its window
    tell: Callable[[str], None] | None = None

    def __post_init__(self, frame: int | None) -> None:
        self.trajectory, self.tracks = self.run.trajectory(), tracks_in(self.run.path)
        count = len(self.trajectory)
        self.index = count // 2 if frame is None else frame
        if not 0 <= self.index < count:
            raise InputError(f"{self.run.path} has sweeps 0 to {count - 1}, not {frame}")

    def show(self, image: Path | None = None) -> None:
        """Show it in a window, or write a PNG of it, as :func:`show` does.

        Keys: right and left go to the next sweep and back, page down and page up by ten, C colours
        by class, votes or instance, D hides the depth map.
        """
        geometries, pose = self.go(0)
        keys: dict[int, Callable[[], Scene]] = {
            key: partial(self.go, by) for key, by in _STEPS.items()
        }
        keys |= {ord("C"): self.recolor, ord("D"): self.hide_depth}
        show(geometries, pose, image, keys, self.legend(geometries))

    def go(self, by: int) -> Scene:
        """Go on by some sweeps, not beyond the ends."""
        trajectory = self.trajectory
        self.index = min(max(self.index + by, 0), len(trajectory) - 1)
        scene = sweep_scene(self.run, trajectory, self.index, self.color, self.tracks, self.around)
        views: list[CameraView] = []
        if self.depth:
            time = int(trajectory.times[self.index])
            found = camera_views(self.run, trajectory, self.camera, self.stream, time)
            views = [view for _, view in found]
        T = scene.T_world_lidar
        points = transform_points(T, scene.points).astype(np.float32)
        geometries = scene_geometries(points, scene.colors, trajectory.poses, views, scene.boxes)
        if self.tell:
            self.tell("; ".join(self.legend(geometries)))
        return geometries, T

    def recolor(self) -> Scene:
        """Colour points by the next of class, votes and instance that the run has."""
        colorings: tuple[Coloring, ...] = get_args(Coloring)
        for _ in colorings:
            self.color = colorings[(colorings.index(self.color) + 1) % len(colorings)]
            with contextlib.suppress(InputError):
                return self.go(0)
        return self.go(0)

    def hide_depth(self) -> Scene:
        """Hide the depth map and its camera, or show them again."""
        self.depth = not self.depth
        return self.go(0)

    def legend(self, geometries: Mapping[str, Any]) -> list[str]:
        """What is shown and what its colours say, line by line."""
        times = self.trajectory.times
        seconds = (times[self.index] - times[0]) * 1e-9
        lines = [
            f"sweep {self.index} of 0 to {len(times) - 1}, {seconds:.1f} s",
            f"points by {self.color}: {_POINTS[self.color]}",
        ]
        if "tracks" in geometries:
            lines.append("boxes: tracks, each with a line ahead; yellow: path of the LiDAR")
        if "image 0" in geometries:
            lines.append("depth map of the camera in the colours of its image")
        elif "depth 0" in geometries:
            lines.append("depth map of the camera: yellow is near, violet far")
        return lines


def scene_geometries(
    points: NDArray[np.float32],
    colors: NDArray[np.float64],
    poses: NDArray[np.float64] | None = None,
    views: Sequence[CameraView] = (),
    boxes: Sequence[tuple[Track, NDArray[np.float64]]] = (),
) -> dict[str, object]:
    """Open3D geometries of a sweep or map, a trajectory, cameras and tracks.

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)
        World frame [m].
    colors : ndarray of float64, shape (N, 3)
        RGB of the points, 0..1.
    poses : ndarray of float64, shape (n, 4, 4), optional
        ``T_world_lidar``, drawn as a line.
    views : sequence of CameraView
        Drawn as frusta, with the image in the frustum; their depth maps are back-projected, in the
        colours of the image or else of the depth.
    boxes : sequence of (Track, ndarray of float64, shape (4, 4))
        Tracks and ``T_world_object``.

    Returns
    -------
    dict of str to open3d.geometry.Geometry
        ``points``, ``tracks``, ``trajectory``, ``camera 0`` ..., ``image 0`` ..., ``depth 0`` ...,
        world frame.
    """
    o3d = _open3d_module()
    geometries = {"points": _cloud(o3d, points, colors)}
    if boxes:
        geometries["tracks"] = _boxes(o3d, boxes)
    if poses is not None and len(poses) > 1:
        ends = np.column_stack([np.arange(len(poses) - 1), np.arange(1, len(poses))])
        geometries["trajectory"] = _lines(o3d, np.ascontiguousarray(poses[:, :3, 3]), ends)
        geometries["trajectory"].paint_uniform_color(_TRAJECTORY_COLOR)
    for k, view in enumerate(views):
        camera, T = view.camera, view.T_world_camera
        frustum = o3d.geometry.LineSet.create_camera_visualization(
            camera.width, camera.height, camera.K, inverse(T), scale=_FRUSTUM
        )
        frustum.paint_uniform_color(_CAMERA_COLOR)
        geometries[f"camera {k}"] = frustum
        if view.depth is not None:
            local = back_project(camera, view.depth)
            picture = colorize(view.depth, bar=False) if view.image is None else view.image
            tones = picture[np.isfinite(view.depth)][:, ::-1] / 255.0
            geometries[f"depth {k}"] = _cloud(o3d, transform_points(T, local), tones)
        if view.image is not None:
            geometries[f"image {k}"] = _picture(o3d, view)
    return geometries


def _cloud(o3d: Any, points: NDArray[Any], colors: NDArray[np.float64]) -> Any:
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points.astype(np.float64)))
    cloud.colors = o3d.utility.Vector3dVector(colors)
    return cloud


def _lines(o3d: Any, points: NDArray[np.float64], ends: NDArray[np.integer[Any]]) -> Any:
    """Lines between pairs of points."""
    return o3d.geometry.LineSet(
        o3d.utility.Vector3dVector(points), o3d.utility.Vector2iVector(ends.astype(np.int32))
    )


def _boxes(o3d: Any, boxes: Sequence[tuple[Track, NDArray[np.float64]]]) -> Any:
    """The edges of the boxes, in the colours of the tracks, each with a line ahead."""
    points, edges, colors = [], [], []
    for k, (track, T_world_object) in enumerate(boxes):
        nose = np.array([(0.5, 0, 0.5), (1.0, 0, 0.5)]) * track.size
        local = np.concatenate([track.corners, nose])
        points.append(transform_points(T_world_object, local))
        edges.append(np.array([*BOX_EDGES, (8, 9)]) + 10 * k)
        colors += [track_color(track.id)[::-1]] * (len(BOX_EDGES) + 1)
    lines = _lines(o3d, np.concatenate(points), np.concatenate(edges))
    lines.colors = o3d.utility.Vector3dVector(np.array(colors) / 255)
    return lines


def _picture(o3d: Any, view: CameraView) -> Any:
    """The image at the end of its frustum."""
    T, (width, height) = view.T_world_camera, (view.camera.width, view.camera.height)
    corners = np.array([(0, 0), (width, 0), (width, height), (0, height)])
    local = np.column_stack([corners - 0.5, np.ones(4)]) @ np.linalg.inv(view.camera.K).T
    rectangle = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(transform_points(T, _FRUSTUM * local)),
        o3d.utility.Vector3iVector(np.array([(0, 1, 2), (0, 2, 3)], np.int32)),
    )
    places = np.array([(0, 0), (1, 0), (1, 1), (0, 0), (1, 1), (0, 1)], np.float64)
    rectangle.triangle_uvs = o3d.utility.Vector2dVector(places)
    rectangle.triangle_material_ids = o3d.utility.IntVector([0, 0])
    assert view.image is not None
    rectangle.textures = [o3d.geometry.Image(np.ascontiguousarray(view.image[:, :, ::-1]))]
    return rectangle


def show(
    geometries: dict[str, object],
    T_world_lidar: NDArray[np.float64],
    image: Path | None = None,
    keys: Mapping[int, Callable[[], Scene]] | None = None,
    legend: Sequence[str] = (),
) -> None:
    """Show Open3D geometries in a window, or write a PNG of them.

    Parameters
    ----------
    geometries : dict of str to open3d.geometry.Geometry
        From :func:`scene_geometries`.
    T_world_lidar : ndarray of float64, shape (4, 4)
        The view starts behind and above this pose.
    image : Path, optional
        Write a PNG instead of opening a window; needs no display.
    keys : mapping of int to callable, optional
        Give other geometries and their pose when a key (GLFW's number) is pressed. The view follows
        the pose.
    legend : sequence of str
        Lines of text for the PNG.
    """
    o3d = _open3d_module()
    if image is None and not _has_display():
        raise BackendError(
            "no display to open a window on (DISPLAY is not set); write an image instead"
        )
    if image is not None:  # without a display Open3D warns of it, and then draws all the same
        o3d.utility.set_verbosity_level(o3d.utility.VerbosityLevel.Error)
    window = o3d.visualization.VisualizerWithKeyCallback()
    width, height = _WINDOW if image is None else _IMAGE
    if not window.create_window("docdepth", width, height, visible=image is None):
        raise BackendError("Open3D cannot render here: neither a display nor EGL is available")
    shown = [(geometries, T_world_lidar)]

    def press(change: Callable[[], Scene], window: Any) -> bool:
        shown.append(change())
        exchange(window, shown.pop(0), shown[0])
        return True

    try:
        for geometry in geometries.values():
            window.add_geometry(geometry)
        options = window.get_render_option()
        options.background_color, options.point_size = np.array(_BACKGROUND), _POINT_SIZE
        options.mesh_show_back_face = True  # images are seen from behind their cameras
        _look_from(window, T_world_lidar @ _T_LIDAR_VIEWER)
        for key, change in (keys or {}).items():
            window.register_key_callback(key, partial(press, change))
        if image is None:
            window.run()
        else:
            window.poll_events()
            window.update_renderer()
            _capture(window, image, legend)
    finally:
        window.destroy_window()


def exchange(window: Any, old: Scene, new: Scene) -> None:
    """Replace the geometries in a window; the view stays where it was, seen from the LiDAR."""
    T_lidar_viewer = inverse(old[1]) @ inverse(_view_of(window).extrinsic)
    for geometry in old[0].values():
        window.remove_geometry(geometry, reset_bounding_box=False)
    for geometry in new[0].values():
        window.add_geometry(geometry, reset_bounding_box=False)
    _look_from(window, new[1] @ T_lidar_viewer)


def _view_of(window: Any) -> Any:
    return window.get_view_control().convert_to_pinhole_camera_parameters()


def _look_from(window: Any, T_world_viewer: NDArray[np.float64]) -> None:
    view = _view_of(window)
    view.extrinsic = inverse(T_world_viewer)
    window.get_view_control().convert_from_pinhole_camera_parameters(view, allow_arbitrary=True)


def _capture(window: Any, image: Path, legend: Sequence[str]) -> None:
    """Write what a window shows and a legend; Open3D itself reports no failure."""
    part = image.with_name(f".{image.stem}.part{image.suffix}")
    try:
        window.capture_screen_image(str(part), do_render=True)
        picture = cv2.imread(str(part))
        if picture is not None:
            for k, line in enumerate(legend, start=1):
                write_text(picture, line, (12, k * _LINE), (255, 255, 255))
            cv2.imwrite(str(part), picture)
        replace_output(part, image)
    except OSError:
        raise RunError(
            f"{image} cannot be written; name a .png file in a folder that is there"
        ) from None
    finally:
        part.unlink(missing_ok=True)


def _has_display() -> bool:
    names = ("DISPLAY", "WAYLAND_DISPLAY")
    return not sys.platform.startswith("linux") or any(os.environ.get(name) for name in names)


def _open3d_module() -> Any:
    try:
        import open3d
    except ImportError as error:
        raise MissingExtraError(
            f'the 3D view needs Open3D: pip install "docdepth[viz]" ({error}; on Debian also '
            "apt install libusb-1.0-0 libgl1 libgomp1)"
        ) from None
    return open3d
