"""Shows a run in 3D with Open3D, in a window or as an image."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias, get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.base import CameraStream
from docdepth.errors import BackendError, InputError, RunError
from docdepth.geometry.se3 import inverse
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.run_folder import RunFolder
from docdepth.visualization.drive_scene import Coloring
from docdepth.visualization.geometries import open3d_module, run_geometries
from docdepth.visualization.image_views import write_text

Scene: TypeAlias = tuple[dict[str, Any], NDArray[np.float64]]
"""Geometries, and the pose of the LiDAR that they belong to."""

_STEPS = {262: 1, 263: -1, 266: -10, 267: 10}  # GLFW: right, left, page up, page down
_BACKGROUND = (0.09, 0.09, 0.09)
_POINT_SIZE = 2.0  # pixels
_WINDOW = {"window_name": "docdepth", "width": 1200, "height": 700}  # fits on a small screen
_IMAGE = {"window_name": "docdepth", "width": 1600, "height": 900}
_LINE = 24  # between two lines of text [pixels]
_POINTS = {
    "class": "blue ground, light grey static, orange moving",
    "votes": "light grey static to orange moving, dark without votes",
    "instance": "coloured as their boxes, dark without an instance",
}
# Position of the viewer in the LiDAR frame [m], and how far it looks down [rad].
_VIEWER, _PITCH = (-14.0, 0.0, 7.0), 0.3


def view_run(
    run: Path | str | RunFolder,
    frame: int | None = None,
    camera: str | None = None,
    around: int = 0,
    depth: bool = True,
    image: Path | None = None,
    color: Coloring = "class",
    stream: CameraStream | None = None,
    tell: Callable[[str], None] | None = None,
) -> None:
    """Show a sweep of a run in a window, with tracks, trajectory, cameras and a depth map.

    Ground is blue, static points are light grey, dynamic points orange. Boxes have the colours of
    their tracks, with a line ahead. The depth map nearest in time to the sweep is back-projected,
    in the colours of its image or else of depth. The image stands in its frustum. Keys: right and
    left go to the next sweep and back, page down and page up by ten, C colours by class, votes or
    instance, D hides the depth map.

    Parameters
    ----------
    run : Path, str or RunFolder
        Run folder with classified sweeps.
    frame : int, optional
        Index of the sweep; the middle of the drive by default.
    camera : str, optional
        Whose depth map; needed if the run has several.
    around : int
        Also show the static points of as many sweeps before and after.
    depth : bool
        Show cameras and the depth map.
    image : Path, optional
        Write a PNG of the view instead of opening a window; needs no display.
    color : {"class", "votes", "instance"}
        What the colours of points say. Votes go from grey, static, to orange, dynamic.
    stream : CameraStream, optional
        The camera; its images are shown.
    tell : callable, optional
        Called with what the window shows, whenever that changes: Open3D writes no text into it.

    Raises
    ------
    BackendError
        There is no display.
    InputError
        The run has no such sweep, or no votes or instances.
    MissingExtraError
        Open3D is not installed.
    RunError
        The sweep is not classified.
    """
    folder = RunFolder.open(run)
    trajectory = folder.trajectory()
    frame = len(trajectory) // 2 if frame is None else frame
    shown = _Shown(folder, trajectory, frame, color, camera, around, depth, stream, tell)
    geometries, pose = shown.go(0)
    keys: dict[int, Callable[[], Scene]] = {
        key: partial(shown.go, by) for key, by in _STEPS.items()
    }
    keys |= {ord("C"): shown.recolor, ord("D"): shown.hide_depth}
    show(geometries, pose, image, keys, shown.legend(geometries))


@dataclass
class _Shown:
    """What a window shows of a run."""

    run: RunFolder
    trajectory: Trajectory
    frame: int
    color: Coloring
    camera: str | None
    around: int
    depth: bool
    stream: CameraStream | None
    tell: Callable[[str], None] | None

    def go(self, by: int) -> Scene:
        """Go on by some sweeps, not beyond the ends."""
        poses = self.trajectory.poses
        if by:
            self.frame = min(max(self.frame + by, 0), len(poses) - 1)
        geometries = run_geometries(
            self.run, self.frame, self.camera, self.around, self.depth, self.color, self.stream
        )
        if self.tell:
            self.tell("; ".join(self.legend(geometries)))
        return geometries, poses[self.frame]

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
        seconds = (times[self.frame] - times[0]) * 1e-9
        lines = [
            f"sweep {self.frame} of 0 to {len(times) - 1}, {seconds:.1f} s",
            f"points by {self.color}: {_POINTS[self.color]}",
        ]
        if "tracks" in geometries:
            lines.append("boxes: tracks, each with a line ahead; yellow: path of the LiDAR")
        if "image 0" in geometries:
            lines.append("depth map of the camera in the colours of its image")
        elif "depth 0" in geometries:
            lines.append("depth map of the camera: yellow is near, violet far")
        return lines


def show(
    geometries: Mapping[str, Any],
    T_world_lidar: NDArray[np.float64] | None = None,
    image: Path | None = None,
    keys: Mapping[int, Callable[[], Scene]] | None = None,
    legend: Sequence[str] = (),
) -> None:
    """Show Open3D geometries in a window, or write a PNG of them.

    Parameters
    ----------
    geometries : mapping of str to open3d.geometry.Geometry
        From :func:`scene_geometries`.
    T_world_lidar : ndarray of float64, shape (4, 4), optional
        The view starts behind and above this pose; otherwise it shows everything.
    image : Path, optional
        Write a PNG instead of opening a window; needs no display.
    keys : mapping of int to callable, optional
        Give other geometries and their pose when a key (GLFW's number) is pressed. The view follows
        the pose.
    legend : sequence of str
        Lines of text for the PNG.

    Raises
    ------
    BackendError
        There is no display, or the PNG cannot be rendered.
    MissingExtraError
        Open3D is not installed.
    """
    o3d = open3d_module()
    if image is None and not has_display():
        raise BackendError(
            "no display to open a window on (DISPLAY is not set); write an image instead"
        )
    if image is not None:  # without a display Open3D warns of it, and then draws all the same
        o3d.utility.set_verbosity_level(o3d.utility.VerbosityLevel.Error)
    window = o3d.visualization.VisualizerWithKeyCallback()
    size = _WINDOW if image is None else _IMAGE
    if not window.create_window(visible=image is None, **size):
        raise BackendError("Open3D cannot render here: neither a display nor EGL is available")
    try:
        for geometry in geometries.values():
            window.add_geometry(geometry)
        options = window.get_render_option()
        options.background_color, options.point_size = np.array(_BACKGROUND), _POINT_SIZE
        options.mesh_show_back_face = True  # images are seen from behind their cameras
        if T_world_lidar is not None:
            _look_from(window, T_world_lidar @ _viewer_pose())
            stage = _Stage(dict(geometries), T_world_lidar)
            for key, change in (keys or {}).items():
                window.register_key_callback(key, partial(stage.change, change))
        if image is None:
            window.run()
        else:
            window.poll_events()
            window.update_renderer()
            _capture(window, image, legend)
    finally:
        window.destroy_window()


@dataclass
class _Stage:
    """The geometries in a window and the pose that they belong to."""

    geometries: dict[str, Any]
    T_world_lidar: NDArray[np.float64]

    def change(self, new: Callable[[], Scene], window: Any) -> bool:
        """Replace the geometries; the view stays where it was, seen from the LiDAR."""
        T_world_viewer = inverse(_view_of(window).extrinsic)
        T_lidar_viewer = inverse(self.T_world_lidar) @ T_world_viewer
        for geometry in self.geometries.values():
            window.remove_geometry(geometry, reset_bounding_box=False)
        self.geometries, self.T_world_lidar = new()
        for geometry in self.geometries.values():
            window.add_geometry(geometry, reset_bounding_box=False)
        _look_from(window, self.T_world_lidar @ T_lidar_viewer)
        return True


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
        os.replace(part, image)
    except OSError:
        raise RunError(
            f"{image} cannot be written; name a .png file in a folder that is there"
        ) from None
    finally:
        with contextlib.suppress(OSError):
            part.unlink()


def _viewer_pose() -> NDArray[np.float64]:
    """``T_lidar_viewer``: z looks forward and down, y down."""
    cos, sin = np.cos(_PITCH), np.sin(_PITCH)
    T_lidar_viewer = np.eye(4)
    T_lidar_viewer[:3, :3] = np.array([(0, -sin, cos), (-1, 0, 0), (0, -cos, -sin)])
    T_lidar_viewer[:3, 3] = _VIEWER
    return T_lidar_viewer


def has_display() -> bool:
    """Whether a window can be opened."""
    names = ("DISPLAY", "WAYLAND_DISPLAY")
    return not sys.platform.startswith("linux") or any(os.environ.get(name) for name in names)
