"""Depth maps against ground truth: KITTI's metrics, and errors by region and range.

KITTI's metrics are means over the pixels of an image, then over images, as in its development kit.
Errors by region (interior, moving objects) and by range are over the pixels of all images together.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import partial
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import InputError
from docdepth.evaluation.depth_metrics import RANGE_BINS, DepthErrors, PixelSums, RegionErrors
from docdepth.evaluation.pixels import (
    EDGE_MARGIN,
    Depth,
    Mask,
    cloud_distance,
    edge_distance,
    fill_background,
)
from docdepth.evaluation.tables import Band, Figures, Table, number, percent, ratio
from docdepth.geometry.camera import points_of

Mode = Literal["valid", "kitti"]

EDGE_BINS = (-math.inf, 1.0, 3.0, 10.0, math.inf)
"""Distances to the next depth edge of the truth that are reported apart [pixels]."""

ERRORS = (
    "density: share of these pixels that have depth; MAE, RMSE: mean absolute and root mean square "
    "error; too near, too far: share more than 5 % off"
)
NOTE = (
    f"{ERRORS}; edge displacement: MAE over that of the true depth moved right by one pixel; "
    "interior: more than 3 pixels from a depth edge"
)

KITTI_NOTE = (
    "mae, rmse: mean absolute and root mean square error; imae, irmse: those of 1 / depth; log: of "
    "ln(depth); silog: scale-invariant, x 100; abs_rel, sq_rel: |error| / depth and its square; "
    "delta1, 2, 3: share of pixels off by less than a factor of 1.25, 1.25^2, 1.25^3; "
    "point to point: from each point to the nearest of the other cloud, both ways"
)


@dataclass(frozen=True)
class DepthResult(Figures):
    """Metrics of a set of depth maps.

    Attributes
    ----------
    protocol : str
        What was compared, as a sentence.
    poses : str
        Source of the poses.
    max_range : float
        Pixels with a larger true depth are not compared [m].
    density : float
        Share of all pixels that have depth [%], before hole filling.
    density_on_surfaces : float
        Share of the pixels with a true depth, at any distance, that have depth [%], before hole
        filling.
    kitti : DepthErrors
        KITTI's metrics, means over images.
    all, interior : RegionErrors
        All pixels, and those farther than 3 pixels from a depth edge of the ground truth. The
        interior is meaningful only for dense ground truth.
    dynamic, dynamic_interior : RegionErrors, optional
        Pixels of moving objects, and their interior; None without a mask.
    point_to_point : float
        Distance between the points of true and of predicted depth, from each to the nearest of the
        other cloud, both ways, over the compared pixels of an image [m]; NaN without camera
        matrices.
    by_range : tuple of Band
        Pixels with ``near < true depth <= far`` [m].
    by_edge_distance : tuple of Band
        Pixels with ``near < distance to the next depth edge <= far`` [pixels], the first with those
        on an edge.
    regions : dict of str to RegionErrors
        Further regions by name, as they were given.
    equal_pixels : dict of str to RegionErrors, optional
        ``these`` maps and the ``other`` method's, over the pixels that both fill.
    """

    protocol: str
    poses: str
    images: int
    max_range: float
    density: float
    density_on_surfaces: float
    kitti: DepthErrors
    point_to_point: float
    all: RegionErrors
    interior: RegionErrors
    dynamic: RegionErrors | None
    dynamic_interior: RegionErrors | None
    by_range: tuple[Band[RegionErrors], ...]
    by_edge_distance: tuple[Band[RegionErrors], ...]
    regions: dict[str, RegionErrors]
    equal_pixels: dict[str, RegionErrors] | None
    flat = ("kitti",)

    def table(self) -> Table:
        """Errors by region and range, one row each."""
        rows: dict[str, RegionErrors | None] = {"all": self.all, "interior": self.interior}
        rows |= {"moving objects": self.dynamic, "their interior": self.dynamic_interior}
        rows |= {f"{band} m": band.figures for band in self.by_range}
        for band in self.by_edge_distance:
            far = f"more than {band.near:g}" if math.isinf(band.far) else str(band)
            rows[f"{far} px from an edge"] = band.figures
        rows |= {name: errors for name, errors in self.regions.items() if errors.pixels}
        for name, whose in (("these", "this run"), ("other", "other")):
            rows[f"pixels of both: {whose}"] = (self.equal_pixels or {}).get(name)
        title = (
            f"depth: {self.protocol}; poses: {self.poses}; {self.images} images, "
            f"density {number(self.density, 1)} % ({number(self.density_on_surfaces, 1)} % "
            f"of the pixels with a true depth); abs rel {number(self.kitti.abs_rel, 2)} %, "
            f"RMSE {number(self.kitti.rmse, 3)} m, delta1 {number(self.kitti.delta1, 2)} %"
        )
        header = ("region", "pixels", "density %", "MAE m", "RMSE m", "edge displacement px")
        cells = ((name, *errors.cells()) for name, errors in rows.items() if errors is not None)
        return Table(title, (*header, "too near %", "too far %"), tuple(cells), NOTE)

    def kitti_table(self) -> Table:
        """KITTI's metrics, one row each."""
        header = ("metric", "mean over images")
        units = {"mae": "m", "rmse": "m", "imae": "1/km", "irmse": "1/km", "sq_rel_eigen": "m"}
        percents = ("abs_rel", "sq_rel", "delta1", "delta2", "delta3")
        rows = [
            (
                name + (f" [{units[name]}]" if name in units else "") + " [%]" * (name in percents),
                number(value, 4),
            )
            for name, value in asdict(self.kitti).items()
        ]
        rows.append(("point to point [m]", number(self.point_to_point, 4)))
        return Table(f"depth: {self.protocol}", header, tuple(rows), KITTI_NOTE)


class DepthEvaluation:
    """Compares depth maps with ground truth, image by image.

    Parameters
    ----------
    mode : {"valid", "kitti"}
        ``valid`` compares pixels that have depth; ``kitti`` first fills empty pixels as the
        development kit does.
    max_range : float
        Pixels with a larger true depth are not compared [m].
    poses : str
        Source of the poses; printed with the metrics.
    """

    def __init__(
        self, mode: Mode = "valid", max_range: float = 80.0, poses: str = "not stated"
    ) -> None:
        if mode not in ("valid", "kitti"):
            raise InputError(f"unknown mode {mode!r}; there are 'valid' and 'kitti'")
        self._mode, self._max_range, self._poses = mode, max_range, poses
        self._images: list[DepthErrors] = []
        self._sums = PixelSums(max_range, RANGE_BINS)
        self._edges = {border: PixelSums(max_range) for border in pairwise(EDGE_BINS)}
        self._regions = defaultdict[str, PixelSums](partial(PixelSums, max_range))
        self._equal = defaultdict[str, PixelSums](partial(PixelSums, max_range))
        # Pixels, those with depth, those with true depth, and those with both.
        self._counts = np.zeros(4, np.int64)
        self._distance, self._distances = 0.0, 0
        self._with_dynamic = False

    def add(
        self,
        predicted: Depth,
        truth: Depth,
        dynamic: Mask | None = None,
        K: NDArray[np.float64] | None = None,
        regions: Mapping[str, Mask] | None = None,
        other: Depth | None = None,
    ) -> DepthErrors:
        """Compare one depth map with ground truth.

        Parameters
        ----------
        predicted, truth : ndarray of float32, shape (h, w)
            Depth along the optical axis [m]; NaN or 0 = none.
        dynamic : ndarray of bool, shape (h, w), optional
            Pixels of moving objects.
        K : ndarray of float64, shape (3, 3), optional
            Camera matrix; needed for ``point_to_point``.
        regions : mapping of str to ndarray of bool (h, w), optional
            Pixels that are reported apart, by name.
        other : ndarray of float32, shape (h, w), optional
            The map of another method, to be compared over the pixels that both fill.

        Returns
        -------
        DepthErrors
            KITTI's metrics of this image.
        """
        predicted, truth = _depth("predicted", predicted), _depth("true", truth)
        other = None if other is None else _depth("other", other)
        regions = regions or {}
        given = {"predicted depth": predicted, "other depth": other, "moving objects": dynamic}
        for name, image in (given | dict(regions)).items():
            if image is not None and image.shape != truth.shape:
                raise InputError(
                    f"{name} {image.shape} and true depth {truth.shape} must have one size; was "
                    "one made for another camera?"
                )
        known, surface = ~np.isnan(predicted), ~np.isnan(truth)
        counted = (known, surface, known & surface)
        self._counts += np.array([truth.size, *map(np.count_nonzero, counted)])
        if self._mode == "kitti":
            predicted = fill_background(predicted)
            other = None if other is None else fill_background(other)
        with np.errstate(invalid="ignore"):
            selected = np.flatnonzero(truth <= self._max_range)
        d = truth.ravel()[selected].astype(np.float64)
        p = predicted.ravel()[selected].astype(np.float64)
        error = p - d
        self._with_dynamic |= dynamic is not None
        moving = np.zeros(truth.shape, bool) if dynamic is None else np.asarray(dynamic, bool)
        to_edge = edge_distance(truth).ravel()[selected]
        shifted = np.pad(truth[:, :-1], ((0, 0), (1, 0)), constant_values=np.nan)
        moved = np.abs(shifted.ravel()[selected] - d)
        pixels = (error, d, moved, to_edge > EDGE_MARGIN, moving.ravel()[selected])
        self._sums.add(*pixels)
        for (near, far), sums in self._edges.items():
            sums.add(*pixels, among=(to_edge > near) & (to_edge <= far))
        for name, region in regions.items():
            self._regions[name].add(*pixels, among=region.ravel()[selected])
        if other is not None:
            its_error = other.ravel()[selected] - d
            both = ~np.isnan(its_error) & ~np.isnan(error)
            self._equal["these"].add(*pixels, among=both)
            self._equal["other"].add(its_error, *pixels[1:], among=both)
        known = ~np.isnan(error)
        if K is not None:
            compared = selected[known]
            exact, made = (points_of(K, depth, compared) for depth in (truth, predicted))
            distance, points = cloud_distance(exact, made)
            self._distance += distance
            self._distances += points
        errors = DepthErrors.of(d[known], p[known])
        self._images.append(errors)
        return errors

    def result(self) -> DepthResult:
        """Metrics of all images added so far."""
        filled = "empty pixels filled as in KITTI's kit"
        compared = filled if self._mode == "kitti" else "pixels with depth"
        errors, with_dynamic = self._sums.errors, self._with_dynamic
        pixels, with_depth, surfaces, both = self._counts.tolist()
        return DepthResult(
            protocol=f"{compared}, truth up to {self._max_range:g} m",
            poses=self._poses,
            images=len(self._images),
            max_range=self._max_range,
            density=percent(with_depth, pixels),
            density_on_surfaces=percent(both, surfaces),
            kitti=DepthErrors.mean(self._images),
            point_to_point=ratio(self._distance, self._distances),
            all=errors(),
            interior=errors(interior=1),
            dynamic=errors(dynamic=1) if with_dynamic else None,
            dynamic_interior=errors(interior=1, dynamic=1) if with_dynamic else None,
            by_range=self._sums.by_range(),
            by_edge_distance=tuple(
                Band(max(near, 0), far, sums.errors()) for (near, far), sums in self._edges.items()
            ),
            regions={name: sums.errors() for name, sums in self._regions.items()},
            equal_pixels={name: sums.errors() for name, sums in self._equal.items()} or None,
        )


def _depth(name: str, depth: Depth) -> Depth:
    depth = np.asarray(depth)
    if depth.ndim != 2 or depth.dtype.kind != "f":
        raise InputError(
            f"{name} depth must be a float image in metres, shape (h, w); got {depth.dtype} "
            f"{depth.shape}"
        )
    depth = np.where(depth == 0, np.float32(np.nan), depth).astype(np.float32, copy=False)
    with np.errstate(invalid="ignore"):
        wrong = (depth < 0) | np.isinf(depth)
    if wrong.any():
        row, column = np.argwhere(wrong)[0]
        raise InputError(
            f"{name} depth has {np.count_nonzero(wrong)} negative or infinite pixels, the first "
            f"at row {row}, column {column}; NaN or 0 means no depth"
        )
    return depth
