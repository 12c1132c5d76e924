"""Tracks as text: one row for each track and sweep."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import DamagedFileError, InputError
from docdepth.geometry.se3 import rotation_exp
from docdepth.geometry.track import KINDS, Track
from docdepth.io.atomic import WriteFile, write_atomically

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
)
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
    path : Path
    tracks : iterable of Track
        Their times are among ``times``. Of their rotation, heading and slope are written.
    times : ndarray of int64, shape (n,)
        Stamps of all sweeps [ns].
    write_file : callable
    """
    rows = []
    for track in tracks:
        frames = np.searchsorted(times, track.times)
        forward = track.poses[:, :3, 0]
        yaw = np.arctan2(forward[:, 1], forward[:, 0])
        pitch = np.arctan2(forward[:, 2], np.hypot(forward[:, 0], forward[:, 1]))
        for k, frame in enumerate(frames.tolist()):
            place = (*track.poses[k, :3, 3], yaw[k], pitch[k], *track.size, *track.velocities[k])
            numbers = [f"{value:.4f}" for value in (*place, track.deviations[k])]
            row = [frame, int(track.times[k]), track.id, track.kind, *numbers]
            rows.append([*row, int(track.points[k])])
    rows.sort(key=lambda row: (row[0], row[2]))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows(rows)
    content = text.getvalue().encode()
    write_file(path, lambda stream: stream.write(content))


def cut_tracks(path: Path, times: NDArray[np.int64]) -> bytes:
    """The rows of a file of tracks at some times, numbered anew; all else to the letter.

    Parameters
    ----------
    path : Path
    times : ndarray of int64, shape (n,)
        Stamps of the sweeps that are kept [ns].

    Raises
    ------
    RunError
        As for :func:`read_tracks`.
    """
    read_tracks(path)
    frames = {str(time): str(frame) for frame, time in enumerate(times.tolist())}
    text = io.StringIO()
    with path.open(newline="", encoding="utf-8") as stream:
        reader = csv.DictReader(stream)
        writer = csv.DictWriter(text, reader.fieldnames or COLUMNS, lineterminator="\n")
        writer.writeheader()
        for row in reader:
            if row["time_ns"] in frames:
                writer.writerow(row | {"frame": frames[row["time_ns"]]})
    return text.getvalue().encode()


def read_tracks(path: Path) -> list[Track]:
    """Read the tracks of a file that :func:`write_tracks` wrote, ordered by id.

    Raises
    ------
    RunError
        The file is missing, lacks a column, or a row is none.
    """
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            rows = list(csv.DictReader(stream))
        by_id: dict[int, list[dict[str, str]]] = {}
        for row in rows:
            by_id.setdefault(int(row["id"]), []).append(row)
        return [_track(number, by_id[number]) for number in sorted(by_id)]
    except (OSError, csv.Error, KeyError, TypeError, ValueError, OverflowError) as error:
        reason = f"{error}; a file of tracks has the columns {', '.join(COLUMNS)}"
        raise DamagedFileError(path, reason) from None


def _track(number: int, rows: list[dict[str, str]]) -> Track:
    values = np.array([[float(row[name]) for name in _NUMBERS] for row in rows])
    if not np.isfinite(values).all():
        raise ValueError(f"track {number} has a number that is not finite")
    poses = np.repeat(np.eye(4)[None], len(rows), axis=0)
    poses[:, :3, 3] = values[:, :3]
    turn = rotation_exp(values[:, 3:4] * (0.0, 0.0, 1.0))
    poses[:, :3, :3] = turn @ rotation_exp(values[:, 4:5] * (0.0, -1.0, 0.0))
    kind = next((kind for kind in KINDS if kind == rows[0]["kind"]), None)
    if kind is None:
        raise ValueError(f"track {number} has kind {rows[0]['kind']!r}")
    times = np.array([int(row["time_ns"]) for row in rows], np.int64)
    points = np.array([int(row["points"]) for row in rows], np.int64)
    try:
        return Track(
            number, kind, times, poses, values[:, 8:11], values[0, 5:8], points, values[:, 11]
        )
    except InputError as error:
        raise ValueError(str(error)) from None
