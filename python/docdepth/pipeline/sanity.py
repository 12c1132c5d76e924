"""Results that cannot be right: one warning each, with the likely causes.

Each threshold lies between what right recordings give and what wrong ones give; both are named
beside it. Right are KITTI raw drives 0005 and 9001, and synthetic ones: city, crossing, rosette.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.viewpoint import LEAST_IN_TRIANGLES
from docdepth.geometry.points import DYNAMIC, GROUND
from docdepth.geometry.scan_mesh import share_in_triangles
from docdepth.geometry.sensor_rig import SensorRig

log = logging.getLogger(__name__)

SAMPLES = 5
"""Sweeps whose mesh is made to see whether their returns have neighbours."""

LEAST_GROUND = 0.01
"""Share of returns on the ground: 0.3 to 0.7."""

MOST_DYNAMIC = 0.5
"""Share of dynamic points of those above the ground: 0.01 to 0.45, the most at a busy crossing."""

LEAST_DENSITY = 0.05
"""Mean share of pixels with depth: 0.5 to 0.8."""

IMAGES = 10
"""Depth maps whose edges are compared with those of their images."""

_WIDTH = 640  # pixels to which images are reduced: an image takes some 30 ms
_REACH = 0.032  # of the width: shifts that are tried, 40 pixels of KITTI's images
_FAR = 0.0065  # of the width: 8 pixels of KITTI's images
_JUMP = 0.1  # share of inverse depth by which it changes at an edge
_FEWEST_EDGES = 1500  # pixels at edges of depth in all images together
_FEWEST_UNRELATED = 8000  # the same before all images are called unrelated
_CLEAR = 5.0  # deviations above the other shifts: 7 to 25, unrelated images up to 4
_BETTER = 1.5  # times the score of the best shift that is not far: 2 to 4 after 12 pixels
_UNRELATED = 3.0  # deviations of the best shift that is not far: 7 to 25, unrelated images up to 3


def sampled(count: int, most: int) -> list[int]:
    """At most ``most`` of ``count`` indices, evenly spread."""
    return sorted({int(k) for k in np.linspace(0, count - 1, min(count, most))})


def warn_of_viewpoint(
    points: Callable[[int], NDArray[np.float32]],
    rig: Callable[[int], SensorRig | None],
    count: int,
) -> None:
    """Warn if returns lack neighbours: they were not measured from where they are seen.

    Parameters
    ----------
    points : callable
        Points of a sweep, float32 (N, 3). A few sweeps are asked for.
    rig : callable
        Where a sweep was measured from.
    count : int
        Number of sweeps.
    """
    shares = []
    for k in sampled(count, SAMPLES):
        cloud = points(k)
        if len(cloud):
            shares.append(share_in_triangles(cloud, rig(k)))
    if shares and np.median(shares) < LEAST_IN_TRIANGLES:
        log.warning(
            "only %.0f %% of the returns have neighbours in their sweep: the points may be merged "
            "of several LiDARs, or be in the vehicle's frame; say with looks_from in "
            "docdepth.yaml where the LiDAR is",
            100 * np.median(shares),
        )


def count_classes(classid: NDArray[np.uint16]) -> tuple[int, int, int]:
    """Points of a sweep: all, of the ground, and dynamic ones, for :func:`warn_of_classes`."""
    ground, dynamic = classid == GROUND, classid >= DYNAMIC
    return len(classid), int(np.count_nonzero(ground)), int(np.count_nonzero(dynamic))


def warn_of_classes(counts: Sequence[tuple[int, int, int]]) -> None:
    """Warn if there is next to no ground, or if moving points are everywhere.

    Parameters
    ----------
    counts : sequence of tuple of int
        Of each sweep, from :func:`count_classes`.
    """
    if not counts:
        return
    points, ground, dynamic = (sum(column) for column in zip(*counts, strict=True))
    if ground < LEAST_GROUND * points:
        log.warning(
            "only %.1f %% of the points are ground: the LiDAR's z axis may not point up, the poses "
            "may be wrong, or the points may not be in metres",
            100 * ground / points,
        )
    above = points - ground
    if dynamic > MOST_DYNAMIC * above:
        log.warning(
            "%.0f %% of the points above the ground are called dynamic: the poses or the order of "
            "the sweeps may be wrong, or the points may not be in the frame of the LiDAR",
            100 * dynamic / above,
        )


def warn_of_density(coverage: Sequence[float], camera: str) -> None:
    """Warn if the depth maps of a camera are all but empty; ``coverage`` is a share of each map."""
    if len(coverage) and np.mean(coverage) < LEAST_DENSITY:
        log.warning(
            "only %.1f %% of the pixels of %s have depth: the extrinsics or the intrinsics may be "
            "wrong, the image times may not fit, or the camera may look where the LiDAR does not",
            100 * np.mean(coverage), camera,
        )  # fmt: skip


def warn_of_edges(
    maps: Iterable[tuple[NDArray[np.float32], NDArray[np.uint8] | None]], camera: str
) -> None:
    """Warn if edges of depth lie far from edges of the images.

    Parameters
    ----------
    maps : iterable of (ndarray of float32 (h, w), ndarray of uint8 (h, w, 3) or None)
        Depth maps and rectified images; :data:`IMAGES` of a camera, evenly spread, are enough.
    camera : str
    """
    total, edges, scale = np.zeros(0), 0.0, 1.0
    for depth, image in maps:
        if image is None:
            continue
        scale = min(1.0, _WIDTH / depth.shape[1])
        score, count = _scores(_reduced(depth, scale), _contrast(image, scale))
        total = total + score if total.shape == score.shape else score
        edges += count
    if edges < _FEWEST_EDGES:
        return
    reach = total.shape[0] // 2
    offset = np.hypot(*np.ogrid[-reach : reach + 1, -reach : reach + 1])
    middle = float(np.median(total))
    deviation = 1.4826 * float(np.median(np.abs(total - middle))) or 1.0
    near = float(total[offset <= _FAR / _REACH * reach].max())
    row, column = np.unravel_index(int(np.argmax(total)), total.shape)
    best = float(total[row, column])
    if best > near and best - middle > _CLEAR * deviation and best > _BETTER * max(near, 0):
        log.warning(
            "edges of depth fit the images of %s better %.0f pixels to the %s and %.0f %s: the "
            "extrinsics, the intrinsics or the image times may be wrong",
            camera,
            abs(column - reach) / scale,
            "right" if column > reach else "left",
            abs(row - reach) / scale,
            "down" if row > reach else "up",
        )
    elif edges > _FEWEST_UNRELATED and near - middle < _UNRELATED * deviation:
        log.warning(
            "edges of depth lie nowhere near edges of the images of %s: the extrinsics, the "
            "intrinsics or the order of the images may be wrong", camera,
        )  # fmt: skip


def _reduced(depth: NDArray[np.float32], scale: float) -> NDArray[np.float32]:
    """1 where inverse depth jumps, of a depth map reduced without mixing depths."""
    size = (round(depth.shape[1] * scale), round(depth.shape[0] * scale))
    small = cv2.resize(depth, size, interpolation=cv2.INTER_NEAREST)
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1 / small
    jumps = np.zeros(small.shape, np.float32)
    with np.errstate(invalid="ignore"):
        for a, b, at in (
            (inverse[:-1], inverse[1:], jumps[:-1]),
            (inverse[:, :-1], inverse[:, 1:], jumps[:, :-1]),
        ):
            at[np.abs(a - b) > _JUMP * np.maximum(a, b)] = 1
    return jumps


def _contrast(image: NDArray[np.uint8], scale: float) -> NDArray[np.float32]:
    """Strength of the image's edges, less that of their surroundings."""
    size = (round(image.shape[1] * scale), round(image.shape[0] * scale))
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    grey = cv2.resize(grey, size, interpolation=cv2.INTER_AREA).astype(np.float32)
    strength = np.hypot(cv2.Sobel(grey, cv2.CV_32F, 1, 0), cv2.Sobel(grey, cv2.CV_32F, 0, 1))
    strength = np.minimum(strength, np.quantile(strength, 0.95)).astype(np.float32)
    return np.asarray(strength - cv2.blur(strength, (41, 41)), np.float32)


def _scores(
    jumps: NDArray[np.float32], contrast: NDArray[np.float32]
) -> tuple[NDArray[np.float64], float]:
    """Contrast below the jumps at each shift of them, and their number."""
    reach = max(4, round(_REACH * jumps.shape[1]))
    shape = [n + reach for n in jumps.shape]
    product = np.conj(np.fft.rfft2(jumps, shape)) * np.fft.rfft2(contrast, shape)
    shifts = np.arange(-reach, reach + 1)
    table = np.fft.irfft2(product, shape)[np.ix_(shifts % shape[0], shifts % shape[1])]
    return table, float(jumps.sum())
