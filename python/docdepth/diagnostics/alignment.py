"""Whether depth edges of the sweeps lie on edges of the images (Levinson and Thrun, 2013).

Where a sweep jumps from one surface to another farther away, an image mostly has an edge, too. With
the right calibration more depth edges lie on image edges than with any other. The score of the
given one is compared with those of a camera that is turned or moved a little, and of images of
other times. Nothing is said where the evidence is thin.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.base import CameraStream, Dataset, Sweep
from docdepth.diagnostics.edge_pairs import EdgePair, edge_pairs, edge_strength, scores_of
from docdepth.geometry.se3 import matrix_to_quaternion, quaternion_to_matrix, rigid, rotation_exp

Scores = NDArray[np.float64]
Change = tuple[float, float, float, float, float, float]
"""Turn of points about the camera's axes x, y, z [deg], then their shift along these [m]."""

_OTHER_TIMES = ", or they are of other times"
"""What may look like a camera that is too far ahead, where times are not fitted."""

_FEWEST_PAIRS = 5  # with less the difference of two scores says nothing
_STEP_DEG, _FARTHEST_DEG = 0.5, 4.0  # turns that are compared
_WIDE_STEP_DEG, _WIDEST_DEG = 1.0, 12.0  # those where none of them fits
_ROLLS_DEG = (-6.0, -4.0, -3.0, 3.0, 4.0, 6.0)
_SHIFTS = (-2.0, -1.0, -0.5, 0.5, 1.0, 2.0)  # metres along each axis
_LIKE_TRAVEL = 0.6  # metres; shifts nearer to the LiDAR's way are told by what drives along
_LEAST_TRAVEL = 0.25  # metres; shorter ways are like no shift that is compared
_IMAGES_OFF = (-3, 3)  # images before and after; neighbours may fit as well
_LEAST_DEG = 1.0  # a smaller turn is no error worth a warning
_SIGNIFICANT = 3.5  # standard errors that the better score lies above
_GAIN = 1.08  # and how much above
_SHARP = 1.25  # best score over that of all turns: what a true fit reaches
_ROLL_GAIN, _ROLL_SHARP = 1.15, 1.4  # of rolls; where all edges are level others fit by chance
_MOVED_GAIN = 1.4  # where the vehicle moved between sweep and image, nobody knows how far
_NO_FIT = 1.15  # score over that of all turns, below which a larger error is looked for
_CHANCE, _CHANCE_ERRORS = 1.08, 2.0  # below it, also in standard errors, there is no fit at all
_AT_ONCE = 10_000_000  # nanoseconds in which no vehicle moves far


def find_misalignment(
    recording: Dataset, stream: CameraStream, sweeps: Mapping[int, Sweep] | None = None
) -> str | None:
    """What would fit the images better than the given calibration and times.

    Parameters
    ----------
    sweeps : mapping of int to Sweep, optional
        Those that were read already, by index.

    Returns
    -------
    str or None
        For example ``depth edges fit the images better when the camera turns 1.5 degrees to the
        right``; None where the given calibration fits best, and where the evidence is thin.
    """
    sweeps = sweeps or {}
    edges = edge_pairs(recording, stream, sweeps)
    if len(edges) < _FEWEST_PAIRS:
        return None
    pairs = _Pairs(edges, stream)
    if not pairs.fit(_NO_FIT) and _fits_in_another_order(recording, stream, sweeps):
        return (
            "depth edges of the sweeps fit the images if the quaternion of the extrinsics is read "
            "in the other order, x y z w or w x y z"
        )
    if not pairs.fit(_NO_FIT) and _fits_mirrored(pairs):
        return (
            "depth edges of the sweeps fit the images if left and right of the points are swapped "
            "(y with the other sign), so that their frame is right-handed"
        )
    moved = _moved_meanwhile(recording, stream, edges)
    better = "depth edges of the sweeps fit the images better when "
    found = pairs.best(pairs.turns, _MOVED_GAIN if moved else _GAIN)
    if moved:
        return None if found is None else better + _with_times(found[0])
    both = [found, pairs.best(pairs.shifts(), _GAIN)]
    known = [one for one in both if one is not None]
    if known:
        return better + _with_times(max(known, key=lambda one: one[1])[0])
    found = pairs.best([(0, 0, roll, 0, 0, 0) for roll in _ROLLS_DEG], _ROLL_GAIN, _ROLL_SHARP)
    if found:
        return better + _with_times(found[0])
    late = pairs.better_images()
    if late:
        when = "later" if late > 0 else "earlier"
        return f"{better}they are taken about {abs(late)} frames {when}"
    if pairs.fit(_NO_FIT):
        return None
    found = pairs.best(_turns(_WIDE_STEP_DEG, _WIDEST_DEG), _GAIN)
    if found:
        return better + _with_times(found[0])
    return "depth edges of the sweeps fit the images by chance only" if pairs.no_fit() else None


def _with_times(change: Change) -> str:
    """A change in words; images of other times look as if the camera went ahead."""
    return in_words(change) + (_OTHER_TIMES if change[5] else "")


def _fits_in_another_order(
    recording: Dataset, stream: CameraStream, sweeps: Mapping[int, Sweep]
) -> bool:
    """Whether the quaternion of a camera that does not fit has its w at the wrong end."""
    quaternion = matrix_to_quaternion(stream.T_camera_lidar[:3, :3])
    for by in (-1, 1):
        T = stream.T_camera_lidar.copy()
        T[:3, :3] = quaternion_to_matrix(np.roll(quaternion, by))
        other = replace(stream, T_camera_lidar=T)
        edges = edge_pairs(recording, other, sweeps)
        if len(edges) >= _FEWEST_PAIRS and _Pairs(edges, other).fit(_SHARP):
            return True
    return False


def _fits_mirrored(pairs: _Pairs) -> bool:
    """Whether a camera that does not fit the sweeps fits their mirror image, left for right."""
    edges = [replace(pair, ends=pair.ends * (1, -1, 1)) for pair in pairs.edges]
    mirrored = _Pairs(edges, pairs.stream)
    return mirrored.fit(_NO_FIT) and _is_better(mirrored.given, pairs.given, _MOVED_GAIN)


def _moved_meanwhile(recording: Dataset, stream: CameraStream, edges: Sequence[EdgePair]) -> bool:
    """Whether the vehicle may have moved between sweeps and images, and no poses tell how far."""
    if recording.poses is not None:
        return False
    times = stream.times[[pair.image for pair in edges]]
    apart = np.abs(recording.times[:, None] - times).min(axis=0)
    return float(np.median(apart)) > _AT_ONCE


@dataclass
class _Pairs:
    """Scores of the pairs as given, and after changes.

    Attributes
    ----------
    given : ndarray of float64, shape (n,)
        Of each pair with the given calibration.
    chance : ndarray of float64, shape (n,)
        Of each pair on average over all turns.
    """

    edges: Sequence[EdgePair]
    stream: CameraStream

    def __post_init__(self) -> None:
        self.turns = _turns(_STEP_DEG, _FARTHEST_DEG)
        self.given = self._after((0, 0, 0, 0, 0, 0))
        self._turned = np.array([self._after(turn) for turn in self.turns])
        self.chance: Scores = self._turned.mean(axis=0)

    def fit(self, least: float) -> bool:
        """Whether the given calibration is so many times better than all turns."""
        return bool(self.given.mean() > least * self.chance.mean())

    def best(
        self, changes: Sequence[Change], gain: float, sharp: float = _SHARP
    ) -> tuple[Change, float] | None:
        """The change that fits best and its score, if it is clearly better than the given."""
        scores = self._turned
        if changes is not self.turns:
            scores = np.array([self._after(change) for change in changes])
        mean = scores.mean(axis=1)
        k = int(mean.argmax())
        small = 0 < np.linalg.norm(changes[k][:3]) < _LEAST_DEG or not any(changes[k])
        if small or mean[k] < sharp * self.chance.mean():
            return None
        return (changes[k], float(mean[k])) if _is_better(scores[k], self.given, gain) else None

    def shifts(self) -> list[Change]:
        """Shifts that are compared.

        A vehicle that drives along with the LiDAR stays where the sweep saw it, so its edges lie
        off by the LiDAR's way from the sweep to the image. A shift like that tells nothing.
        """
        travel = np.median([pair.travel for pair in self.edges], axis=0)
        ahead = self.stream.T_camera_lidar[:3, :3] @ travel
        if np.linalg.norm(ahead) < _LEAST_TRAVEL:
            return _shifts()
        return [s for s in _shifts() if np.linalg.norm(ahead - s[3:]) > _LIKE_TRAVEL]

    def better_images(self) -> int:
        """How many images later those fit better; 0 if the given ones are best."""
        best, best_score = 0, max(float(self.given.mean()), _SHARP * float(self.chance.mean()))
        for off in _IMAGES_OFF:
            others, inside = [], []
            for k, pair in enumerate(self.edges):
                if 0 <= pair.image + off < len(self.stream.images):
                    strength = edge_strength(self.stream, pair.image + off)
                    others.append(replace(pair, image=pair.image + off, strength=strength))
                    inside.append(k)
            if len(others) < _FEWEST_PAIRS:
                continue
            scores = scores_of(others, self.stream, np.eye(4))
            if scores.mean() > best_score and _is_better(scores, self.given[inside], _GAIN):
                best, best_score = off, float(scores.mean())
        return best

    def no_fit(self) -> bool:
        """Whether the given calibration is no better than any other."""
        if not self.chance.all():  # nothing of a sweep falls into the image, which is told
            return False
        share = self.given / self.chance
        error = share.std(ddof=1) / np.sqrt(len(share))
        return bool(share.mean() < _CHANCE and share.mean() - 1 < _CHANCE_ERRORS * error)

    def _after(self, change: Change) -> Scores:
        T = rigid(rotation_exp(np.radians(change[:3])), change[3:])
        return scores_of(self.edges, self.stream, T)


def _turns(step: float, farthest: float) -> list[Change]:
    angles = np.arange(-farthest, farthest + step / 2, step).tolist()
    return [(tilt, pan, 0, 0, 0, 0) for tilt in angles for pan in angles]


def _shifts() -> list[Change]:
    along = [(s, 0.0, 0.0) for s in _SHIFTS]
    every = [*along, *((0.0, s, 0.0) for s in _SHIFTS), *((0.0, 0.0, s) for s in _SHIFTS)]
    return [(0, 0, 0, *shift) for shift in every]


def _is_better(scores: Scores, given: Scores, least_gain: float) -> bool:
    """Whether scores of the pairs, one by one, lie above the given ones beyond chance."""
    gain = scores - given
    error = gain.std(ddof=1) / np.sqrt(len(gain)) + 1e-9
    return bool(
        gain.mean() > _SIGNIFICANT * error
        and (gain > 0).sum() >= len(gain) - 1
        and scores.mean() > least_gain * given.mean()
    )


def in_words(change: Change) -> str:
    """A change of points as one of the camera, the other way: what the camera does."""

    def told(unit: str, *moves: tuple[float, str, str]) -> str:
        return " and ".join(
            f"{abs(size):g} {unit} {one if size > 0 else other}"
            for size, one, other in moves
            if size
        )

    tilt, pan, roll, x, y, z = change
    left_right = "to the left", "to the right"
    clockwise = "counterclockwise", "clockwise"
    turn = told("degrees", (pan, *left_right), (tilt, "down", "up"), (roll, *clockwise))
    shift = told("m", (x, *left_right), (y, "up", "down"), (z, "back", "forward"))
    parts = [f"turns {turn}"] if turn else []
    parts += [f"moves {shift}"] if shift else []
    return f"the camera {' and '.join(parts)}"
