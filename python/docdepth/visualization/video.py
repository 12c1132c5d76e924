"""A video of a run: the camera images above the colours of their depth."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.base import CameraStream
from docdepth.errors import RunError
from docdepth.io.depth import DESCRIPTION, maps_in, read_depth
from docdepth.io.run_folder import RunFolder
from docdepth.visualization import pictures as visualize
from docdepth.visualization.report import write_index


def write_video(
    run: RunFolder,
    folder: str = "",
    stream: CameraStream | None = None,
    fps: float | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> Path:
    """Write the depth maps of a camera to ``report/video.webm``, in order of time.

    The codec is VP8: OpenCV writes it on every machine, browsers and notebooks play it.

    Parameters
    ----------
    run : RunFolder
    folder : str
        The camera's folder in ``depth/``; empty for the only camera of a run.
    stream : CameraStream, optional
        The camera; its images, if available, are shown above the depth.
    fps : float, optional
        Images per second; the recorded rate if absent.
    progress : callable, optional
        Called with "video", the number of images done and of all images.

    Returns
    -------
    Path
        Of the video.

    Raises
    ------
    RunError
        A depth map is missing, or the video cannot be written.
    DatasetError
        A depth map or an image is damaged.
    """
    depths = run.path / "depth" / folder
    maps, times = maps_in(depths), _times(depths / DESCRIPTION)
    names = sorted(times, key=times.__getitem__)
    missing = [name for name in names if name not in maps]
    if missing or not names:
        raise RunError(
            f"{depths} lacks {missing[0] if missing else 'all'} of its depth maps; "
            f"run: docdepth render {run.path}"
        )
    if fps is None:
        pause = np.diff([times[name] for name in names]) * 1e-9
        fps = float(1 / np.median(pause)) if len(pause) else 1.0
    images = {name: k for k, name in enumerate(stream.names)} if stream else {}
    path = run.path / "report" / folder / "video.webm"
    part = path.with_name(".video.part.webm")
    path.parent.mkdir(parents=True, exist_ok=True)
    writer: cv2.VideoWriter | None = None
    # OpenCV opens no path that is not UTF-8, so it gets the folder as a number.
    opened = os.open(path.parent, os.O_RDONLY)
    named = Path(f"/proc/self/fd/{opened}") / part.name
    try:
        for done, name in enumerate(names):
            image = stream.rectified_image(images[name]) if stream and name in images else None
            frame = _frame(read_depth(maps[name]), image)
            if writer is None:
                writer = _writer(named, fps, frame)
            writer.write(frame)
            if progress:
                progress("video", done + 1, len(names))
        if writer is not None:
            writer.release()
        if _frames(named) != len(names):  # OpenCV does not report errors
            raise RunError(
                f"cannot write {path}: OpenCV stopped early; make room on the disk and try again"
            )
        made_of = run.recorded_key(depths / DESCRIPTION).get("render", "")
        with run.lock("video"):
            run.move_into_place(part, path, {"render": made_of})
            write_index(run)
    finally:
        part.unlink(missing_ok=True)
        os.close(opened)
    return path


def _writer(path: Path, fps: float, frame: NDArray[np.uint8]) -> cv2.VideoWriter:
    code = cv2.VideoWriter.fourcc(*"VP80")
    # OpenCV prints a warning about WebM's codec tags to standard error, though it writes the file.
    stderr, null = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(null, 2)
        return cv2.VideoWriter(str(path), code, fps, (frame.shape[1], frame.shape[0]))
    finally:
        os.dup2(stderr, 2)
        os.close(stderr)
        os.close(null)


def _times(path: Path) -> dict[str, int]:
    """Time of each depth map [ns]."""
    try:
        maps = json.loads(path.read_text())["maps"]
        return {name: int(known["time_ns"]) for name, known in maps.items()}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise RunError(f"{path} cannot be read ({error!r}); render again") from None


def _frame(depth: NDArray[np.float32], image: NDArray[np.uint8] | None) -> NDArray[np.uint8]:
    colours = visualize.colorize(depth)
    both = colours if image is None else np.vstack([image, colours])
    # VP8 needs even sizes.
    padding = (0, both.shape[0] % 2, 0, both.shape[1] % 2)
    return np.asarray(cv2.copyMakeBorder(both, *padding, cv2.BORDER_REPLICATE), np.uint8)


def _frames(path: Path) -> int:
    if not path.is_file():
        return 0
    reader = cv2.VideoCapture(str(path))
    count = int(reader.get(cv2.CAP_PROP_FRAME_COUNT))
    reader.release()
    return count
