"""Fit a camera to its images, and tell whether the change is sure enough to be applied."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from docdepth.diagnostics.calibration import RunEdges, change_in_words
from docdepth.diagnostics.edge_fit import EdgeFit, fit_edges

Floats = NDArray[np.float64]

LEAST_PATH = 60.0
"""Path along which the images were taken [m]. The quarters of a shorter drive see the same street,
and have agreed on turns of 0.6 degrees that were wrong."""

_FEWEST_IMAGES = 10
_LEAST_MOVED_DEG = 0.04  # half a pixel of most cameras; smaller changes are not applied
_PARTS = 4  # of the drive, each of which is left out once
_EVERY = 4  # edges of an image that are used: next to each other they err alike
_TURN_AND_TIME = np.array([True] * 3 + [False] * 3 + [True])
_LEAST_SCORE = 1.2  # right ones reach 1.4 to 2.2, another drive's images 1.0 to 1.1
_ERRORS = 3.0  # standard errors by which displacement and gain exceed zero
_MOST_ERROR_DEG = 0.1  # right ones reach 0.02 to 0.08; 0.3 and more where two changes fit alike


@dataclass(frozen=True)
class CameraFit:
    """A change of a camera by its images, and whether it is sure.

    Attributes
    ----------
    fit : EdgeFit
        By all images.
    moved_deg : float
        By how much it moves depth edges, RMS.
    error_deg : float
        Standard error of that: by how much fits without a quarter of the drive differ (jackknife).
    gain : float
        Mean growth of the score of an image by the fit without its quarter, in standard errors.
    """

    fit: EdgeFit
    moved_deg: float
    error_deg: float
    gain: float

    @property
    def is_sure(self) -> bool:
        """Whether edges surely move, and onto edges of images that the fit has not seen."""
        return (
            self.moved_deg > max(_LEAST_MOVED_DEG, _ERRORS * self.error_deg)
            and self.error_deg < _MOST_ERROR_DEG
            and self.gain > _ERRORS
            and self.fit.score > _LEAST_SCORE
        )

    @property
    def change(self) -> str:
        """The whole change in words."""
        return change_in_words(self.fit, np.ones(7, np.bool_))


def fit_camera(found: RunEdges) -> CameraFit | None:
    """Fit a camera to the images of a run, and again without each quarter of the drive.

    Turn, place and time are fitted together. Seen from a few metres a turn looks like a shift, so
    each part by itself is less sure than where the edges lie. None where images are too few.
    """
    if not found.enough or len(found.edges) < _FEWEST_IMAGES:
        return None
    every, images = found.with_each(_EVERY).seen, np.arange(len(found.edges))
    whole = fit_edges(every, near=fit_edges(every, _TURN_AND_TIME))
    gains, changes = [], []
    for part in np.array_split(images, _PARTS):
        rest, own = every.some(np.setdiff1d(images, part)), every.some(part)
        if not any(map(len, rest.edges)) or not any(map(len, own.edges)):
            return None
        fit = fit_edges(rest, near=whole)
        gains.append(own.gains(fit))
        changes.append(fit.change)
    differ = [every.moved(change) for change in np.array(changes) - np.mean(changes, axis=0)]
    error = np.sqrt((_PARTS - 1) * np.mean(np.square(differ)))
    gain = np.concatenate(gains)
    degrees = float(np.degrees(1 / found.stream.camera.K[0, 0]))
    return CameraFit(
        whole,
        degrees * every.moved(whole.change),
        degrees * float(error),
        float(gain.mean() / (gain.std(ddof=1) / np.sqrt(len(gain)) + 1e-9)),
    )
