"""A run as a recording for the viewer rerun: sweeps, tracks, images and depth on a time line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.concurrency import Progress, null_progress
from docdepth.datasets.base import CameraStream
from docdepth.errors import MissingExtraError, RunError
from docdepth.geometry.se3 import matrix_to_quaternion
from docdepth.geometry.track import Track
from docdepth.io.atomic import replace_output
from docdepth.io.run_folder import RunFolder
from docdepth.io.tracks import tracks_in
from docdepth.visualization.drive_scene import Coloring, camera_views, sweep_scene
from docdepth.visualization.image_views import track_color
from docdepth.visualization.pictures import Picture, colorize

_DEPTH_STEPS = 65535  # of a depth image
_PLANE = 2.0  # where in its frustum an image stands [m]
_PATH_COLOR = (255, 191, 0)
_FAR = 50.0  # where the colours of depth in the scene end [m]
_POINT = 1.0  # radius of a point on the screen; rerun's own hides what is behind the points
# Where the viewer starts and what it looks at, in the frame of the first sweep [m].
_VIEWER, _TARGET = (-16.0, 0.0, 9.0), (8.0, 0.0, 0.0)


def write_rerun(
    run: RunFolder,
    path: Path,
    camera: str | None = None,
    color: Coloring = "class",
    stream: CameraStream | None = None,
    progress: Progress = null_progress,
) -> None:
    """Write a run as ``.rrd`` file: ``rerun FILE.rrd`` shows it.

    The world is that of the run, moved so that the drive begins at its origin: rerun holds single
    precision.

    Parameters
    ----------
    color : {"class", "votes", "instance"}
        What the colours of points say.
    """
    rerun = _rerun_module()
    part = path.with_name(f".{path.stem}.part{path.suffix}")
    recording = rerun.RecordingStream("docdepth")
    recording.send_recording_name(run.path.resolve().name)
    try:
        part.write_bytes(b"")  # rerun itself does not say why it cannot write
        recording.save(part, default_blueprint=_layout(rerun, run, stream))
        _log_run(rerun, recording, run, camera, color, stream, progress)
        recording.flush()
        recording.disconnect()
        replace_output(part, path)
    except OSError as error:
        raise RunError(f"{path} cannot be written ({error.strerror})") from None
    finally:
        part.unlink(missing_ok=True)


def _layout(rerun: Any, run: RunFolder, stream: CameraStream | None) -> Any:
    """What the viewer shows first: the drive from behind the vehicle, beside it the camera."""
    views, start = rerun.blueprint, run.trajectory().poses[0, :3, :3]
    eye = views.EyeControls3D(
        position=start @ _VIEWER,
        look_target=start @ _TARGET,
        eye_up=(0, 0, 1),
        tracking_entity="world/lidar",
    )
    shown = views.Spatial3DView(origin="world", name="drive", eye_controls=eye)
    if run.cameras:
        pictures = [views.Spatial2DView(origin="depth", name="depth")]
        if stream is not None and stream.images:
            image = "world/camera/image"
            view = views.Spatial2DView(origin="world/camera", contents=image, name="image")
            pictures.insert(0, view)
        shown = views.Horizontal(shown, views.Vertical(*pictures))
    return views.Blueprint(shown, collapse_panels=True)


def _log_run(
    rerun: Any,
    recording: Any,
    run: RunFolder,
    camera: str | None,
    color: Coloring,
    stream: CameraStream | None,
    progress: Progress,
) -> None:
    """Log path, sweeps, tracks, images and depth maps."""
    trajectory, tracks, log = run.trajectory(), tracks_in(run.path), recording.log
    origin = trajectory.poses[0, :3, 3]

    def log_at(time: int, entity: str, T: NDArray[np.float64]) -> None:
        """Where an entity is at a time [ns]; what is logged next is of that time."""
        recording.set_time("sweep", sequence=trajectory.nearest(time))
        recording.set_time("time", duration=(time - int(trajectory.times[0])) * 1e-9)
        log(entity, rerun.Transform3D(translation=T[:3, 3] - origin, mat3x3=T[:3, :3]))

    def log_picture(entity: str, picture: Picture) -> None:
        colors = rerun.Image(np.ascontiguousarray(picture[:, :, ::-1]))
        log(entity, colors.compress(jpeg_quality=85))

    log("world", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    path = rerun.LineStrips3D([trajectory.poses[:, :3, 3] - origin], colors=[_PATH_COLOR])
    log("world/path", path, static=True)
    for k in range(len(trajectory)):
        scene = sweep_scene(run, trajectory, k, color, tracks)
        colors = np.rint(255 * scene.colors).astype(np.uint8)
        dots = rerun.Points3D(scene.points, colors=colors, radii=rerun.Radius.ui_points(_POINT))
        log_at(int(trajectory.times[k]), "world/lidar", scene.T_world_lidar)
        log("world/lidar/points", dots)
        log("world/tracks", _boxes(rerun, scene.boxes, origin))
        progress("rerun", k + 1, len(trajectory))
    steps = _DEPTH_STEPS / run.parameters.render.max_depth
    for k, (time, view) in enumerate(camera_views(run, trajectory, camera, stream)):
        if k == 0:
            pinhole = rerun.Pinhole(
                image_from_camera=view.camera.K, width=view.camera.width,
                height=view.camera.height, camera_xyz=rerun.ViewCoordinates.RDF,
                image_plane_distance=_PLANE,
            )  # fmt: skip
            log("world/camera", pinhole, static=True)
        assert view.depth is not None  # of a run
        log_at(time, "world/camera", view.T_world_camera)
        depth = np.rint(np.nan_to_num(view.depth) * steps).clip(0, _DEPTH_STEPS).astype(np.uint16)
        # Near is yellow as in all pictures: so the range is given backwards, in steps.
        span = (_FAR * steps, 0)
        shown = rerun.DepthImage(depth, meter=steps, colormap="viridis", depth_range=span)
        log("world/camera/depth", shown)
        log_picture("depth", colorize(view.depth))
        if view.image is not None:
            log_picture("world/camera/image", view.image)


def _boxes(
    rerun: Any, boxes: list[tuple[Track, NDArray[np.float64]]], origin: NDArray[np.float64]
) -> Any:
    """Tracks, each with its kind and number."""
    middles = [T[:3, 3] - origin + T[:3, 2] * track.size[2] / 2 for track, T in boxes]
    return rerun.Boxes3D(
        centers=np.reshape(middles, (-1, 3)),
        half_sizes=np.reshape([track.size / 2 for track, _ in boxes], (-1, 3)),
        quaternions=np.reshape([matrix_to_quaternion(T[:3, :3]) for _, T in boxes], (-1, 4)),
        colors=np.reshape([track_color(track.id)[::-1] for track, _ in boxes], (-1, 3)),
        labels=[f"{track.kind} {track.id}" for track, _ in boxes],
    )


def _rerun_module() -> Any:
    try:
        import rerun
    except ImportError as error:
        raise MissingExtraError(
            f'this recording needs rerun: pip install "docdepth[rerun]" ({error})'
        ) from None
    return rerun
