"""Depth errors: KITTI's metrics of one image, and sums over the pixels of many images."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.evaluation.pixels import Mask
from docdepth.evaluation.tables import Band, Figures, number, percent, ratio

# A pixel is too near or too far if its error exceeds this share of the true depth.
RELATIVE_ERROR = 0.05
# Ranges that are reported apart [m].
RANGE_BINS = (0.0, 10.0, 20.0, 30.0, 50.0, 80.0)

_ANY = slice(None)

Values = NDArray[np.float64]


@dataclass(frozen=True)
class DepthErrors(Figures):
    """Mean errors, as defined by KITTI's development kit and in its units.

    Attributes
    ----------
    mae, rmse : float
        Metres.
    imae, irmse : float
        Errors of inverse depth [1/km].
    log_mae, log_rmse : float
        Errors of the natural logarithm of depth.
    silog : float
        Scale-invariant logarithmic error, times 100.
    abs_rel : float
        ``mean(|d - p| / d)`` [%].
    sq_rel : float
        ``mean((d - p)^2 / d^2)`` [%], as in the kit.
    sq_rel_eigen : float
        ``mean((d - p)^2 / d)`` [m], as in papers on monocular depth.
    delta1, delta2, delta3 : float
        Share of pixels with ``max(d / p, p / d) < 1.25^k`` [%].
    """

    mae: float
    rmse: float
    imae: float
    irmse: float
    log_mae: float
    log_rmse: float
    silog: float
    abs_rel: float
    sq_rel: float
    sq_rel_eigen: float
    delta1: float
    delta2: float
    delta3: float

    @classmethod
    def of(
        cls, truth: NDArray[np.floating[Any]], predicted: NDArray[np.floating[Any]]
    ) -> DepthErrors:
        """Errors over pixels, given as two arrays of positive depths [m], shape (k,)."""
        if not len(truth):
            return cls.mean([])
        d, p = truth.astype(np.float64), predicted.astype(np.float64)
        difference = np.abs(d - p)
        inverse = np.abs(1 / d - 1 / p)
        quotient = d / p
        log = np.log(quotient)
        squared_log = float(np.mean(log * log))
        worse = np.maximum(quotient, 1 / quotient)
        squared = difference * difference
        return cls(
            mae=float(difference.mean()),
            rmse=math.sqrt(squared.mean()),
            imae=1e3 * float(inverse.mean()),
            irmse=1e3 * math.sqrt(np.mean(inverse * inverse)),
            log_mae=float(np.abs(log).mean()),
            log_rmse=math.sqrt(squared_log),
            silog=100 * math.sqrt(max(squared_log - float(log.mean()) ** 2, 0.0)),
            abs_rel=100 * float(np.mean(difference / d)),
            sq_rel=100 * float(np.mean(squared / (d * d))),
            sq_rel_eigen=float(np.mean(squared / d)),
            delta1=100 * float(np.mean(worse < 1.25)),
            delta2=100 * float(np.mean(worse < 1.25**2)),
            delta3=100 * float(np.mean(worse < 1.25**3)),
        )

    @classmethod
    def mean(cls, errors: Sequence[DepthErrors]) -> DepthErrors:
        """Mean over images; images without a compared pixel are left out."""
        rows = [tuple(vars(e).values()) for e in errors if not math.isnan(e.mae)]
        return cls(*(np.mean(rows, axis=0).tolist() if rows else [math.nan] * len(fields(cls))))


@dataclass(frozen=True)
class RegionErrors(Figures):
    """Errors over the pixels of a region, over all images together.

    Attributes
    ----------
    pixels : int
        Pixels of the region that have a true depth.
    compared : int
        Of these, the pixels with a predicted depth.
    mae, rmse : float
        Metres.
    edge_displacement : float
        By how many pixels edges are off: the MAE divided by the MAE of the true depth map moved
        right by one pixel, on the same pixels.
    too_near, too_far : float
        Share of compared pixels whose depth is more than 5 % too small or too large [%].
    """

    pixels: int
    compared: int
    mae: float
    rmse: float
    edge_displacement: float
    too_near: float
    too_far: float
    derived = ("density",)

    @property
    def density(self) -> float:
        """Share of these pixels that have depth [%]."""
        return percent(self.compared, self.pixels)

    def cells(self) -> list[str]:
        """The row of a table."""
        return [
            f"{self.pixels:,}",
            number(self.density, 1),
            *(number(x, 3) for x in (self.mae, self.rmse)),
            *(number(x, 2) for x in (self.edge_displacement, self.too_near, self.too_far)),
        ]


class PixelSums:
    """Sums over pixels for :class:`RegionErrors`, by range, interior and moving.

    Parameters
    ----------
    max_range : float
        No true depth is larger [m].
    bins : sequence of float
        Borders of the ranges [m]; every depth lies beyond the first.
    """

    def __init__(self, max_range: float, bins: Sequence[float] = (0.0,)) -> None:
        self._bins = [border for border in bins if border < max_range] + [max_range]
        # Number of pixels, compared, too near and too far; sums of |e| and e^2; and, over pixels
        # where both are known, sums of |e| and of the error of the shifted depth.
        self._sums = np.zeros((8, len(self._bins) - 1, 2, 2))

    def add(
        self,
        error: Values,
        truth: Values,
        moved: Values,
        interior: Mask,
        dynamic: Mask,
        among: Mask | slice = _ANY,
    ) -> None:
        """Add pixels of one image, shape (k,) each; ``error`` and ``moved`` may be NaN [m]."""
        error, truth, moved = error[among], truth[among], moved[among]
        interior, dynamic = interior[among], dynamic[among]
        range_bin = np.searchsorted(self._bins, truth, side="left") - 1
        cell = (2 * np.maximum(range_bin, 0) + interior) * 2 + dynamic
        compared = ~np.isnan(error)
        size = np.abs(np.where(compared, error, 0))
        both = compared & ~np.isnan(moved)
        off = RELATIVE_ERROR * truth
        with np.errstate(invalid="ignore"):
            near, far = error < -off, error > off
        shares = (size, size * size, np.where(both, size, 0), np.where(both, moved, 0))
        for k, weight in enumerate((None, compared, near, far, *shares)):
            sums = np.bincount(cell, weight, minlength=self._sums[k].size)
            self._sums[k] += sums.reshape(self._sums[k].shape)

    def errors(
        self, ranges: int | slice = _ANY, interior: int | slice = _ANY, dynamic: int | slice = _ANY
    ) -> RegionErrors:
        """Errors of a region: index of the range, interior and dynamic 0 or 1; default: all."""
        cells = self._sums[:, ranges, interior, dynamic]
        pixels, compared, near, far, absolute, squared, own, moved = (
            float(cell.sum()) for cell in cells
        )
        return RegionErrors(
            pixels=round(pixels),
            compared=round(compared),
            mae=ratio(absolute, compared),
            rmse=math.sqrt(ratio(squared, compared)),
            edge_displacement=ratio(own, moved),
            too_near=percent(near, compared),
            too_far=percent(far, compared),
        )

    def by_range(self) -> tuple[Band[RegionErrors], ...]:
        """Errors of each range."""
        borders = enumerate(pairwise(self._bins))
        return tuple(Band(near, far, self.errors(ranges=k)) for k, (near, far) in borders)
