"""Whether sweeps without times of points are as measured, or motion compensated already.

A few sweeps are registered both ways, with times from the rotation of the LiDAR and without. What
is right makes the world sharper: points take fewer voxels, and lie nearer to surfaces that were
seen before. Sweeps as measured are also tried in all directions of rotation and with all seams that
their rows allow, and as often from one stamp to the next as they may turn: of many drives every
second or fifth sweep is kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

import docdepth._core as _core
from docdepth.config import OdometryParameters
from docdepth.datasets.base import Dataset, Sweep
from docdepth.datasets.files import readable
from docdepth.datasets.point_times import SHARE_BEFORE, USUAL_PERIOD, Instant, median_period
from docdepth.datasets.views import FrameRange, RecordingView, TurningLidar
from docdepth.errors import Finding, OdometryError
from docdepth.geometry.se3 import transform_points
from docdepth.geometry.turn import Turn, possible_turns
from docdepth.odometry.deskewing import centred_motion
from docdepth.odometry.first_motion import first_motion
from docdepth.odometry.passes import register
from docdepth.odometry.registration_log import RegistrationLog
from docdepth.odometry.smoothing import smoothed
from docdepth.odometry.sweeps import FINE_SAMPLING, SweepPart, ThinnedSweeps, deskewed_points

_LENGTH = 10  # sweeps of a piece of the drive
_FEWEST = 6  # sweeps of a drive, and of a piece
_PLACES = (0.3, 0.7)  # of a drive, where pieces are taken
_MOVING = 0.15  # metres a sweep; slower ones hardly skew
_VOXEL = 0.2  # metres
_REACH = 50.0  # metres; farther voxels hold one point each
_SLOW, _FAST = 10, 20  # revolutions a second of most LiDARs; some turn five times
_APART = 4  # sweeps between those that are held against each other
_NEAR, _MOST_OFF = 1.0, 0.5  # metres, from a point and from its surface
_NEIGHBORS = 10  # points from which a surface is taken


class Sharpness(NamedTuple):
    """How sharp the world is that a few sweeps show; the less, the sharper."""

    voxels: int  # of 0.2 m, that hold points
    off: float  # mean distance of points from surfaces of an earlier sweep [m]

    @property
    def blur(self) -> float:
        """Both in one."""
        return self.voxels * self.off


@dataclass(frozen=True)
class Skew:
    """What the sweeps of a recording are, and what tells it."""

    # unknown, where two pieces of the drive disagree
    state: Literal["measured", "compensated", "unknown"]
    # how the LiDAR turned, if the sweeps are as measured; else that which fits best. Its stamp is
    # taken for the middle of the sweep: elsewhere, the motion is not that of the whole sweep
    turn: Turn
    # measured, compensated: of the world by sweeps deskewed with times of that turn, and by sweeps
    # as they are
    measured: Sharpness
    compensated: Sharpness

    def figures(self) -> str:
        """The figures in words."""
        seen = [
            f"{100 * one.off:.2f} cm from surfaces seen before, in {one.voxels} voxels"
            for one in (self.measured, self.compensated)
        ]
        return (
            f"with times by rotation ({self.turn}) points lie {seen[0]}, and as they are {seen[1]}"
        )


def find_skew(recording: Dataset) -> Skew | None:
    """Find whether the sweeps of a recording are as measured.

    Parameters
    ----------
    recording : Dataset
        Of one LiDAR. What it says of times and of motion compensation is not asked.

    Returns
    -------
    Skew or None
        None where nothing can tell: of a LiDAR that does not spin, or hardly moves.
    """
    ways = _turns_of(recording)
    if not ways or len(recording) < _FEWEST:
        return None
    pieces = _pieces(recording)
    if len(pieces) < (1 if len(ways) == 1 else 2):  # the best of many needs a second proof
        return None
    turns = [replace(way, revolutions=n) for way in ways for n in _revolutions(recording)]
    first = {turn: pieces[0].sharpness(turn) for turn in turns}
    turn = min(first, key=lambda turn: first[turn].blur)
    measured = [first[turn], *(piece.sharpness(turn) for piece in pieces[1:])]
    compensated = [piece.sharpness(None) for piece in pieces]
    sharper = {one.blur < other.blur for one, other in zip(measured, compensated, strict=True)}
    state: Literal["measured", "compensated", "unknown"] = "unknown"
    if len(sharper) == 1:
        state = "measured" if sharper.pop() else "compensated"
    return Skew(state, turn, _mean(measured), _mean(compensated))


def find_rotation(
    recording: Dataset, stamp: Instant | None = None
) -> tuple[Turn | None, list[Finding]]:
    """How the LiDAR turns, if its sweeps are as measured, and what tells it.

    Parameters
    ----------
    recording : Dataset
        Its z is up. One that is said to be motion compensated is doubted.
    stamp : {"start", "middle", "end"}, optional
        Which instant of a sweep its time is. If it is not known the middle, which is least wrong.

    Returns
    -------
    turn : Turn or None
        None if the sweeps are not, or cannot be told to be, as measured.
    found : list of Finding
        Empty of a LiDAR that does not spin, or hardly moves.
    """
    said = recording.sweep(0).motion_compensated
    try:
        skew = find_skew(recording)
    except OdometryError:  # which tells nothing of the times
        return None, []
    if skew is None:
        return None, []
    turn = replace(skew.turn, before_stamp=SHARE_BEFORE[stamp or "middle"])
    where, figures = str(recording.path), skew.figures()
    if skew.state == "measured" and said:
        text = f"docdepth.yaml says motion_compensated: true, but {figures}: they are as measured"
        remedy = "say motion_compensated: false"
        return turn, [Finding("not-compensated", where, text, remedy)]
    if skew.state == "measured":
        text = f"points have no times, and sweeps are as measured: {figures}; these times are taken"
        remedy = "if they are deskewed already, say motion_compensated: true in docdepth.yaml"
        return turn, [Finding("times-by-rotation", where, text, remedy)]
    if said:
        return None, []
    if skew.state == "compensated":
        text = f"points have no times, and sweeps are taken as motion compensated: {figures}"
        remedy = "say motion_compensated: true in docdepth.yaml"
        return None, [Finding("taken-as-compensated", where, text, remedy)]
    text = f"points have no times, and it is not clear whether sweeps are as measured: {figures}"
    remedy = "say motion_compensated in docdepth.yaml, and bring times of points if you can"
    return None, [Finding("skew-unknown", where, text, remedy)]


def _mean(pieces: Sequence[Sharpness]) -> Sharpness:
    voxels, off = np.mean(pieces, axis=0).tolist()
    return Sharpness(round(voxels), off)


def _turns_of(recording: Dataset) -> list[Turn]:
    """In which ways the LiDAR may turn, where sweeps from all over the drive agree."""
    places = sorted({int(share * (len(recording) - 1)) for share in (0.0, *_PLACES)})
    sweeps = readable(recording.sweep, places, len(recording)).values()
    found = [possible_turns(sweep.points, sweep.ring) for sweep in sweeps]
    return found[0] if found and all(turns == found[0] for turns in found) else []


def _revolutions(recording: Dataset) -> list[int]:
    """How often the LiDAR may turn from one stamp to the next: often, if sweeps were left out."""
    seconds = (median_period(recording.times) or USUAL_PERIOD) * 1e-9
    if round(_SLOW * seconds) < 2:
        return [1]
    return sorted({1, round(_SLOW * seconds), round(_FAST * seconds)})


def _pieces(recording: Dataset) -> list[_Piece]:
    """The fastest pieces of the drive, in which the LiDAR moves."""
    last = max(0, len(recording) - _LENGTH)
    starts = list(dict.fromkeys(int(share * last) for share in _PLACES))
    if last < _LENGTH:  # two pieces would share sweeps
        starts = starts[:1]
    pieces = [_Piece(recording, start) for start in starts]
    moving = [piece for piece in pieces if piece.speed > _MOVING]
    return sorted(moving, key=lambda piece: -piece.speed)


class _Piece(RecordingView):
    """A few sweeps of a drive in a row, each read once."""

    def __init__(self, recording: Dataset, start: int) -> None:
        end = min(start + _LENGTH, len(recording))
        super().__init__(FrameRange(recording, f"{start}:{end}"))
        self._parameters, self._read = OdometryParameters(), dict[int, Sweep]()
        found = first_motion(self._thinned(TurningLidar(self, None)), range(len(self)))
        self._motion = np.eye(4) if found is None else found
        self.speed = float(np.linalg.norm(self._motion[:3, 3]))
        """Metres a sweep at the start."""

    def sweep(self, index: int) -> Sweep:
        """Sweep ``index`` of the piece."""
        if index not in self._read:
            self._read[index] = super().sweep(index)
        return self._read[index]

    def sharpness(self, turn: Turn | None) -> Sharpness:
        """Of the world that the sweeps show, with times of a turn, or of one instant each."""
        sweeps, log = self._thinned(TurningLidar(self, turn)), RegistrationLog()
        part = SweepPart(sweeps, range(len(sweeps)))
        states = register(part, self._parameters, self._motion, None, 1, log, [])
        poses = np.stack(list(smoothed(states)))
        motions, worlds = centred_motion(poses, self.times), []
        for k, (pose, motion) in enumerate(zip(poses, motions, strict=True)):
            points = deskewed_points(sweeps[k], k, motion).astype(np.float64)
            points = points[np.linalg.norm(points, axis=1) < _REACH]
            worlds.append(transform_points(pose, points))
        return Sharpness(_voxels(worlds), _distance_off(worlds))

    def _thinned(self, recording: Dataset) -> ThinnedSweeps:
        return ThinnedSweeps(recording, self._parameters, FINE_SAMPLING, _LENGTH)


def _voxels(clouds: Sequence[NDArray[np.float64]]) -> int:
    """How many voxels hold points (N, 3)."""
    edge = np.array([1, 1 << 20, 1 << 40])
    keys = [np.unique(np.floor(cloud / _VOXEL).astype(np.int64) @ edge) for cloud in clouds]
    return len(np.unique(np.concatenate(keys)))


def _distance_off(clouds: Sequence[NDArray[np.float64]]) -> float:
    """Mean distance of points from the surfaces of an earlier cloud [m]."""
    thin = [cloud.astype(np.float32) for cloud in clouds]
    apart, means = min(_APART, len(clouds) - 1), []
    for before, after in zip(thin, thin[apart:], strict=False):
        normals = _core.OrientedPoints(before, _NEIGHBORS, 1).normals
        rows, distance = _core.nearest_neighbors(before, after, 1)
        off = np.abs(np.einsum("ij,ij->i", normals[rows], after - before[rows]))
        known = normals[rows].any(axis=1)
        means.append(np.minimum(off, _MOST_OFF)[known & (distance < _NEAR)].mean())
    return float(np.mean(means))
