"""Composite rendering of depth maps (paper III-D)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from docdepth import _core
from docdepth.backends import Renderer
from docdepth.config import RenderParameters, SurfaceParameters
from docdepth.errors import CalibrationError, InputError
from docdepth.sensors import Sensors
from docdepth.surface import Surface, SurfacePart
from docdepth.trajectory import Trajectory, inverse

NEAR = 0.1
"""Nothing nearer to the image plane is drawn [m]."""

MOVING = 4
"""Sweeps that moving objects are drawn from, as triangles."""


@dataclass(frozen=True)
class Camera:
    """A rectified pinhole camera (OpenCV: x right, y down, z forward).

    Attributes
    ----------
    K : ndarray of float64, shape (3, 3)
        Pixels; integer pixel coordinates are pixel centres.
    width, height : int
        Pixels.
    """

    K: NDArray[np.float64]
    width: int
    height: int

    def __post_init__(self) -> None:
        K = np.ascontiguousarray(self.K, dtype=np.float64)
        if K.shape != (3, 3) or not np.isfinite(K).all() or K[0, 0] <= 0 or K[1, 1] <= 0:
            raise CalibrationError(f"K must be a 3x3 pinhole matrix, got {K.tolist()}")
        if K[0, 1] or K[1, 0] or (K[2] != (0, 0, 1)).any():
            raise CalibrationError(
                f"K must be fx 0 cx / 0 fy cy / 0 0 1, got {K.tolist()}; rectify images with skew"
            )
        if self.width < 1 or self.height < 1:
            raise CalibrationError(f"image size {self.width} x {self.height} is empty")
        if not (0 <= K[0, 2] < self.width and 0 <= K[1, 2] < self.height):
            raise CalibrationError(
                f"the principal point ({K[0, 2]:.1f}, {K[1, 2]:.1f}) lies outside the "
                f"{self.width} x {self.height} image: the size does not fit K"
            )
        object.__setattr__(self, "K", K)


class Frame:
    """A sweep made ready to be drawn: static and moving parts apart, neighbours together.

    Make it once a sweep and keep it for all images that see the sweep.

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)
        LiDAR frame, metres, deskewed to the sweep's time. Points that are not finite are left out.
    classid : ndarray of uint16, shape (N,)
        Below 50 ground, below 100 static, moving from 100 on.
    parameters : RenderParameters, optional
        Its ``surface`` says what is made; :func:`render` wants the same.
    surface_parameters : SurfaceParameters, optional
        Of the triangles between neighbouring returns.
    late : ndarray of float32, shape (N,), optional
        When each point was measured, seconds after the sweep's time. Known, it tells better where
        moving objects were.
    sensors : Sensors, optional
        Where the sweep was measured from, if not from the origin. Each of several LiDARs has a
        surface and lines of sight of its own.
    velocity : array_like of float64, shape (3,), optional
        Of the LiDAR in its own frame, metres a second (:meth:`Trajectory.velocity`). With ``late``
        known, lines of sight begin where it had come to when it measured each point.

    Raises
    ------
    InputError
        Shapes or dtypes are wrong.
    """

    def __init__(
        self,
        points: NDArray[np.float32],
        classid: NDArray[np.uint16],
        parameters: RenderParameters | None = None,
        surface_parameters: SurfaceParameters | None = None,
        late: NDArray[np.float32] | None = None,
        sensors: Sensors | None = None,
        velocity: ArrayLike | None = None,
    ) -> None:
        points, classid = np.asarray(points), np.asarray(classid)
        if points.ndim != 2 or points.shape[1] != 3 or points.dtype != np.float32:
            raise InputError(
                f"points must be float32 of shape (N, 3), got {points.dtype} {points.shape}"
            )
        if classid.shape != (len(points),) or classid.dtype != np.uint16:
            raise InputError(
                f"classid must be uint16 of shape ({len(points)},), one for each point; "
                f"got {classid.dtype} {classid.shape}"
            )
        if late is not None and late.shape != (len(points),):
            raise InputError(f"late must have shape ({len(points)},), a time a point")
        p = parameters or RenderParameters()
        points, classid = np.ascontiguousarray(points), np.ascontiguousarray(classid)
        self.parts: list[_Part]
        self.movers: _Part
        if p.surface == "splats":
            self.movers = (_core.Frame(points, classid, p.crop), np.eye(4))
            self.parts = [self.movers]
            return
        with np.errstate(invalid="ignore", over="ignore"):
            drawn = np.einsum("ij,ij->i", points, points, dtype=np.float64) < p.crop**2
        points, classid = points.compress(drawn, axis=0), classid[drawn]
        if late is not None and velocity is not None:
            sensors = (sensors or Sensors.at((0, 0, 0), len(late))).driving(velocity, late)
        late = None if late is None else late[drawn].astype(np.float32)
        sensors = None if sensors is None else sensors.of(drawn)
        seen = Surface(points, surface_parameters, sensors)
        self.parts = [
            (_surface_frame(part, classid, p, late), part.view.T_lidar_sensor)
            for part in seen.parts
        ]
        self.movers = self.parts[0]
        if len(self.parts) > 1:  # what moves is small, and drawn as if the first had seen all of it
            first = Sensors.at(seen.parts[0].view.T_lidar_sensor[:3, 3], len(points))
            first = replace(first, way=None if sensors is None else sensors.way)
            (whole,) = Surface(points, surface_parameters, first).parts
            self.movers = (_surface_frame(whole, classid, p, late), whole.view.T_lidar_sensor)


_Part = tuple[_core.Frame | _core.SurfaceFrame, NDArray[np.float64]]
"""What is drawn, and where it stands in the LiDAR's frame."""


def _surface_frame(
    part: SurfacePart,
    classid: NDArray[np.uint16],
    parameters: RenderParameters,
    late: NDArray[np.float32] | None,
) -> _core.SurfaceFrame:
    """Rows that are not finite are no points of this surface."""
    points, starts = part.view.points, part.view.starts()
    triangles, cut, loose = part.core.triangles, part.core.cut, part.core.loose
    if not np.isfinite(points).all():
        own = np.isfinite(points).all(axis=1)
        row = np.cumsum(own, dtype=np.uint32) - np.uint32(1)
        points, classid, late = points[own], classid[own], None if late is None else late[own]
        starts = None if starts is None else starts[own]
        triangles, loose = row[triangles], row[loose]
    angle = float(np.radians(parameters.loose_deg))
    return _core.SurfaceFrame(points, classid, triangles, cut, loose, angle, late, starts)


def static_frames(
    trajectory: Trajectory, time: int, parameters: RenderParameters | None = None
) -> NDArray[np.int64]:
    """Sweeps whose static points are drawn into the image taken at ``time`` [ns] (paper III-D).

    Those with ``-behind < arc length from the image < ahead``. As splats they are taken in order of
    path and at least ``step`` apart. As triangles the one nearest in time comes first, being the
    most trustworthy, and then others by their distance. The path is cut every ``step``, and of
    these cuts every second, fourth, eighth ... is used farther away: images one after the other
    share their sweeps. Where the ego stands, many sweeps have one arc length: of these only the one
    nearest in time can be taken.

    Returns
    -------
    ndarray of int64, shape (k,)
        Indices of the trajectory, in the order in which they are drawn.
    """
    p = parameters or RenderParameters()
    arc = trajectory.arc_length
    ahead = arc - trajectory.arc_length_at(time)[0]
    window = np.flatnonzero((-p.behind < ahead) & (ahead < p.ahead))
    delay = np.abs(trajectory.times - np.int64(time))
    kept: list[int] = []
    if p.surface == "splats":
        for place in np.unique(arc[window]):
            if not kept or place - arc[kept[-1]] >= p.step:
                here = window[arc[window] == place]
                kept.append(int(here[np.argmin(delay[here])]))
        return np.array(kept, dtype=np.int64)

    nearest = trajectory.nearest(time)
    cut = (arc // p.step).astype(np.int64)
    for k in window[np.diff(cut, prepend=-1)[window] > 0]:
        passed = range(cut[k - 1] + 1 if k else 0, cut[k] + 1)
        spacing = p.step * max(n & -n or np.inf for n in passed)  # of the widest cutting passed
        if abs(arc[k] - arc[nearest]) >= p.step / 2 and p.step_growth * abs(ahead[k]) <= spacing:
            kept.append(int(k))
    kept.sort(key=lambda k: abs(ahead[k]))
    return np.array([nearest, *kept], dtype=np.int64)


def dynamic_frame(trajectory: Trajectory, time: int) -> int:
    """The sweep whose moving points are drawn: the nearest in time to ``time`` [ns]."""
    return trajectory.nearest(time)


def _moving_frames(trajectory: Trajectory, time: int, parameters: RenderParameters) -> list[int]:
    """Sweeps that tell of what moves, the nearest in time first."""
    nearest = dynamic_frame(trajectory, time)
    if parameters.surface == "splats":
        return [nearest]
    around = np.arange(max(nearest - MOVING, 0), min(nearest + MOVING + 1, len(trajectory)))
    delay = np.abs(trajectory.times[around] - np.int64(time))
    return [int(i) for i in around[np.argsort(delay, kind="stable")[:MOVING]]]


def needed_frames(
    trajectory: Trajectory, time: int, parameters: RenderParameters | None = None
) -> set[int]:
    """Every sweep that :func:`render` asks for; all others can be forgotten."""
    p = parameters or RenderParameters()
    world, moving = drawn_sweeps(trajectory, time, p)
    return {*world, *moving}


def render(
    camera: Camera,
    T_camera_lidar: NDArray[np.float64],
    trajectory: Trajectory,
    time: int,
    frames: Callable[[int], Frame],
    parameters: RenderParameters | None = None,
    threads: int = 0,
    renderer: Renderer | None = None,
) -> NDArray[np.float32]:
    """Depth map of the camera at one moment, composed of many sweeps (paper III-D).

    Parameters
    ----------
    camera : Camera
    T_camera_lidar : ndarray of float64, shape (4, 4)
        Takes LiDAR points to the camera.
    trajectory : Trajectory
        Poses and times of all sweeps.
    time : int
        When the image was taken [ns]; within the trajectory.
    frames : callable
        Gives the :class:`Frame` of a sweep by its index; asked only for sweeps that are drawn.
    parameters : RenderParameters, optional
    threads : int
        0 takes all cores. The result does not depend on it.
    renderer : Renderer, optional
        What draws, from :func:`docdepth.backends.choose`; the processor if absent.

    Returns
    -------
    ndarray of float32, shape (height, width)
        z along the optical axis in metres; NaN where nothing was drawn.

    Raises
    ------
    InputError
        ``time`` lies outside the trajectory, or a frame was made for another ``surface``.
    BackendError
        The renderer failed.
    """
    p = parameters or RenderParameters()
    core = (renderer or Renderer()).core
    draw = core.render_splats if p.surface == "splats" else core.render_surfaces
    depth: NDArray[np.float32] = draw(
        **arguments(camera, T_camera_lidar, trajectory, time, frames, p), threads=threads
    )
    # The far plane: nearest wins, so cutting the result is cutting the points.
    depth[depth > p.max_depth] = np.nan
    return depth


def drawn_sweeps(
    trajectory: Trajectory, time: int, parameters: RenderParameters
) -> tuple[list[int], list[int]]:
    """Sweeps that are drawn, as the core numbers them: of the world, then of what moves."""
    moving = _moving_frames(trajectory, time, parameters)
    return static_frames(trajectory, time, parameters).tolist(), moving


def arguments(
    camera: Camera,
    T_camera_lidar: NDArray[np.float64],
    trajectory: Trajectory,
    time: int,
    frames: Callable[[int], Frame],
    p: RenderParameters,
) -> dict[str, Any]:
    """What the core draws, or looks at, for one image."""
    T_camera_world = T_camera_lidar @ inverse(trajectory.interpolate(time)[0])
    kind = _core.Frame if p.surface == "splats" else _core.SurfaceFrame

    def frame(index: int) -> Frame:
        found = frames(index)
        if not isinstance(found.movers[0], kind):
            raise InputError(f"frame {index} was not made for {p.surface}; give Frame parameters")
        return found

    T_camera_sweep = T_camera_world @ trajectory.poses
    world, moving = drawn_sweeps(trajectory, time, p)
    image = {"K": camera.K, "width": camera.width, "height": camera.height}
    fixed = [(core, T_camera_sweep[i] @ T) for i in world for core, T in frame(i).parts]
    movers = [(core, T_camera_sweep[i] @ T) for i in moving for core, T in [frame(i).movers]]
    if p.surface == "splats":
        return image | {
            "static_frames": fixed,
            "dynamic_frames": movers,
            "static_size": (p.static_size_max, p.static_size_min),
            "dynamic_size": (p.dynamic_size_max, p.dynamic_size_min),
        }
    since = (np.int64(time) - trajectory.times[moving]) * 1e-9
    return image | {
        "fixed": fixed,
        "moving": [(*mover, float(t)) for mover, t in zip(movers, since, strict=True)],
        "max_speed": p.max_speed,
        "witnesses": p.witnesses,
    }
