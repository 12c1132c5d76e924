"""Shows a run in 3D with Open3D, in a window or as an image."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import BackendError, RunError
from docdepth.geometry.se3 import inverse
from docdepth.io.run_folder import RunFolder
from docdepth.visualization.geometries import open3d_module, run_geometries

_BACKGROUND = (0.09, 0.09, 0.09)
_POINT_SIZE = 2.0  # pixels
_WINDOW = {"window_name": "docdepth", "width": 1600, "height": 900}
# Position of the viewer in the LiDAR frame [m], and how far it looks down [rad].
_VIEWER, _PITCH = (-14.0, 0.0, 7.0), 0.3


def view_run(
    run: Path | RunFolder,
    frame: int | None = None,
    camera: str | None = None,
    around: int = 0,
    depth: bool = True,
    image: Path | None = None,
) -> None:
    """Show a sweep of a run in a window, with the trajectory, the cameras and a depth map.

    Ground is olive, static points are light grey, dynamic points red. The depth map nearest in time
    to the sweep is back-projected and coloured by depth.

    Parameters
    ----------
    run : Path or RunFolder
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

    Raises
    ------
    BackendError
        There is no display.
    InputError
        The run has no such sweep.
    MissingExtraError
        Open3D is not installed.
    RunError
        The sweep is not classified.
    """
    folder = run if isinstance(run, RunFolder) else RunFolder.open(run)
    geometries = run_geometries(folder, frame, camera, around, depth)
    poses = folder.trajectory().poses
    show(geometries, poses[len(poses) // 2 if frame is None else frame], image)


def show(
    geometries: Mapping[str, Any],
    T_world_lidar: NDArray[np.float64] | None = None,
    image: Path | None = None,
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
    window = o3d.visualization.Visualizer()
    if not window.create_window(visible=image is None, **_WINDOW):
        raise BackendError("Open3D cannot render here: neither a display nor EGL is available")
    try:
        for geometry in geometries.values():
            window.add_geometry(geometry)
        options = window.get_render_option()
        options.background_color, options.point_size = np.array(_BACKGROUND), _POINT_SIZE
        if T_world_lidar is not None:
            control = window.get_view_control()
            view = control.convert_to_pinhole_camera_parameters()
            view.extrinsic = inverse(T_world_lidar @ _viewer_pose())
            control.convert_from_pinhole_camera_parameters(view, allow_arbitrary=True)
        if image is None:
            window.run()
        else:
            window.poll_events()
            window.update_renderer()
            _capture(window, image)
    finally:
        window.destroy_window()


def _capture(window: Any, image: Path) -> None:
    """Write what a window shows; Open3D itself reports no failure."""
    part = image.with_name(f".{image.stem}.part{image.suffix}")
    try:
        window.capture_screen_image(str(part), do_render=True)
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
