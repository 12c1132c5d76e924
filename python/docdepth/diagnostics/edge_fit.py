"""By which change of the extrinsic depth edges fall onto image edges.

Across each depth edge the image is sampled, from the near side to the far one. Where the
calibration is right, the image changes most in the middle of these samples. The fit turns and moves
the camera so that as much change as possible lies below the depth edges of all images together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from docdepth.geometry.camera import Camera
from docdepth.geometry.track import Tracks
from docdepth.io.tracks import box_in_image

Floats = NDArray[np.float64]

_STEP_DEG = 0.08  # between samples; finer pixels tell no more
_REACH = 32  # samples to either side
_WIDTHS = (3.0, 2.0)  # samples that an image edge is smeared over, one fit after the other
_NOISE = 0.03  # change of brightness from pixel to pixel; brightness is a square root, 0 to 16
_START_DEG = np.arange(-1.6, 1.61, 0.2)  # turns about x and y that the fit may start from
_START_EDGES = 5000  # that choose the starts
_STARTS = 5  # best ones from which fits begin; a lane marking may look like an edge of depth
_USUAL = np.array([*np.radians([2.0] * 3), *[0.3] * 3])  # what nobody need see; keeps fits bounded
_WEIGHT_OF_USUAL = 0.01  # of a score that is 1 by chance
_STEPS = 25
_MOVED = 0.01  # samples; smaller steps end the fit
_CELLS = (8, 3)  # parts of the image, columns and rows, whose edges err together

# Where depth maps jump from one surface to another farther away.
_JUMP = (0.5, 0.15)  # metres, and share of the depth, that the farther surface lies behind
_DEPTHS = (3.0, 50.0)  # metres; nearer is the vehicle, farther returns are too sparse
_SMOOTH = 2.0  # pixels over which the direction of an edge is found
_STEEP = 0.7  # part of the direction along rows or columns of the pair of pixels
_BESIDE = 5  # pixels around a moving object
_MOST_EDGES = 2000  # of an image that are used


@dataclass(frozen=True)
class Edges:
    """Depth edges in an image.

    Attributes
    ----------
    pixels : ndarray of float64, shape (n, 2)
        u and v; integers are pixel centres.
    across : ndarray of float64, shape (n, 2)
        Unit vector in the image from the near side to the far one.
    depth : ndarray of float64, shape (n,)
        Of the near side, metres along the optical axis.
    """

    pixels: Floats
    across: Floats
    depth: Floats

    def __len__(self) -> int:
        return len(self.depth)

    def rows(self, chosen: NDArray[np.bool_] | NDArray[np.int64]) -> Edges:
        return Edges(self.pixels[chosen], self.across[chosen], self.depth[chosen])


@dataclass(frozen=True)
class EdgeFit:
    """The change that takes depth edges to image edges.

    Attributes
    ----------
    change : ndarray of float64, shape (6,)
        Of points in the camera's frame: turn about its axes x, y, z [rad], then shift [m].
    covariance : ndarray of float64, shape (6, 6)
        Images, and parts of the image, are taken to err each as a whole: edges of one object, and
        of a vehicle that stands, repeat the same error.
    score : float
        Change of brightness below depth edges over that beside them; 1 is chance.
    gains : ndarray of float64, shape (images,)
        By how much the score of each image grows.
    pixels : ndarray of float64, shape (2,)
        Displacement of image edges from depth edges to the right and down, in the median.
    """

    change: Floats
    covariance: Floats
    score: float
    gains: Floats
    pixels: Floats

    @property
    def turn_deg(self) -> Floats:
        return np.degrees(self.change[:3])

    @property
    def shift_m(self) -> Floats:
        return self.change[3:]

    @property
    def deviations(self) -> Floats:
        """One standard deviation of each of :attr:`change`."""
        return np.sqrt(np.diag(self.covariance))


def edges_of_map(depth: NDArray[np.float32], moving: NDArray[np.bool_] | None = None) -> Edges:
    """Depth edges between neighbouring pixels, at most 2000 evenly chosen.

    Parameters
    ----------
    depth : ndarray of float32, shape (h, w)
        Metres; NaN = none. The edge of what has depth is no depth edge.
    moving : ndarray of bool, shape (h, w), optional
        Pixels that do not count.
    """
    known = np.isfinite(depth)
    share = cv2.GaussianBlur(known.astype(np.float32), (0, 0), _SMOOTH)
    logarithm = np.where(known, np.log(np.where(known, depth, 1.0)), 0.0).astype(np.float32)
    smooth = cv2.GaussianBlur(logarithm, (0, 0), _SMOOTH) / np.maximum(share, 1e-3)
    slope = np.stack([cv2.Sobel(smooth, cv2.CV_32F, 1 - k, k) for k in (0, 1)], axis=-1)
    slope /= np.maximum(np.linalg.norm(slope, axis=-1, keepdims=True), 1e-6)
    found = []
    for axis in (0, 1):
        # Pairs along rows, then along columns.
        first = np.s_[:, :-1] if axis == 0 else np.s_[:-1, :]
        second = np.s_[:, 1:] if axis == 0 else np.s_[1:, :]
        one, other, across = depth[first], depth[second], slope[first]
        near, far = np.fmin(one, other), np.fmax(one, other)
        jump = np.isfinite(one + other) & (near > _DEPTHS[0]) & (near < _DEPTHS[1])
        jump &= far - near > np.maximum(_JUMP[0], _JUMP[1] * near)
        if moving is not None:
            jump &= ~moving[first]
        jump &= across[..., axis] * np.where(other > one, 1, -1) > _STEEP
        v, u = np.nonzero(jump)
        place = np.stack([u, v], axis=1) + 0.5 * np.eye(2)[axis]
        found.append((place, across[v, u].astype(np.float64), near[v, u].astype(np.float64)))
    pixels, across, near = (np.concatenate(parts) for parts in zip(*found, strict=True))
    every = np.unique(np.linspace(0, len(near) - 1, min(len(near), _MOST_EDGES)).astype(np.int64))
    return Edges(pixels, across, near).rows(every)


def pixels_of_tracks(
    tracks: Tracks, time: int, T_camera_world: NDArray[np.float64], camera: Camera
) -> NDArray[np.bool_]:
    """Pixels in or beside the boxes of moving objects, (h, w)."""
    mask = np.zeros((camera.height, camera.width), np.bool_)
    for track in tracks.between(time, time):
        box = box_in_image(track.size, T_camera_world @ track.pose_at(time), camera)
        if box is not None:
            (left, top), (right, bottom) = np.floor(box).astype(int) + [[-_BESIDE], [1 + _BESIDE]]
            mask[max(top, 0) : max(bottom, 0), max(left, 0) : max(right, 0)] = True
    return mask


def profiles(edges: Edges, image: NDArray[np.uint8], camera: Camera) -> NDArray[np.float32]:
    """Change of brightness along lines across depth edges, over that of the whole line.

    Parameters
    ----------
    edges : Edges
    image : ndarray of uint8, shape (h, w, 3)
        BGR, rectified.
    camera : Camera

    Returns
    -------
    ndarray of float32, shape (n, 2 * 32 + 1)
        From the near side to the far one.
    """
    if not len(edges):  # OpenCV takes no empty map
        return np.zeros((0, 2 * _REACH + 1), np.float32)
    step = _step(camera)
    bright = np.sqrt(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY).astype(np.float32))
    bright = cv2.GaussianBlur(bright, (0, 0), step)
    along = np.arange(-_REACH, _REACH + 1) * step
    lines = edges.pixels[:, None] + edges.across[:, None] * along[:, None]
    u, v = np.moveaxis(lines.astype(np.float32), -1, 0)
    changes = np.zeros(u.shape, np.float32)
    for axis in (0, 1):
        slope = cv2.Sobel(bright, cv2.CV_32F, 1 - axis, axis) / 8
        found = cv2.remap(slope, u, v, cv2.INTER_LINEAR, borderValue=0)
        changes += found * edges.across[:, axis, None].astype(np.float32)
    changes = np.abs(changes)
    result: NDArray[np.float32] = changes / (changes.mean(axis=1, keepdims=True) + _NOISE)
    return result


def fit_edges(
    edges: Sequence[Edges], samples: Sequence[NDArray[np.float32]], camera: Camera
) -> EdgeFit:
    """Fit a turn and a shift of the camera.

    Parameters
    ----------
    edges : sequence of Edges
        Of each image; one of them has some.
    samples : sequence of ndarray
        Of each image, from :func:`profiles`.
    camera : Camera
    """
    rows = [_jacobian(one, camera) for one in edges]
    across = np.concatenate(
        [np.einsum("ni,nij->nj", o.across, J) for o, J in zip(edges, rows, strict=True)]
    )
    problem = _Problem(across / _step(camera), np.concatenate(samples))
    change = problem.solve()
    image = np.repeat(np.arange(len(edges)), [len(one) for one in edges])
    pixels = np.concatenate([one.pixels for one in edges])
    size = np.array([camera.width, camera.height])
    place = np.clip(pixels / size * _CELLS, 0, np.array(_CELLS) - 1).astype(np.int64)
    cell = place[:, 0] * _CELLS[1] + place[:, 1]
    covariance = problem.covariance(change, image) + problem.covariance(change, cell)
    gain = problem.value(change) - problem.value(np.zeros(6))
    count = np.maximum(np.bincount(image, minlength=len(edges)), 1)
    return EdgeFit(
        change,
        covariance,
        float(problem.value(change).mean()),
        np.bincount(image, gain, len(edges)) / count,
        np.median(np.concatenate(rows) @ change, axis=0),
    )


def displaced(edges: Edges, change: Floats, camera: Camera) -> Floats:
    """Where a change moves the pixels of edges, (n, 2)."""
    result: Floats = edges.pixels + _jacobian(edges, camera) @ change
    return result


def _step(camera: Camera) -> float:
    """Pixels from sample to sample."""
    return max(1.0, float(np.radians(_STEP_DEG) * camera.K[0, 0]))


def _jacobian(edges: Edges, camera: Camera) -> Floats:
    """Pixels by which a change moves each edge, (n, 2, 6)."""
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
    J : ndarray of float64, shape (n, 6)
        Samples by which a change moves each edge across itself.
    samples : ndarray of float32, shape (n, m)
    """

    def __init__(self, J: Floats, samples: NDArray[np.float32]) -> None:
        self._J, self._prior = J, np.diag(_WEIGHT_OF_USUAL / _USUAL**2)
        self._smeared = {
            width: cv2.GaussianBlur(samples, (0, 0), width, sigmaY=1e-3) for width in _WIDTHS
        }

    def value(self, change: Floats) -> Floats:
        return self._at(change, _WIDTHS[-1])[0]

    def solve(self) -> Floats:
        """The best of where fits from the given calibration and from other starts end."""
        found = [self._climb(start, _WIDTHS) for start in self._starts()]
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
        sums = np.zeros((int(group.max()) + 1, 6))
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
        place = np.clip(np.rint(J[:, :2] @ turns.T) + _REACH, 0, table.shape[1] - 1).astype(int)
        scores = np.take_along_axis(table, place, axis=1).mean(axis=0)
        side = len(_START_DEG)
        peaks = cv2.dilate(scores.reshape(side, side), np.ones((3, 3))).ravel() == scores
        best = [k for k in np.argsort(-scores) if peaks[k]][:_STARTS]
        return [np.zeros(6), *(np.array([*turns[k], 0, 0, 0, 0]) for k in best)]

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
        place = np.clip(self._J @ change + _REACH, 1, table.shape[1] - 3.001)
        k, row = place.astype(np.int64), np.arange(len(place))
        t = place - k
        a, b, c, d = (table[row, k + off].astype(np.float64) for off in (-1, 0, 1, 2))
        one, two, three = (c - a) / 2, a - 2.5 * b + 2 * c - d / 2, 1.5 * (b - c) + (d - a) / 2
        value = b + t * (one + t * (two + t * three))
        return value, one + t * (2 * two + 3 * t * three), 2 * two + 6 * t * three
