"""Tracks as text: one row for each track and sweep, and KITTI's labels of what images show."""

from __future__ import annotations

import csv
import io
from array import array
from collections.abc import Iterable
from io import TextIOWrapper
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import DamagedFileError, InputError
from docdepth.geometry.camera import NEAREST, Camera
from docdepth.geometry.se3 import inverse, rotation_exp, transform_points
from docdepth.geometry.track import KINDS, Track, Tracks
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.atomic import WriteFile, write_atomically
from docdepth.io.untrusted import open_file

TRACKS = "tracks.csv"
"""Name of the file in a run and in a synthetic drive."""

_NUMBERS = (
    "x",
    "y",
    "z",
    "yaw",
    "pitch",
    "length",
    "width",
    "height",
    "vx",
    "vy",
    "vz",
    "deviation",
    "surface_deviation",
)
_ROWS = 1000  # that are written at once
COLUMNS = ("frame", "time_ns", "id", "kind", *_NUMBERS, "points")


def write_tracks(
    path: Path,
    tracks: Iterable[Track],
    times: NDArray[np.int64],
    write_file: WriteFile = write_atomically,
) -> None:
    """Write tracks, ordered by sweep and id.

    Parameters
    ----------
    tracks : iterable of Track
        Their times are among ``times``. Of their rotation, heading and slope are written.
    times : ndarray of int64, shape (n,)
        Stamps of all sweeps [ns].
    """
    known = list(tracks)
    frames = [np.searchsorted(times, track.times) for track in known]
    frame = np.concatenate([*frames, np.zeros(0, np.int64)])
    number = np.repeat(np.arange(len(known)), [len(track) for track in known])
    place = np.concatenate([*(np.arange(len(track)) for track in known), np.zeros(0, np.int64)])
    ids = np.array([track.id for track in known], np.int64)
    order = np.lexsort((place, number, ids[number], frame))

    def write(stream: BinaryIO) -> None:
        # Rows are made while they are written: those of a long drive would fill the memory.
        stream.write((",".join(COLUMNS) + "\n").encode())
        for part in np.array_split(order, len(order) // _ROWS + 1):
            text = io.StringIO()
            writer = csv.writer(text, lineterminator="\n")
            for row in part.tolist():
                writer.writerow(_row(known[number[row]], int(place[row]), int(frame[row])))
            stream.write(text.getvalue().encode())

    write_file(path, write)


def _row(track: Track, k: int, frame: int) -> list[object]:
    """Of a track at one of its sweeps."""
    x, y, z = track.poses[k, :3, 0]
    heading = np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))
    values = (*track.poses[k, :3, 3], *heading, *track.size, *track.velocities[k])
    known = track.deviations[k], track.surface_deviations[k]
    numbers = [f"{value:.4f}" for value in (*values, *known)]
    return [frame, int(track.times[k]), track.id, track.kind, *numbers, int(track.points[k])]


def cut_tracks(path: Path, times: NDArray[np.int64]) -> bytes:
    """The rows of a file of tracks at some times, numbered anew; all else to the letter."""
    read_tracks(path)
    frames = {str(time): str(frame) for frame, time in enumerate(times.tolist())}
    text = io.StringIO()
    with TextIOWrapper(open_file(path), "utf-8", newline="") as stream:
        reader = csv.DictReader(stream)
        writer = csv.DictWriter(text, reader.fieldnames or COLUMNS, lineterminator="\n")
        writer.writeheader()
        for row in reader:
            if row["time_ns"] in frames:
                writer.writerow(row | {"frame": frames[row["time_ns"]]})
    return text.getvalue().encode()


def tracks_in(folder: Path) -> Tracks:
    """The tracks of a run folder or a synthetic drive, ordered by id; none where it has no file."""
    path = folder / TRACKS
    return Tracks(read_tracks(path) if path.is_file() else ())


def read_tracks(path: Path) -> list[Track]:
    """Read the tracks of a file that :func:`write_tracks` wrote, ordered by id."""
    try:
        found: dict[int, _Rows] = {}
        with TextIOWrapper(open_file(path), "utf-8", newline="") as stream:
            for row in csv.DictReader(stream):
                number = int(row["id"])
                if number not in found:
                    found[number] = _Rows(row["kind"])
                found[number].add(row)
        return [_track(number, found.pop(number)) for number in sorted(found)]
    except (OSError, csv.Error, KeyError, TypeError, ValueError, OverflowError) as error:
        reason = f"{error}; a file of tracks has the columns {', '.join(COLUMNS)}"
        raise DamagedFileError(path, reason) from None


class _Rows:
    """The rows of a track, as numbers: as texts those of a long drive would fill the memory."""

    def __init__(self, kind: str) -> None:
        self.kind, self.values, self.whole = kind, array("d"), array("q")

    def add(self, row: dict[str, str]) -> None:
        self.values.extend([float(row[name]) for name in _NUMBERS])
        self.whole.extend([int(row["time_ns"]), int(row["points"])])


def _track(number: int, rows: _Rows) -> Track:
    values = np.array(rows.values).reshape(-1, len(_NUMBERS))
    if not np.isfinite(values).all():
        raise ValueError(f"track {number} has a number that is not finite")
    poses = np.repeat(np.eye(4)[None], len(values), axis=0)
    poses[:, :3, 3] = values[:, :3]
    turn = rotation_exp(values[:, 3:4] * (0.0, 0.0, 1.0))
    poses[:, :3, :3] = turn @ rotation_exp(values[:, 4:5] * (0.0, -1.0, 0.0))
    kind = next((kind for kind in KINDS if kind == rows.kind), None)
    if kind is None:
        raise ValueError(f"track {number} has kind {rows.kind!r}")
    times, points = np.array(rows.whole, np.int64).reshape(-1, 2).T.copy()
    try:
        return Track(
            number, kind, times, poses, values[:, 8:11], values[0, 5:8], points, *values[:, 11:].T
        )
    except InputError as error:
        raise ValueError(str(error)) from None


KITTI_TRACKS = "tracks_kitti.txt"
"""Name of the file in a run, one for each camera."""

TYPES = {"vehicle": "Car", "person": "Pedestrian", "other": "Misc"}
"""KITTI's type of each kind of track."""

_UNKNOWN_OCCLUSION = 3


def write_kitti_tracking(
    path: Path,
    tracks: Iterable[Track],
    camera: Camera,
    T_world_camera: Trajectory,
    indices: NDArray[np.int64],
    write_file: WriteFile = write_atomically,
) -> None:
    """Write the boxes of tracks that an image shows, ordered by image and id.

    Parameters
    ----------
    tracks : iterable of Track
        An image has the tracks whose time covers its own.
    T_world_camera : Trajectory
        At the time of each image.
    indices : ndarray of int64, shape (n,)
        Number of each image.
    """
    rows, times = [], T_world_camera.times
    for track in tracks:
        first = int(np.searchsorted(times, track.times[0]))
        end = int(np.searchsorted(times, track.times[-1], side="right"))
        for k in range(first, end):
            T_camera_object = inverse(T_world_camera.poses[k]) @ track.pose_at(int(times[k]))
            row = _kitti_label(track, T_camera_object, camera)
            rows += [(int(indices[k]), track.id, row)] if row else []
    content = "".join(f"{index} {number} {row}\n" for index, number, row in sorted(rows)).encode()
    write_file(path, content)


def box_in_image(
    track: Track, T_camera_object: NDArray[np.float64], camera: Camera
) -> NDArray[np.float64] | None:
    """Least and greatest u and v of the box of an object, (2, 2); None where no image shows it."""
    corners = transform_points(T_camera_object, track.corners)
    in_front = corners[corners[:, 2] > NEAREST]
    if not len(in_front):
        return None
    pixels = (in_front / in_front[:, 2:]) @ camera.K[:2].T
    box = np.stack([pixels.min(0), pixels.max(0)])
    outside = (box[1] < 0).any() or (box[0] > (camera.width - 1, camera.height - 1)).any()
    return None if outside else box


def _kitti_label(track: Track, T_camera_object: NDArray[np.float64], camera: Camera) -> str:
    """A label without image and id; empty if the image does not show the box."""
    box = box_in_image(track, T_camera_object, camera)
    if box is None:
        return ""
    length, width, height = track.size
    (low, high), last = box, np.array([camera.width, camera.height]) - 1
    behind = (transform_points(T_camera_object, track.corners)[:, 2] <= NEAREST).any()
    truncated = int(behind or (low < 0).any() or (high > last).any())
    x, y, z = T_camera_object[:3, 3]
    forward = T_camera_object[:3, 0]
    rotation = np.arctan2(-forward[2], forward[0])
    alpha = np.angle(np.exp(1j * (rotation - np.arctan2(x, z))))
    numbers = [alpha, *low.clip(0, last), *high.clip(0, last)]
    numbers += [height, width, length, x, y, z, rotation]
    text = " ".join(f"{number:.4f}" for number in numbers)
    return f"{TYPES[track.kind]} {truncated} {_UNKNOWN_OCCLUSION} {text}"
