"""Videos of a run: the camera images above the colours of their depth, and sweeps from above."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from docdepth.concurrency import Progress, null_progress
from docdepth.datasets.base import CameraStream
from docdepth.errors import MissingExtraError, RunError
from docdepth.geometry.se3 import transform_points
from docdepth.geometry.track import Tracks
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.depth import DESCRIPTION, described_maps, maps_in, read_depth
from docdepth.io.run_folder import RunFolder
from docdepth.io.tracks import tracks_in
from docdepth.io.untrusted import read_file
from docdepth.visualization.image_views import photo_of, track_color, write_text
from docdepth.visualization.pictures import BACKGROUND, Picture, colorize, draw_classes

_ABOVE = (1280, 960)  # width and height of the video from above [pixels]
_REACH = 50.0  # from the LiDAR to the left and right edge [m]
_PAST = 2_000_000_000  # of which tracks draw their path [ns]


def write_video(
    run: RunFolder,
    folder: str = "",
    stream: CameraStream | None = None,
    fps: float | None = None,
    mp4: bool = False,
    progress: Progress = null_progress,
) -> Path:
    """Write the depth maps of a camera to ``report/video.webm``, in order of time.

    The codec is VP8: OpenCV writes it on every machine, browsers and notebooks play it. With `mp4`
    it is H.264 in ``video.mp4``, which phones and PowerPoint play, too.

    Parameters
    ----------
    folder : str
        The camera's folder in ``depth/``; empty for the only camera of a run.
    stream : CameraStream, optional
        The camera; its images, if available, are shown above the depth.
    fps : float, optional
        Images per second; the recorded rate if absent.
    mp4 : bool
        Needs ``docdepth[mp4]``.
    """
    depths = run.path / "depth" / folder
    maps, known = maps_in(depths), described_maps(depths)
    names = sorted(known, key=lambda name: known[name][0])
    missing = [name for name in names if name not in maps]
    if missing or not names:
        raise RunError(
            f"{depths} lacks {missing[0] if missing else 'all'} of its depth maps",
            f"make them: `docdepth.run(..., {str(run.path)!r})`",
        )

    def frames() -> Iterator[Picture]:
        for name in names:
            picture, photo = colorize(read_depth(maps[name])), photo_of(stream, name)
            both = picture if photo is None else np.vstack([photo, picture])
            # The codecs need even sizes.
            padding = (0, both.shape[0] % 2, 0, both.shape[1] % 2)
            yield np.asarray(cv2.copyMakeBorder(both, *padding, cv2.BORDER_REPLICATE), np.uint8)

    key = {"render": run.recorded_key(depths / DESCRIPTION).get("render", "")}
    path, times = run.path / "report" / folder / "video", [known[name][0] for name in names]
    return _write(run, path, frames(), times, fps, mp4, key, progress)


def write_video_from_above(
    run: RunFolder,
    fps: float | None = None,
    mp4: bool = False,
    progress: Progress = null_progress,
) -> Path:
    """Write the sweeps from above, with classes and tracks, to ``report/above.webm``.

    The LiDAR stays in the middle and the world's x points to the right. Ground is blue, what stands
    grey, what moves orange. Boxes have the colours and numbers of their tracks; lines tell where
    they were in the last seconds.
    """
    trajectory, tracks = run.trajectory(), tracks_in(run.path)
    frames = (sweep_from_above(run, trajectory, tracks, k) for k in range(len(trajectory)))
    key = {"classify": run.stage("classify").key or ""}
    path = run.path / "report" / "above"
    return _write(run, path, frames, trajectory.times, fps, mp4, key, progress)


def sweep_from_above(run: RunFolder, trajectory: Trajectory, tracks: Tracks, index: int) -> Picture:
    """One picture of :func:`write_video_from_above`."""
    record, classid = run.classified_frame(index)
    pose, time = trajectory.poses[index], int(trajectory.times[index])
    middle, scale = pose[:2, 3], _ABOVE[0] / (2 * _REACH)

    def pixels(places: NDArray[np.floating]) -> NDArray[np.int32]:
        across = (places[:, :2] - middle) * (scale, -scale) + np.array(_ABOVE) / 2
        return np.rint(across).astype(np.int32)

    finite = np.isfinite(record.points).all(axis=1)
    columns, rows = pixels(transform_points(pose, record.points[finite])).T
    picture = np.full((_ABOVE[1], _ABOVE[0], 3), BACKGROUND, np.uint8)
    draw_classes(picture, rows, columns, classid[finite])
    for track in tracks.between(time, time):
        color = track_color(track.id)
        past = track.poses[(track.times <= time) & (track.times > time - _PAST)][:, :3, 3]
        cv2.polylines(picture, [pixels(past)], False, color, 1, cv2.LINE_AA)
        T = track.pose_at(time)
        corners = pixels(transform_points(T, track.corners[:4]))
        cv2.polylines(picture, [corners], True, color, 2, cv2.LINE_AA)
        left, right = corners[:2].tolist()
        cv2.line(picture, left, right, (255, 255, 255), 2, cv2.LINE_AA)
        write_text(picture, str(track.id), tuple(corners.max(axis=0).tolist()), color)
    start, end = pixels(np.array([pose[:3, 3], pose[:3, 3] + 3 * pose[:3, 0]])).tolist()
    cv2.arrowedLine(picture, start, end, (255, 255, 255), 2, cv2.LINE_AA, tipLength=0.4)
    seconds = (time - int(trajectory.times[0])) * 1e-9
    write_text(picture, f"sweep {index}, {seconds:.1f} s", (10, 24), (255, 255, 255))
    left, right = (10, _ABOVE[1] - 14), (10 + round(10 * scale), _ABOVE[1] - 14)
    cv2.line(picture, left, right, (255, 255, 255), 2)
    write_text(picture, "10 m", (14, _ABOVE[1] - 22), (255, 255, 255))
    return picture


def _write(
    run: RunFolder,
    path: Path,
    frames: Iterable[Picture],
    times: Sequence[int] | NDArray[np.int64],
    fps: float | None,
    mp4: bool,
    key: dict[str, str],
    progress: Progress,
) -> Path:
    """Encode frames, one for each time [ns], to a video of a run; `path` lacks its ending."""
    if fps is None:
        fps = float(1e9 / np.median(np.diff(times))) if len(times) > 1 else 1.0
    begin, ending = (_H264, ".mp4") if mp4 else (_vp8, ".webm")
    path = path.with_suffix(ending)
    part = path.with_name(f".{path.stem}.part{ending}")
    with run.lock("video"):  # which tells of a folder that cannot be written before all is drawn
        path.parent.mkdir(parents=True, exist_ok=True)
    writer: _Writer | None = None
    opened, named = os.open(path.parent, os.O_RDONLY), str(part)
    if not named.isprintable():  # OpenCV opens UTF-8 only, so it gets the folder as a number
        named = f"/proc/{os.getpid()}/fd/{opened}/{part.name}"
    try:
        for done, frame in enumerate(frames):
            writer = writer or begin(named, fps, frame)
            writer.write(frame)
            progress("video", done + 1, len(times))
        if writer is not None:
            writer.release()
        written = cv2.VideoCapture(named) if part.is_file() else None
        if written is None or written.get(cv2.CAP_PROP_FRAME_COUNT) != len(times):
            raise RunError(  # OpenCV does not report errors
                f"cannot write {path}: OpenCV stopped early; make room on the disk and try again"
            )
        with run.lock("video"):
            run.write(path, read_file(part), key)
    finally:
        part.unlink(missing_ok=True)
        os.close(opened)
    return path


class _Writer(Protocol):
    def write(self, frame: Picture, /) -> object: ...
    def release(self) -> None: ...


class _H264:
    """An MP4 by FFmpeg, as a program of its own: OpenCV has no encoder for H.264."""

    def __init__(self, path: str, fps: float, frame: Picture) -> None:
        try:
            from imageio_ffmpeg import write_frames
        except ImportError as error:
            raise MissingExtraError(
                'MP4 needs imageio-ffmpeg: pip install "docdepth[mp4]"'
            ) from error
        height, width = frame.shape[:2]
        # What players need first stands first; the sizes are even, which is all that they need.
        self._frames = write_frames(
            path, (width, height), "bgr24", fps=fps, codec="libx264",
            macro_block_size=2, output_params=["-movflags", "+faststart"], ffmpeg_log_level="quiet",
        )  # fmt: skip
        self._frames.send(None)
        self._path = path

    def write(self, frame: Picture, /) -> None:
        try:
            self._frames.send(np.ascontiguousarray(frame))
        except OSError as error:
            raise RunError(
                f"cannot write {self._path}: FFmpeg stopped early; make room on the disk"
            ) from error

    def release(self) -> None:
        self._frames.close()


def _vp8(path: str, fps: float, frame: Picture) -> cv2.VideoWriter:
    code = cv2.VideoWriter.fourcc(*"VP80")
    # OpenCV prints a warning about WebM's codec tags to standard error, though it writes the file.
    stderr, null = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(null, 2)
        return cv2.VideoWriter(path, code, fps, (frame.shape[1], frame.shape[0]))
    finally:
        os.dup2(stderr, 2)
        os.close(stderr)
        os.close(null)
