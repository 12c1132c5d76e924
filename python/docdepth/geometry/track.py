"""Objects that move: where each one is over time, how large it is and what kind (ours)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import InputError
from docdepth.geometry.se3 import rotation_exp, rotation_log
from docdepth.geometry.trajectory import Trajectory

Kind: TypeAlias = Literal["vehicle", "person", "other"]
KINDS: tuple[Kind, ...] = get_args(Kind)
"""What an object is, by size and motion; a cyclist is a person."""

# Each step of an image asks for the same few times. What is kept is bounded for all tracks
# together: small things that stay lie between large ones, and the heap of a long drive would grow.
_KEPT = 1024

BOX_EDGES = tuple(
    pair for k in range(4) for pair in ((k, (k + 1) % 4), (k + 4, (k + 1) % 4 + 4), (k, k + 4))
)
"""Pairs of :attr:`Track.corners`; 0, 1, 4 and 5 are the front."""

MAX_TRACKS = 0xFFFF
"""Largest id: an instance is the upper half of a SemanticKITTI label."""


@dataclass(frozen=True, eq=False, repr=False)
class Track:
    """One object over the time in which it is known.

    Attributes
    ----------
    id : int
        1 to :data:`MAX_TRACKS`; the instance of its points.
    kind : {"vehicle", "person", "other"}
    times : ndarray of int64, shape (n,)
        Stamps of sweeps [ns], ascending.
    poses : ndarray of float64, shape (n, 4, 4)
        ``T_world_object`` at these stamps. x points forward, z up; the origin is the centre of the
        bottom of the box.
    velocities : ndarray of float64, shape (n, 3)
        World frame [m/s].
    size : ndarray of float64, shape (3,)
        Length, width and height of the box [m].
    points : ndarray of int64, shape (n,)
        Returns of each sweep; 0 where the sweep did not see it.
    deviations : ndarray of float64, shape (n,)
        How well its place is known: the standard deviation [m].
    surface_deviations : ndarray of float64, shape (n,)
        The same of what each sweep saw of its surface, across itself [m]: the place of a lorry may
        be known badly along its side, and that of its side well.
    """

    id: int
    kind: Kind
    times: NDArray[np.int64]
    poses: NDArray[np.float64]
    velocities: NDArray[np.float64]
    size: NDArray[np.float64]
    points: NDArray[np.int64]
    deviations: NDArray[np.float64]
    surface_deviations: NDArray[np.float64]

    def __post_init__(self) -> None:
        count = len(self.times)
        if not 1 <= self.id <= MAX_TRACKS or self.kind not in KINDS:
            raise InputError(
                f"track {self.id}, {self.kind!r}: ids go from 1 to {MAX_TRACKS}, kinds are "
                f"{', '.join(KINDS)}"
            )
        if self.velocities.shape != (count, 3):
            raise InputError(
                f"track {self.id}: {count} times need velocities ({count}, 3), got "
                f"{self.velocities.shape}"
            )
        for name in ("points", "deviations", "surface_deviations"):
            of = getattr(self, name)
            if of.shape != (count,):
                raise InputError(
                    f"track {self.id}: {count} times need {name} ({count},), got {of.shape}"
                )
        if self.size.shape != (3,) or not (self.size > 0).all():
            raise InputError(f"track {self.id}: its size is {self.size}; give three lengths")
        object.__setattr__(self, "times", self._path.times)  # checked, and read-only
        object.__setattr__(self, "poses", self._path.poses)

    def __len__(self) -> int:
        return len(self.times)

    def __repr__(self) -> str:
        length, width, height = self.size
        seconds = int(self.times[-1] - self.times[0]) * 1e-9
        return (
            f"Track(id={self.id}, {self.kind}, {length:.1f} x {width:.1f} x {height:.1f} m, "
            f"{len(self)} sweeps, {seconds:.1f} s)"
        )

    @cached_property
    def _path(self) -> Trajectory:
        return Trajectory(self.times, self.poses)

    @property
    def corners(self) -> NDArray[np.float64]:
        """Corners of the box (8, 3) in the object's frame [m]; :data:`BOX_EDGES` joins them."""
        around = ((0.5, 0.5), (0.5, -0.5), (-0.5, -0.5), (-0.5, 0.5))
        return np.array([(x, y, z) for z in (0, 1) for x, y in around]) * self.size

    def covers(self, time: int) -> bool:
        """Whether ``time`` [ns] lies between the first and the last stamp."""
        return bool(self.times[0] <= time <= self.times[-1])

    def pose_at(self, time: int) -> NDArray[np.float64]:
        """``T_world_object`` (4, 4) at ``time`` [ns].

        Interpolated between stamps. Before the first and after the last one it goes on as it moves
        there. Read-only.
        """
        return _pose_of(self, int(time))

    def velocity_at(self, time: int) -> NDArray[np.float64]:
        """Velocity (3,) at ``time`` [ns] in the world frame [m/s], linear between stamps."""
        return np.array([self._between(time, of_axis) for of_axis in self.velocities.T])

    def deviation_at(self, time: int) -> float:
        """How well the place is known at ``time`` [ns]: standard deviation [m]."""
        return self._between(time, self.deviations)

    def surface_deviation_at(self, time: int) -> float:
        """How well the place of its surface is known at ``time`` [ns], across itself [m]."""
        return self._between(time, self.surface_deviations)

    def _between(self, time: int, values: NDArray[np.float64]) -> float:
        elapsed = (self.times - self.times[0]).astype(np.float64)
        return float(np.interp(float(int(time) - int(self.times[0])), elapsed, values))

    def turn_rate_at(self, time: int) -> NDArray[np.float64]:
        """Rotation vector a second (3,) at ``time`` [ns], world frame [rad/s]."""
        if len(self) < 2:
            return np.zeros(3)
        after = min(max(int(np.searchsorted(self.times, np.int64(time))), 1), len(self) - 1)
        turn = self.poses[after, :3, :3] @ self.poses[after - 1, :3, :3].T
        seconds = int(self.times[after] - self.times[after - 1]) * 1e-9
        return np.asarray(rotation_log(turn) / seconds)


class Tracks(Mapping[int, Track]):
    """The tracks of a drive by id. Those of a time are found without looking at the others.

    Attributes
    ----------
    ids : ndarray of uint16, shape (n,)
    """

    def __init__(self, tracks: Iterable[Track] | Tracks = ()) -> None:
        every = tracks.values() if isinstance(tracks, Tracks) else tracks
        self._by_id = {track.id: track for track in every}
        self._every = list(self._by_id.values())
        self.ids = np.array([track.id for track in self._every], np.uint16)
        self._first = np.array([track.times[0] for track in self._every], np.int64)
        self._last = np.array([track.times[-1] for track in self._every], np.int64)

    def __getitem__(self, number: int) -> Track:
        return self._by_id[number]

    def __len__(self) -> int:
        return len(self._by_id)

    def __iter__(self) -> Iterator[int]:
        return iter(self._by_id)

    def __repr__(self) -> str:
        counts = ((kind, sum(track.kind == kind for track in self._every)) for kind in KINDS)
        kinds = ", ".join(f"{kind}: {count}" for kind, count in counts if count)
        return f"Tracks({len(self)}{'; ' * bool(kinds)}{kinds})"

    def between(self, first: int, last: int) -> list[Track]:
        """Tracks that are known at some time from ``first`` to ``last`` [ns], in their order."""
        some = np.flatnonzero((self._first <= last) & (self._last >= first))
        return [self._every[k] for k in some.tolist()]


@lru_cache(maxsize=_KEPT)
def _pose_of(track: Track, time: int) -> NDArray[np.float64]:
    if track.covers(time):
        pose = track._path.interpolate(time)[0]
    else:
        end = 0 if time < track.times[0] else -1
        seconds = (time - int(track.times[end])) * 1e-9
        pose = track.poses[end].copy()
        pose[:3, 3] += seconds * track.velocities[end]
        pose[:3, :3] = rotation_exp(seconds * track.turn_rate_at(time)) @ pose[:3, :3]
    pose.setflags(write=False)
    return pose
