"""Errors of depth: KITTI's figures of an image, and sums over the pixels of many."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.evaluation.pixels import Depth, Mask, shifted
from docdepth.evaluation.tables import number, percent, ratio

# Too near or too far is more than this share off.
_OFF = 0.05


@dataclass(frozen=True)
class DepthErrors:
    """Mean errors of KITTI's development kit, in its units where it has some.

    Attributes
    ----------
    mae, rmse : float
        Metres.
    imae, irmse : float
        Of inverse depth [1/km].
    log_mae, log_rmse : float
        Of the natural logarithm of depth.
    silog : float
        Scale-invariant logarithmic error, times 100.
    abs_rel : float
        Percent.
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
        log = np.log(d / p)
        squared_log = float(np.mean(log * log))
        worse = np.exp(np.abs(log))
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
        """The mean over images; those without a pixel to compare do not count."""
        rows = [tuple(asdict(e).values()) for e in errors if not math.isnan(e.mae)]
        return cls(*(float(x) for x in np.mean(rows, axis=0))) if rows else cls()


@dataclass(frozen=True)
class RegionErrors:
    """Errors over some of the pixels of all images.

    Attributes
    ----------
    pixels : int
        Pixels of the truth there.
    compared : int
        Those with depth.
    mae, rmse : float
        Metres.
    shifts : float
        MAE over that of the exact depth moved right by one pixel, on the same pixels.
    too_near, too_far : float
        Share of compared pixels more than 5 % off [%].
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
            *(number(x, 1) for x in (self.density,)),
            *(number(x, 3) for x in (self.mae, self.rmse)),
            *(number(x, 2) for x in (self.shifts, self.too_near, self.too_far)),
        ]


class Region:
    """Sums over the pixels of a region, from which :class:`RegionErrors` is made."""

    def __init__(self) -> None:
        self.pixels = self.compared = self.near = self.far = 0
        self.absolute = self.squared = self.own_at_shift = self.shift = 0.0

    def add(self, image: ComparedPixels, where: Mask) -> None:
        """Add one image's pixels that ``where`` selects, a mask over its pixels of the truth."""
        self.pixels += int(np.count_nonzero(where))
        inside = where & image.has_depth
        difference = image.difference[inside]
        size = np.abs(difference)
        off = _OFF * image.truth[inside]
        shift = image.shift[inside]
        known = ~np.isnan(shift)
        self.compared += len(difference)
        self.near += int(np.count_nonzero(difference < -off))
        self.far += int(np.count_nonzero(difference > off))
        self.absolute += float(size.sum(dtype=np.float64))
        self.squared += float((difference * difference).sum())
        self.own_at_shift += float(size[known].sum(dtype=np.float64))
        self.shift += float(shift[known].sum(dtype=np.float64))

    def errors(self) -> RegionErrors:
        return RegionErrors(
            pixels=self.pixels,
            compared=self.compared,
            mae=ratio(self.absolute, self.compared),
            rmse=math.sqrt(ratio(self.squared, self.compared)),
            shifts=ratio(self.own_at_shift, self.shift),
            too_near=percent(self.near, self.compared),
            too_far=percent(self.far, self.compared),
        )


class ComparedPixels:
    """The pixels of one image whose truth is known and near enough, as flat arrays."""

    def __init__(self, predicted: Depth, truth: Depth, selected: Mask) -> None:
        self.selected = selected
        self.truth = truth[selected].astype(np.float64)
        self.predicted = predicted[selected].astype(np.float64)
        self.difference = self.predicted - self.truth
        self.shift = np.abs(shifted(truth)[selected] - self.truth)
        self.has_depth = ~np.isnan(self.difference)
