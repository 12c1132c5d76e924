"""Whether depth edges of the sweeps lie on the edges of the images, before a run.

The fit that checks the depth maps of a run (:mod:`.calibration`) takes the edges of a few sweeps.
It sees errors of less than two degrees, so it begins anew at larger ones where nothing fits well.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.base import CameraStream, Dataset, Sweep
from docdepth.diagnostics.calibration import FEWEST_EDGES, FEWEST_IMAGES, in_words
from docdepth.diagnostics.depth_edges import Edges, SweepEdges, edges_of_sweeps
from docdepth.diagnostics.edge_fit import EdgeFit, fit_edges, likely_turn, slopes_of
from docdepth.geometry.se3 import (
    matrix_to_quaternion,
    poses_from,
    quaternion_to_matrix,
    rotation_exp,
    rotation_log,
)

Floats = NDArray[np.float64]

OFF = np.array([*np.radians([0.8, 0.8, 1.5]), *[0.2] * 3])
"""Turn [rad] and shift [m] above which a calibration is wrong: sweeps have edges at their beams.

Of few beams, right calibrations seem to roll by up to 1.3 degrees."""

_DEVIATIONS = 2.0  # by which it must lie above
_FITS = 1.2  # score of a fit that is taken without looking at larger errors
_GIVEN_FITS = 1.1  # of `EdgeFit.given`: right ones have 1.13 (dark) to 1.65, others 0.8 to 1.1
_CHANCE = 1.06  # score of edges that fit by chance
_ROUNDS = 2  # fits, each from where the one before it ended
_FARTHEST_DEG, _APART_DEG = 12.0, 3.0  # turns about x and y that fits begin from
_ROLLS_DEG = (-9.0, -6.0, -3.0, 3.0, 6.0, 9.0)
_SHIFTS = (-2.0, -1.0, -0.5, 0.5, 1.0, 2.0)  # metres along each axis
_EVERY = 4  # every fourth edge chooses among them
_SEEN = 0.5  # of the most edges that one of them sees: few may fit by chance
_STARTS = 5  # best ones from which fits begin
_LEAST_TRAVEL = 0.05  # metres
_AT_ONCE = 10_000_000  # nanoseconds in which no vehicle moves far


def find_misalignment(
    recording: Dataset, stream: CameraStream, sweeps: Mapping[int, Sweep] | None = None
) -> str | None:
    """What would fit the images better than the given calibration and times.

    Parameters
    ----------
    recording : Dataset
    stream : CameraStream
        With images.
    sweeps : mapping of int to Sweep, optional
        Those that were read already, by index.

    Returns
    -------
    str or None
        For example ``depth edges of the sweeps fit the images better when the camera turns 1.5
        degrees to the right``; None where the given calibration fits, and where there are too few
        edges to tell.

    Raises
    ------
    DatasetError
        A sweep or an image is damaged.
    """
    sweeps = sweeps or {}
    pairs = _Pairs.of(recording, stream, sweeps)
    if pairs is None:
        return None
    near = found = pairs.fit(np.eye(4))
    if _score(found) < _FITS:
        if _fits_in_another_order(recording, stream, sweeps, found):
            return (
                "depth edges of the sweeps fit the images if the quaternion of the extrinsics is "
                "read in the other order, x y z w or w x y z"
            )
        found = max(found, pairs.far(), key=_score)
    if found is None or found.score < _CHANCE:
        if near is not None and near.given > _GIVEN_FITS:  # the images are dark
            return None
        return "depth edges of the sweeps fit the images by chance only"
    off = pairs.off(recording, found)
    if not off.any():
        return None
    return f"depth edges of the sweeps fit the images better when {in_words(off, 1)}"


def _fits_in_another_order(
    recording: Dataset, stream: CameraStream, sweeps: Mapping[int, Sweep], given: EdgeFit | None
) -> bool:
    """Whether the quaternion of a camera that does not fit has its w at the wrong end."""
    quaternion = matrix_to_quaternion(stream.T_camera_lidar[:3, :3])
    for by in (-1, 1):
        T = stream.T_camera_lidar.copy()
        T[:3, :3] = quaternion_to_matrix(np.roll(quaternion, by))
        other = _Pairs.of(recording, replace(stream, T_camera_lidar=T), sweeps)
        fit = None if other is None else other.fit(np.eye(4), _EVERY)
        if _score(fit) > max(_score(given), _FITS):
            return True
    return False


def _score(fit: EdgeFit | None) -> float:
    return 0.0 if fit is None else fit.score


@dataclass
class _Pairs:
    """Sweeps and the images that were taken meanwhile.

    Attributes
    ----------
    stream : CameraStream
    sweeps : list of SweepEdges
    slopes : list
        Of each image, from :func:`slopes_of`.
    """

    stream: CameraStream
    sweeps: list[SweepEdges]
    slopes: list[list[NDArray[np.float32]]]

    @staticmethod
    def of(recording: Dataset, stream: CameraStream, sweeps: Mapping[int, Sweep]) -> _Pairs | None:
        """None where there are too few edges to tell."""
        found = [one for one in edges_of_sweeps(recording, stream, sweeps) if one.ends.size]
        if len(found) < FEWEST_IMAGES or sum(one.ends.shape[1] for one in found) < FEWEST_EDGES:
            return None
        slopes = []
        for one in found:
            image = stream.rectified_image(one.image)
            assert image is not None
            slopes.append(slopes_of(image, stream.camera))
        return _Pairs(stream, found, slopes)

    def fit(self, start: Floats, every: int = 1) -> EdgeFit | None:
        """The change that fits best near a transform of points in the camera's frame."""
        given = []
        for _ in range(_ROUNDS):
            edges = self._edges(start, every)
            if every * sum(map(len, edges)) < FEWEST_EDGES:
                return None
            fit = fit_edges(edges, self.slopes, self.stream.camera)
            given.append(fit.given)
            start = _transform(fit.change) @ start
        change = np.concatenate([rotation_log(start[:3, :3]), start[:3, 3]])
        return replace(fit, change=change, given=given[0])

    def far(self) -> EdgeFit | None:
        """The best fit from changes that lie farther away.

        Of many starts one fits by chance. So every second image chooses, and the others confirm.
        """
        chosen = self._every_second(0)._best_far()
        if chosen is None:
            return None
        start = _transform(chosen.change)
        others = self._every_second(1).fit(start)
        return self.fit(start) if others is not None and others.given > _GIVEN_FITS else None

    def _every_second(self, first: int) -> _Pairs:
        return _Pairs(self.stream, self.sweeps[first::2], self.slopes[first::2])

    def _best_far(self) -> EdgeFit | None:
        starts = [_transform(change) for change in _far_changes()]
        seen = [self._edges(start, _EVERY) for start in starts]
        counts = [sum(map(len, edges)) for edges in seen]
        likely = []
        for start, edges, count in zip(starts, seen, counts, strict=True):
            if count and count > _SEEN * max(counts):
                score, turn = likely_turn(edges, self.slopes, self.stream.camera)
                likely.append((score, _transform(turn) @ start))
        likely.sort(key=lambda one: -one[0])
        rough = [self.fit(start, _EVERY) for _, start in likely[:_STARTS]]
        return max(rough, key=_score, default=None)

    def _edges(self, change: Floats, every: int) -> list[Edges]:
        T = change @ self.stream.T_camera_lidar
        return [one.seen_by(T, self.stream.camera, every) for one in self.sweeps]

    def off(self, recording: Dataset, fit: EdgeFit) -> Floats:
        """The parts of a change that are surely errors of the calibration; 0 for others.

        A vehicle that drives along with the LiDAR stays where the sweep saw it, so its edges lie
        off by the LiDAR's way from the sweep to the image. A shift like that tells nothing.
        """
        change = fit.change.copy()
        travel = np.median([one.travel for one in self.sweeps], axis=0)
        ahead = self.stream.T_camera_lidar[:3, :3] @ travel
        if np.linalg.norm(ahead) > _LEAST_TRAVEL:
            change[3:] -= np.clip(change[3:] @ ahead / (ahead @ ahead), 0, 1) * ahead
        if self._moved_meanwhile(recording):
            change[3:] = 0
        surely = np.abs(change) - _DEVIATIONS * fit.deviations > OFF
        return np.where(surely, change, 0.0)

    def _moved_meanwhile(self, recording: Dataset) -> bool:
        """Whether the vehicle may have moved from sweeps to images, and no poses tell how far."""
        if recording.poses is not None:
            return False
        times = self.stream.times[[one.image for one in self.sweeps]]
        apart = np.abs(recording.times[:, None] - times).min(axis=0)
        return float(np.median(apart)) > _AT_ONCE


def _far_changes() -> list[Floats]:
    angles = np.radians(np.arange(-_FARTHEST_DEG, _FARTHEST_DEG + 0.1, _APART_DEG))
    turns = [np.array([tilt, pan, 0, 0, 0, 0]) for tilt in angles for pan in angles]
    rolls = [np.radians(roll) * np.eye(6)[2] for roll in _ROLLS_DEG]
    shifts = [metres * axis for axis in np.eye(6)[3:] for metres in _SHIFTS]
    return [*turns, *rolls, *shifts]


def _transform(change: Floats) -> Floats:
    """A turn and a shift as a matrix (4, 4)."""
    return poses_from([rotation_exp(change[:3])], [change[3:]])[0]
