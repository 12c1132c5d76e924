"""A drive ready for rendering, and depth maps of its images (paper V-B)."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from threading import Lock
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from docdepth.concurrency import thread_count
from docdepth.config import Parameters, checked_parameters
from docdepth.datasets.base import CameraStream
from docdepth.datasets.point_times import sweep_seconds
from docdepth.errors import InputError
from docdepth.geometry.camera import View
from docdepth.geometry.points import as_integer, check_classes, usable_points
from docdepth.geometry.track import Track, Tracks
from docdepth.geometry.trajectory import Trajectory
from docdepth.odometry.sweeps import AnySweep, lidar_frame
from docdepth.render.backends import Renderer
from docdepth.render.depth_map import RenderList, compose_depth, render_list
from docdepth.render.layers import check_layers, compose_layers
from docdepth.render.render_sweep import RenderSweep, SweepCache, prepare_sweep
from docdepth.render.selection import needed_sweeps


class HasClasses(Protocol):
    """Labels of one sweep: ``classid`` is uint16 of shape (N,); so is ``instance`` if it exists."""

    @property
    def classid(self) -> NDArray[np.uint16]: ...


Classes: TypeAlias = HasClasses | NDArray[np.uint16]


class Scene:
    """A classified drive, from which depth maps of any camera at any time can be rendered.

    Sweeps are read and prepared when an image needs them and forgotten when the next image does
    not, so memory stays bounded. Render images in order of time: consecutive images share most of
    their sweeps. Safe to use from several threads. A copy or a pickle holds no prepared sweeps.

    Parameters
    ----------
    sweeps : sequence of LidarFrame, of Sweep, or of ndarray of float32, shape (N, 3)
        Metres, LiDAR frame, deskewed to the sweep's time. Those of :class:`~docdepth.Odometry`, and
        a :class:`~docdepth.Sweep`, also say when and from where each point was measured, which
        places dynamic objects and depth edges more exactly. The sequence may read each sweep from
        disk.
    trajectory : Trajectory
        The pose of each sweep.
    labels : sequence of Labels, or of ndarray of uint16, shape (N,)
        The class of each point: ground below 50, static below 100, dynamic from 100 on. Labels also
        hold the instance of each point: the id of its track.
    parameters : Parameters, optional
        ``render`` is used.
    tracks : Tracks, or sequence of Track, optional
        Objects that move; those of ``labels`` from :func:`classify_drive` if absent. Dynamic points
        without a track are drawn where the nearest sweep saw them.

    Raises
    ------
    InputError
        The lengths of ``sweeps``, ``trajectory`` and ``labels`` differ, or one is of a wrong type.
    """

    def __init__(
        self,
        sweeps: Sequence[AnySweep],
        trajectory: Trajectory,
        labels: Sequence[Classes],
        parameters: Parameters | None = None,
        tracks: Sequence[Track] | Tracks | None = None,
    ) -> None:
        Trajectory.check(trajectory, sweeps)
        if not hasattr(labels, "__len__") or len(labels) != len(sweeps):
            count = len(labels) if hasattr(labels, "__len__") else type(labels).__name__
            raise InputError(f"{len(sweeps)} sweeps need a list of as many labels, got {count}")
        self.sweeps, self.trajectory, self.labels = sweeps, trajectory, labels
        self.parameters = checked_parameters(parameters)
        self.tracks = Tracks(getattr(labels, "tracks", ()) if tracks is None else tracks)
        self._period = sweep_seconds(trajectory.times)
        self._start()

    def _start(self) -> None:
        self._cache = SweepCache(self._prepare)
        self._reading = Lock()

    def __getstate__(self) -> dict[str, object]:
        return {k: v for k, v in self.__dict__.items() if k not in ("_cache", "_reading")}

    def __setstate__(self, state: dict[str, object]) -> None:
        self.__dict__.update(state)
        self._start()

    def __len__(self) -> int:
        return len(self.trajectory)

    def __repr__(self) -> str:
        return f"<Scene: {len(self)} sweeps, {len(self.tracks)} tracks>"

    def sweeps_at(self, time: int, threads: int = 0) -> dict[int, RenderSweep]:
        """Prepare all sweeps that the image taken at ``time`` [ns] needs.

        Returns
        -------
        dict of int to RenderSweep
            By the index of their sweep.

        Raises
        ------
        InputError
            The arrays of a sweep are wrong.
        """
        needed = needed_sweeps(self.trajectory, time, self.parameters.render, self.tracks)
        with ThreadPoolExecutor(thread_count(threads)) as executor:
            requested = self._cache.request(needed.items(), executor)
        return {i: sweep.result() for (i, _), sweep in requested.items()}

    def render_list(self, view: View, threads: int = 0) -> RenderList:
        """What is drawn into an image."""
        sweeps = self.sweeps_at(view.time, threads)
        p = self.parameters.render
        return render_list(view, self.trajectory, sweeps.__getitem__, p, self.tracks)

    def _prepare(self, index: int, whole: bool) -> RenderSweep:
        with self._reading:  # datasets need not be safe to read from several threads
            sweep, classes = self.sweeps[index], self.labels[index]
        try:
            frame = lidar_frame(sweep, self._period)
            classid = check_classes(getattr(classes, "classid", classes))
            if classid.shape != frame.points.shape[:1]:
                raise InputError(
                    f"points {frame.points.shape} need classes uint16 of shape (N,), one for each "
                    f"point; got {classid.dtype} {classid.shape}"
                )
            instance = getattr(classes, "instance", None)
            frame = replace(frame, classid=classid, instance=instance)
            frame = frame.select(usable_points(frame.points))
            p = self.parameters.render
            return prepare_sweep(frame, index, self.trajectory, p, self.tracks, whole)
        except InputError as error:
            raise InputError(f"sweep {index}: {error}") from None


def render_depth(
    scene: Scene,
    camera: CameraStream,
    index: int | None = None,
    time: int | None = None,
    threads: int = 0,
    renderer: Renderer | None = None,
) -> NDArray[np.float32]:
    """Render the depth map of one image (paper V-B).

    Parameters
    ----------
    scene : Scene
    camera : CameraStream
    index : int, optional
        Which image of the camera; give this or ``time``. Negative ones count from the end.
    time : int, optional
        Any time within the trajectory [ns].
    threads : int
        0 takes all cores. The result does not depend on it.
    renderer : Renderer, optional
        What draws; the CPU if absent.

    Returns
    -------
    ndarray of float32, shape (height, width)
        z along the optical axis of the rectified camera in metres; NaN where there is no depth.

    Raises
    ------
    InputError
        The camera has no such image, the time lies outside the trajectory, or the arrays of a sweep
        are wrong.
    BackendError
        The renderer failed.
    """
    if renderer is not None and not isinstance(renderer, Renderer):
        raise InputError(f"renderer must be docdepth.Renderer(name), not {type(renderer).__name__}")
    view = _view(scene, camera, index, time)
    return compose_depth(scene.render_list(view, threads), threads, renderer)


def render_layers(
    scene: Scene,
    camera: CameraStream,
    names: str | Sequence[str],
    index: int | None = None,
    time: int | None = None,
    depth: NDArray[np.float32] | None = None,
    threads: int = 0,
) -> dict[str, NDArray[Any]]:
    """Gather layers of a depth map: class, confidence and others (:mod:`docdepth.render.layers`).

    Parameters
    ----------
    scene, camera, index, time, threads
        The arguments that :func:`render_depth` was given.
    names : str or sequence of str
        Of :data:`docdepth.render.layers.LAYERS`.
    depth : ndarray of float32, shape (height, width), optional
        The map that :func:`render_depth` returned; rendered again if absent.

    Returns
    -------
    dict of str to ndarray, shape (height, width) or (height, width, 3)
        By name, in the order of ``names``.

    Raises
    ------
    InputError
        As :func:`render_depth`; a name is unknown, or ``depth`` has another size.
    """
    names = (names,) if isinstance(names, str) else names
    view = _view(scene, camera, index, time)
    check_layers(names, scene.parameters.render)
    drawn = scene.render_list(view, threads)
    return compose_layers(
        names, compose_depth(drawn, threads) if depth is None else depth, drawn, threads
    )


def _view(scene: Scene, camera: CameraStream, index: int | None, time: int | None) -> View:
    _check(scene, camera)
    stamp = _stamp(camera, index, time)
    return View.at(camera.camera, camera.T_camera_lidar, scene.trajectory, stamp)


def _check(scene: Scene, camera: CameraStream) -> None:
    for name, value, kind in (("scene", scene, Scene), ("camera", camera, CameraStream)):
        if not isinstance(value, kind):
            raise InputError(
                f"{name} must be a docdepth.{kind.__name__}, not {type(value).__name__}"
            )


def _stamp(camera: CameraStream, index: int | None, time: int | None) -> int:
    if time is not None and index is None:
        return as_integer(time, "the time of an image is an integer, nanoseconds")
    if index is None or time is not None:
        raise InputError("give either the index of an image or a time [ns]")
    index = as_integer(index, "the index of an image is an integer")
    count = len(camera.times)
    if not -count <= index < count:
        raise InputError(f"camera {camera.name} has {count} images; there is no image {index}")
    return int(camera.times[index])
