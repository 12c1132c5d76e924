"""Depth errors: KITTI's metrics of one image, and sums over the pixels of many images."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.evaluation.pixels import Mask
from docdepth.evaluation.tables import number, percent, ratio

# A pixel is too near or too far if its error exceeds this share of the true depth.
RELATIVE_ERROR = 0.05

_ANY = slice(None)

Values = NDArray[np.float64]


@dataclass(frozen=True)
class DepthErrors:
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

    mae: float = math.nan
    rmse: float = math.nan
    imae: float = math.nan
    irmse: float = math.nan
    log_mae: float = math.nan
    log_rmse: float = math.nan
    silog: float = math.nan
    abs_rel: float = math.nan
    sq_rel: float = math.nan
    sq_rel_eigen: float = math.nan
    delta1: float = math.nan
    delta2: float = math.nan
    delta3: float = math.nan

    @classmethod
    def of(
        cls, truth: NDArray[np.floating[Any]], predicted: NDArray[np.floating[Any]]
    ) -> DepthErrors:
        """Errors over pixels, given as two arrays of positive depths [m], shape (k,)."""
        if not len(truth):
            return cls()
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
        rows = [tuple(asdict(e).values()) for e in errors if not math.isnan(e.mae)]
        return cls(*(float(x) for x in np.mean(rows, axis=0))) if rows else cls()


@dataclass(frozen=True)
class RegionErrors:
    """Errors over the pixels of a region, over all images together.

    Attributes
    ----------
    pixels : int
        Pixels of the region that have a true depth.
    compared : int
        Of these, the pixels with a predicted depth.
    mae, rmse : float
        Metres.
    shifts : float
        MAE in shifts: the MAE divided by the MAE of the true depth map moved right by one pixel,
        on the same pixels.
    too_near, too_far : float
        Share of compared pixels whose depth is more than 5 % too small or too large [%].
    """

    pixels: int
    compared: int
    mae: float
    rmse: float
    shifts: float
    too_near: float
    too_far: float

    @property
    def density(self) -> float:
        """Share of these pixels that have depth [%]."""
        return percent(self.compared, self.pixels)

    def as_dict(self) -> dict[str, float]:
        """Everything by name."""
        return {**asdict(self), "density": self.density}

    def cells(self) -> list[str]:
        """The row of a table."""
        return [
            f"{self.pixels:,}",
            number(self.density, 1),
            *(number(x, 3) for x in (self.mae, self.rmse)),
            *(number(x, 2) for x in (self.shifts, self.too_near, self.too_far)),
        ]


class PixelSums:
    """Sums over pixels for :class:`RegionErrors`, by range, interior and moving.

    Parameters
    ----------
    bins : sequence of float
        Borders of the ranges [m]; every true depth must lie between the first and the last.
    """

    def __init__(self, bins: Sequence[float]) -> None:
        self._bins = bins
        # Number of pixels, compared, too near and too far; sums of |e| and e^2; and, over pixels
        # where both are known, sums of |e| and of the error of the shifted depth.
        self._sums = np.zeros((8, len(bins) - 1, 2, 2))

    def add(
        self, error: Values, truth: Values, shift: Values, interior: Mask, dynamic: Mask
    ) -> None:
        """Add pixels of one image, shape (k,) each; ``error`` and ``shift`` may be NaN [m]."""
        range_bin = np.searchsorted(self._bins, truth, side="left") - 1
        cell = (2 * np.maximum(range_bin, 0) + interior) * 2 + dynamic
        compared = ~np.isnan(error)
        size = np.abs(np.where(compared, error, 0))
        both = compared & ~np.isnan(shift)
        off = RELATIVE_ERROR * truth
        with np.errstate(invalid="ignore"):
            near, far = error < -off, error > off
        shares = (size, size * size, np.where(both, size, 0), np.where(both, shift, 0))
        for k, weight in enumerate((None, compared, near, far, *shares)):
            sums = np.bincount(cell, weight, minlength=self._sums[k].size)
            self._sums[k] += sums.reshape(self._sums[k].shape)

    def errors(
        self, ranges: int | slice = _ANY, interior: int | slice = _ANY, dynamic: int | slice = _ANY
    ) -> RegionErrors:
        """Errors of a region: index of the range, interior and dynamic 0 or 1; default: all."""
        sums = [float(table[ranges, interior, dynamic].sum()) for table in self._sums]
        pixels, compared, near, far, absolute, squared, own, shift = sums
        return RegionErrors(
            pixels=round(pixels),
            compared=round(compared),
            mae=ratio(absolute, compared),
            rmse=math.sqrt(ratio(squared, compared)),
            shifts=ratio(own, shift),
            too_near=percent(near, compared),
            too_far=percent(far, compared),
        )
