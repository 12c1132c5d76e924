"""A run as a recording for the viewer rerun: sweeps, tracks, images and depth on a time line."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from docdepth.concurrency import Progress
from docdepth.datasets.base import CameraStream
from docdepth.errors import MissingExtraError, RunError
from docdepth.geometry.camera import Camera
from docdepth.geometry.se3 import matrix_to_quaternion
from docdepth.geometry.track import Tracks
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.run_folder import RunFolder
from docdepth.io.tracks import tracks_in
from docdepth.visualization.drive_scene import CameraView, Coloring, camera_views, sweep_scene
from docdepth.visualization.image_views import track_color
from docdepth.visualization.pictures import Picture, colorize

_DEPTH_STEPS = 65535  # of a depth image
_PLANE = 2.0  # where in its frustum an image stands [m]
_PATH_COLOR = (255, 191, 0)
_FAR = 50.0  # where the colours of depth in the scene end [m]
_POINT = 1.0  # radius of a point on the screen; rerun's own hides what is behind the points
# Where the viewer starts and what it looks at, in the frame of the first sweep [m].
_VIEWER, _TARGET = (-16.0, 0.0, 9.0), (8.0, 0.0, 0.0)


class _Log(NamedTuple):
    """The recording, and what all of its parts need."""

    rerun: Any
    stream: Any
    trajectory: Trajectory
    origin: NDArray[np.float64]

    def at(self, time: int) -> None:
        """Log what follows at a time [ns]."""
        self.stream.set_time("sweep", sequence=self.trajectory.nearest(time))
        seconds = (time - int(self.trajectory.times[0])) * 1e-9
        self.stream.set_time("time", duration=seconds)

    def pose(self, entity: str, T_world_entity: NDArray[np.float64]) -> None:
        place = T_world_entity[:3, 3] - self.origin
        moved = self.rerun.Transform3D(translation=place, mat3x3=T_world_entity[:3, :3])
        self.stream.log(entity, moved)

    def picture(self, entity: str, picture: Picture) -> None:
        colors = self.rerun.Image(np.ascontiguousarray(picture[:, :, ::-1]))
        self.stream.log(entity, colors.compress(jpeg_quality=85))


def write_rerun(
    run: RunFolder,
    path: Path,
    camera: str | None = None,
    color: Coloring = "class",
    stream: CameraStream | None = None,
    progress: Progress | None = None,
) -> None:
    """Write a run as ``.rrd`` file: ``rerun FILE.rrd`` shows it.

    The world is that of the run, moved so that the drive begins at its origin: rerun holds single
    precision.

    Parameters
    ----------
    run : RunFolder
        With classified frames.
    path : Path
    camera : str, optional
        Whose depth maps; needed if the run has several.
    color : {"class", "votes", "instance"}
        What the colours of points say.
    stream : CameraStream, optional
        The camera; its images are logged.
    progress : callable, optional
        Called with "rerun", the number of sweeps done and of all sweeps.

    Raises
    ------
    InputError
        The run has no votes or instances.
    MissingExtraError
        rerun is not installed.
    RunError
        A frame is missing or not classified, or the file cannot be written.
    """
    rerun, trajectory = _rerun_module(), run.trajectory()
    part = path.with_name(f".{path.stem}.part{path.suffix}")
    log = _Log(rerun, rerun.RecordingStream("docdepth"), trajectory, trajectory.poses[0, :3, 3])
    tracks = tracks_in(run.path)
    log.stream.send_recording_name(run.path.resolve().name)
    try:
        part.write_bytes(b"")  # rerun itself does not say why it cannot write
        log.stream.save(part, default_blueprint=_layout(log, run, stream))
        log.stream.log("world", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        path_driven = rerun.LineStrips3D(
            [trajectory.poses[:, :3, 3] - log.origin], colors=[_PATH_COLOR]
        )
        log.stream.log("world/path", path_driven, static=True)
        for k in range(len(trajectory)):
            _log_sweep(log, run, k, color, tracks)
            if progress:
                progress("rerun", k + 1, len(trajectory))
        for k, (time, view) in enumerate(camera_views(run, trajectory, camera, stream)):
            if k == 0:
                _log_pinhole(log, view.camera)
            log.at(time)
            _log_camera(log, view, run.parameters.render.max_depth)
        log.stream.flush()
        log.stream.disconnect()
        os.replace(part, path)
    except OSError as error:
        raise RunError(f"{path} cannot be written ({error.strerror})") from None
    finally:
        part.unlink(missing_ok=True)


def _layout(log: _Log, run: RunFolder, stream: CameraStream | None) -> Any:
    """What the viewer shows first: the drive from behind the vehicle, beside it the camera."""
    views = log.rerun.blueprint
    start = log.trajectory.poses[0, :3, :3]
    eye = views.EyeControls3D(
        position=start @ _VIEWER,
        look_target=start @ _TARGET,
        eye_up=(0, 0, 1),
        tracking_entity="world/lidar",
    )
    drive = views.Spatial3DView(origin="world", name="drive", eye_controls=eye)
    panels = {"collapse_panels": True}
    if not run.cameras:
        return views.Blueprint(drive, **panels)
    image = "world/camera/image"
    pictures = [views.Spatial2DView(origin="depth", name="depth")]
    if stream is not None and stream.images:
        pictures.insert(0, views.Spatial2DView(origin="world/camera", contents=image, name="image"))
    return views.Blueprint(views.Horizontal(drive, views.Vertical(*pictures)), **panels)


def _log_sweep(log: _Log, run: RunFolder, index: int, color: Coloring, tracks: Tracks) -> None:
    scene = sweep_scene(run, log.trajectory, index, color, tracks)
    colors = np.rint(255 * scene.colors).astype(np.uint8)
    dots = log.rerun.Radius.ui_points(_POINT)
    log.at(int(log.trajectory.times[index]))
    log.pose("world/lidar", scene.T_world_lidar)
    log.stream.log(
        "world/lidar/points", log.rerun.Points3D(scene.points, colors=colors, radii=dots)
    )
    centres = [T[:3, 3] - log.origin + T[:3, 2] * track.size[2] / 2 for track, T in scene.boxes]
    turns = [matrix_to_quaternion(T[:3, :3]) for _, T in scene.boxes]
    there = [track for track, _ in scene.boxes]
    boxes = log.rerun.Boxes3D(
        centers=np.reshape(centres, (-1, 3)),
        half_sizes=np.reshape([track.size / 2 for track in there], (-1, 3)),
        quaternions=np.reshape(turns, (-1, 4)),
        colors=np.reshape([track_color(track.id)[::-1] for track in there], (-1, 3)),
        labels=[f"{track.kind} {track.id}" for track in there],
    )
    log.stream.log("world/tracks", boxes)


def _log_pinhole(log: _Log, camera: Camera) -> None:
    rerun = log.rerun
    pinhole = rerun.Pinhole(
        image_from_camera=camera.K, width=camera.width, height=camera.height,
        camera_xyz=rerun.ViewCoordinates.RDF, image_plane_distance=_PLANE,
    )  # fmt: skip
    log.stream.log("world/camera", pinhole, static=True)


def _log_camera(log: _Log, view: CameraView, max_depth: float) -> None:
    """A depth map and, if there is one, its image."""
    rerun, steps = log.rerun, _DEPTH_STEPS / max_depth
    log.pose("world/camera", view.T_world_camera)
    if view.depth is None:
        return
    depth = np.rint(np.nan_to_num(view.depth) * steps).clip(0, _DEPTH_STEPS)
    # Near is yellow as in all pictures: so the range is given backwards, in steps.
    shown = rerun.DepthImage(
        depth.astype(np.uint16), meter=steps, colormap="viridis", depth_range=(_FAR * steps, 0)
    )
    log.stream.log("world/camera/depth", shown)
    log.picture("depth", colorize(view.depth))
    if view.image is not None:
        log.picture("world/camera/image", view.image)


def _rerun_module() -> Any:
    try:
        import rerun
    except ImportError as error:
        raise MissingExtraError(
            f'this recording needs rerun: pip install "docdepth[rerun]" ({error})'
        ) from None
    return rerun
