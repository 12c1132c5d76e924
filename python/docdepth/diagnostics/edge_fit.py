"""By which change of the extrinsic depth edges fall onto image edges.

The fit turns and moves the camera, and takes the images a little earlier or later, so that as much
change of brightness as possible lies below the depth edges of all images together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from docdepth.diagnostics.depth_edges import REACH, Edges, pixels_a_sample
from docdepth.geometry.camera import Camera

Floats = NDArray[np.float64]

_WIDTHS = (3.0, 2.0)  # samples that an image edge is smeared over, one fit after the other
_START_DEG = np.arange(-1.6, 1.61, 0.2)  # turns about x and y that the fit may start from
_START_EDGES = 5000  # that choose the starts
_STARTS = 5  # best ones from which fits begin; a lane marking may look like an edge of depth
# What nobody need see; keeps fits bounded. Straight ahead at an even pace, a time is no more than a
# camera farther ahead, and clocks err by more of the way than rulers.
_USUAL = np.array([*np.radians([1.0] * 3), *[0.03] * 3, 0.02, *[2e-3] * 2])
_PARTS = len(_USUAL)
_FIXED = 0.01  # of what is usual, where a part is not free
_WEIGHT_OF_USUAL = 0.01  # of a score that is 1 by chance
_STEPS = 25
_MOVED = 0.01  # samples; smaller steps end the fit
_CELLS = (8, 3)  # parts of the image, columns and rows, whose edges err together


@dataclass(frozen=True)
class EdgeFit:
    """The change that takes depth edges to image edges."""

    # (7,): of points in the camera's frame: turn about its axes x, y, z [rad], then shift [m]; and
    # what to add to the times of the images [s]
    change: Floats
    # (7, 7): images, and parts of the image, are taken to err each as a whole: edges of one object,
    # and of a vehicle that stands, repeat the same error
    covariance: Floats
    # (2,): by how much things are drawn too wide on each side, along rows and columns [rad]
    half_beam: Floats
    score: float  # change of brightness below depth edges over that beside them; 1 is chance
    gains: Floats  # (images,): by how much the score of each image grows
    # (2,): displacement of image edges from depth edges to the right and down, in the median
    pixels: Floats

    @property
    def turn_deg(self) -> Floats:
        return np.degrees(self.change[:3])

    @property
    def shift_m(self) -> Floats:
        return self.change[3:6]

    @property
    def time_ms(self) -> float:
        return 1e3 * float(self.change[6])

    def of_points(self, motion: Floats) -> Floats:
        """Turn and shift (6,) of points where they move by ``motion`` a second."""
        result: Floats = self.change[:6] + self.change[6] * motion
        return result

    @property
    def deviations(self) -> Floats:
        """One standard deviation of each of :attr:`change`."""
        return np.sqrt(np.diag(self.covariance))


@dataclass(frozen=True)
class ImageEdges:
    """Depth edges of some images, and what the images show there.

    Attributes
    ----------
    edges : sequence of Edges
        Of each image; one of them has some.
    samples : sequence of ndarray
        Of each image, from :func:`profiles`.
    motions : sequence of ndarray of float64, shape (6,)
        Of standing points in the camera's frame at each image, by which a second turns and shifts
        them [rad, m].
    """

    camera: Camera
    edges: Sequence[Edges]
    samples: Sequence[NDArray[np.float32]]
    motions: Sequence[Floats]

    def some(self, images: Sequence[int] | NDArray[np.int64]) -> ImageEdges:
        """Those of some images."""
        return ImageEdges(
            self.camera,
            [self.edges[k] for k in images],
            [self.samples[k] for k in images],
            [self.motions[k] for k in images],
        )

    @cached_property
    def problem(self) -> _Problem:
        """How well a change fits."""
        across = np.concatenate(
            [
                np.einsum("ni,nij->nj", o.across, J)
                for o, J in zip(self.edges, self.rows, strict=True)
            ]
        )
        # A beam has a width: things are drawn too wide by half of it, on every side alike.
        beyond = np.concatenate([one.across for one in self.edges]) ** 2 * self.camera.K[0, 0]
        J = np.concatenate([across, beyond], axis=1) / pixels_a_sample(self.camera)
        return _Problem(J, np.concatenate(list(self.samples)))

    @cached_property
    def rows(self) -> list[Floats]:
        """Pixels by which a change moves each edge, (n, 2, 7) of each image."""
        moved = [_jacobian(one, self.camera) for one in self.edges]
        return [
            np.concatenate([J, (J @ motion)[..., None]], axis=-1)
            for J, motion in zip(moved, self.motions, strict=True)
        ]

    def gains(self, fit: EdgeFit) -> Floats:
        """By how much the score of each image grows with the change of a fit, perhaps of others."""
        before = np.concatenate([np.zeros(7), -fit.half_beam])
        after = np.concatenate([fit.change, -fit.half_beam])
        gain = self.problem.value(after) - self.problem.value(before)
        counts = [len(one) for one in self.edges]
        image = np.repeat(np.arange(len(counts)), counts)
        return np.bincount(image, gain, len(counts)) / np.maximum(counts, 1)

    def moved(self, change: Floats) -> float:
        """Pixels by which a change (7,) moves the edges, RMS."""
        moved = np.concatenate(self.rows) @ change
        return float(np.sqrt((moved**2).sum(axis=1).mean()))


def fit_edges(
    found: ImageEdges, free: NDArray[np.bool_] | None = None, near: EdgeFit | None = None
) -> EdgeFit:
    """Fit a turn and a shift of the camera, and its time; or those parts (7,) that are free.

    It is looked for around another fit, or around all turns up to 1.6 degrees.
    """
    problem, camera = found.problem, found.camera
    usual = _USUAL.copy()
    if free is not None:
        usual[:7][~free] *= _FIXED
    start = None if near is None else np.concatenate([near.change, -near.half_beam])
    change = problem.solve(usual, start)
    if free is not None:
        change[:7][~free] = 0
    image = np.repeat(np.arange(len(found.edges)), [len(one) for one in found.edges])
    pixels = np.concatenate([one.pixels for one in found.edges])
    size = np.array([camera.width, camera.height])
    place = np.clip(pixels / size * _CELLS, 0, np.array(_CELLS) - 1).astype(np.int64)
    cell = place[:, 0] * _CELLS[1] + place[:, 1]
    covariance = problem.covariance(change, image) + problem.covariance(change, cell)
    fit = EdgeFit(
        change[:7],
        covariance[:7, :7],
        -change[7:],
        float(problem.value(change).mean()),
        np.zeros(len(found.edges)),
        np.median(np.concatenate(found.rows) @ change[:7], axis=0),
    )
    return replace(fit, gains=found.gains(fit))


def displaced(edges: Edges, change: Floats, camera: Camera) -> Floats:
    """Where a turn and a shift (6,) move the pixels of edges, (n, 2)."""
    result: Floats = edges.pixels + _jacobian(edges, camera) @ change
    return result


def _jacobian(edges: Edges, camera: Camera) -> Floats:
    """Pixels by which a turn and a shift move each edge, (n, 2, 6)."""
    K = camera.K
    x = (edges.pixels[:, 0] - K[0, 2]) / K[0, 0]
    y = (edges.pixels[:, 1] - K[1, 2]) / K[1, 1]
    near, none = 1 / edges.depth, np.zeros(len(edges))
    u = np.stack([-x * y, 1 + x * x, -y, near, none, -x * near], axis=1)
    v = np.stack([-(1 + y * y), x * y, x, none, near, -y * near], axis=1)
    return np.stack([K[0, 0] * u, K[1, 1] * v], axis=1)


class _Problem:
    """The mean change of brightness at a place in each profile that depends on the change.

    Parameters
    ----------
    J : ndarray of float64, shape (n, 7)
        Samples by which a change moves each edge across itself.
    samples : ndarray of float32, shape (n, m)
    """

    def __init__(self, J: Floats, samples: NDArray[np.float32]) -> None:
        self._J, self._prior = J, np.diag(_WEIGHT_OF_USUAL / _USUAL**2)  # of the last fit
        self._smeared = {
            width: cv2.GaussianBlur(samples, (0, 0), width, sigmaY=1e-3) for width in _WIDTHS
        }

    def value(self, change: Floats) -> Floats:
        return self._at(change, _WIDTHS[-1])[0]

    def solve(self, usual: Floats, near: Floats | None) -> Floats:
        """The best of where fits from the given calibration and from other starts end."""
        self._prior = np.diag(_WEIGHT_OF_USUAL / usual**2)
        starts = self._starts() if near is None else [np.zeros(_PARTS), near]
        found = [self._climb(start, _WIDTHS) for start in starts]
        return max(found, key=lambda change: self._objective(change, _WIDTHS[-1]))

    def _climb(self, change: Floats, widths: Sequence[float]) -> Floats:
        """Newton's method at one width after the other."""
        for width in widths:
            for _ in range(_STEPS):
                step: Floats = self._newton(change, width)
                before = self._objective(change, width)
                while (
                    self._length(step) > _MOVED and self._objective(change + step, width) < before
                ):
                    step = step * np.float64(0.5)
                if self._length(step) < _MOVED:
                    break
                change = change + step
        return change

    def covariance(self, change: Floats, group: NDArray[np.int64]) -> Floats:
        """Of the change, where the edges of each group err together."""
        _, slope, bend = self._at(change, _WIDTHS[-1])
        inverse = np.linalg.inv(self._downhill((self._J.T * bend) @ self._J))
        sums = np.zeros((int(group.max()) + 1, _PARTS))
        np.add.at(sums, group, self._J * slope[:, None])
        sums = sums[np.bincount(group) > 0]
        count = max(len(sums), 2)
        result: Floats = inverse @ (sums.T @ sums) @ inverse * count / (count - 1)
        return result

    def _starts(self) -> list[Floats]:
        """No change, and the turns about x and y under which most edges fit."""
        every = max(1, len(self._J) // _START_EDGES)
        J, table = self._J[::every], self._smeared[_WIDTHS[0]][::every]
        turns = np.radians(np.stack(np.meshgrid(_START_DEG, _START_DEG), axis=-1)).reshape(-1, 2)
        place = np.clip(np.rint(J[:, :2] @ turns.T) + REACH, 0, table.shape[1] - 1).astype(int)
        scores = np.take_along_axis(table, place, axis=1).mean(axis=0)
        side = len(_START_DEG)
        peaks = cv2.dilate(scores.reshape(side, side), np.ones((3, 3))).ravel() == scores
        best = [k for k in np.argsort(-scores) if peaks[k]][:_STARTS]
        return [np.zeros(_PARTS), *(np.array([*turns[k], *[0.0] * 7]) for k in best)]

    def _objective(self, change: Floats, width: float) -> float:
        return float(self._at(change, width)[0].mean() - change @ self._prior @ change / 2)

    def _newton(self, change: Floats, width: float) -> Floats:
        """The step to the top, no longer than the edges are smeared."""
        _, slope, bend = self._at(change, width)
        gradient = self._J.T @ slope / len(slope) - self._prior @ change
        hessian = self._downhill((self._J.T * bend) @ self._J / len(bend) - self._prior)
        step = -np.linalg.solve(hessian, gradient).astype(np.float64)
        short: Floats = step * min(1.0, width / max(self._length(step), 1e-12))
        return short

    def _length(self, step: Floats) -> float:
        """Samples by which a step moves edges, RMS."""
        return float(np.sqrt(np.mean((self._J @ step) ** 2)))

    @staticmethod
    def _downhill(hessian: Floats) -> Floats:
        """The nearest matrix with which Newton's step goes up, in units of what is usual."""
        values, axes = np.linalg.eigh(hessian * np.outer(_USUAL, _USUAL))
        values = np.minimum(values, -1e-3 * np.abs(values).max())
        result: Floats = (axes * values) @ axes.T / np.outer(_USUAL, _USUAL)
        return result

    def _at(self, change: Floats, width: float) -> tuple[Floats, Floats, Floats]:
        """Value, slope and second derivative of each profile, by cubic convolution."""
        table = self._smeared[width]
        place = np.clip(self._J @ change + REACH, 1, table.shape[1] - 3.001)
        k, row = place.astype(np.int64), np.arange(len(place))
        t = place - k
        a, b, c, d = (table[row, k + off].astype(np.float64) for off in (-1, 0, 1, 2))
        one, two, three = (c - a) / 2, a - 2.5 * b + 2 * c - d / 2, 1.5 * (b - c) + (d - a) / 2
        value = b + t * (one + t * (two + t * three))
        return value, one + t * (2 * two + 3 * t * three), 2 * two + 6 * t * three
