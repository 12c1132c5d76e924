"""Whether what images say about a camera is sure enough to be taken: both halves of a drive ask."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from docdepth.diagnostics.calibration import RunEdges, clear_change
from docdepth.diagnostics.edge_fit import EdgeFit, fit_edges

Floats = NDArray[np.float64]

LEAST_PIXELS_DEG = 0.04
"""Edges that move by less are left where they are: half a pixel of most cameras."""

FEWEST_IMAGES = 10
"""So that each half can tell."""

_TURN, _PLACE, _TIME = (np.arange(7) // 3 == k for k in range(3))  # parts of a change
_LEAST_SCORE = 1.2  # right ones reach 1.4 to 2.2, another drive's images 1.0 to 1.1
_ERRORS = 2.0  # standard errors that a part exceeds, and the gain of a half by the fit of the other
_AGREE = 1.0  # of its displacement, by which the fits of both halves may lie apart


@dataclass(frozen=True)
class CameraFit:
    """A change of a camera by its images, and whether it is sure.

    Attributes
    ----------
    fit : EdgeFit
        By all images.
    moved_deg : float
        By how much it moves depth edges, RMS.
    apart_deg : float
        By how much the fits of both halves of the drive move them apart, RMS.
    gain : float
        Of the score of each half by the fit of the other, in its standard errors; the lesser one.
    """

    fit: EdgeFit
    moved_deg: float
    apart_deg: float
    gain: float

    @property
    def is_sure(self) -> bool:
        """Whether it is more than an error, both halves agree, and each confirms the other."""
        return (
            self.moved_deg > LEAST_PIXELS_DEG
            and self.fit.score > _LEAST_SCORE
            and self.apart_deg < _AGREE * self.moved_deg
            and self.gain > _ERRORS
        )

    @property
    def change(self) -> str:
        """The change in words; empty where no part of it stands out of its error."""
        return clear_change(self.fit)


def fit_camera(found: RunEdges) -> CameraFit | None:
    """Fit a camera to the images of a run; None where they are too few to tell.

    Each half of the drive is fitted by itself, and what both do not agree on stays as it is. Turn
    and time are tried first. The place joins them where both halves gain more by what the other
    finds then: seen from a few metres a turn looks like a shift, and calibrations turn more.
    """
    if not found.enough or len(found.edges) < FEWEST_IMAGES:
        return None
    count, every = len(found.edges), found.seen
    halves = every.some(range(count // 2)), every.some(range(count // 2, count))
    if not all(any(map(len, half.edges)) for half in halves):
        return None
    degrees = float(np.degrees(1 / found.stream.camera.K[0, 0]))
    best: CameraFit | None = None
    before = [np.zeros(len(half.edges)) for half in halves]
    for tried in (_TURN | _TIME, _TURN | _TIME | _PLACE):
        whole = fit_edges(every, tried, None if best is None else best.fit)
        agreed = _agreed(whole, *(fit_edges(half, tried, whole) for half in halves))
        whole, first, second = (fit_edges(part, agreed, whole) for part in (every, *halves))
        gains = [halves[0].gains(second), halves[1].gains(first)]
        gain = min(_in_errors(now - then) for now, then in zip(gains, before, strict=True))
        if best is None or gain > _ERRORS:
            moved, apart = every.moved(whole.change), every.moved(first.change - second.change)
            best, before = CameraFit(whole, degrees * moved, degrees * apart, gain), gains
    return best


def _agreed(whole: EdgeFit, first: EdgeFit, second: EdgeFit) -> NDArray[np.bool_]:
    """The parts of a change that both halves see by themselves, and differ in by less than it is.

    A roll of 0.4 degrees was asked for by twenty images in which the half of them saw next to none.
    """
    result: NDArray[np.bool_] = np.abs(first.change - second.change) < np.abs(whole.change)
    for half in (first, second):
        result &= np.abs(half.change) > _ERRORS * half.deviations
    return result


def _in_errors(gains: Floats) -> float:
    """The mean over its standard error."""
    return float(np.mean(gains) / (np.std(gains, ddof=1) / np.sqrt(len(gains)) + 1e-9))
