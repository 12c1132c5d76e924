"""Depth maps against ground truth: KITTI's metrics, and errors by region and range.

KITTI's metrics are means over the pixels of an image, then over images, as in its development kit.
Errors by region (interior, moving objects) and by range are over the pixels of all images together.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import InputError
from docdepth.evaluation.depth_metrics import DepthErrors, PixelSums, RegionErrors, Values
from docdepth.evaluation.nearest import cloud_distance
from docdepth.evaluation.pixels import (
    EDGE_MARGIN,
    Depth,
    Mask,
    edge_distance,
    fill_background,
    points_of,
    shifted,
)
from docdepth.evaluation.tables import Table, number, percent, plain, ratio

Mode = Literal["valid", "kitti"]

_HEAD = ("protocol", "poses", "images", "max_range", "density", "density_on_surfaces")

# Ranges that are reported apart [m].
RANGE_BINS = (0.0, 10.0, 20.0, 30.0, 50.0, 80.0)

EDGE_BINS = (-math.inf, 1.0, 3.0, 10.0, math.inf)
"""Distances to the next depth edge of the truth that are reported apart [pixels]."""

ERRORS = (
    "density: share of these pixels that have depth; MAE, RMSE: mean absolute and root mean square "
    "error; too near, too far: share more than 5 % off"
)
NOTE = (
    f"{ERRORS}; MAE in shifts: MAE over that of the true depth moved right by one pixel; "
    "interior: more than 3 pixels from a depth edge"
)

KITTI_NOTE = (
    "mae, rmse: mean absolute and root mean square error; imae, irmse: those of 1 / depth; log: of "
    "ln(depth); silog: scale-invariant, x 100; abs_rel, sq_rel: |error| / depth and its square; "
    "delta1, 2, 3: share of pixels off by less than a factor of 1.25, 1.25^2, 1.25^3; "
    "point to point: from each point to the nearest of the other cloud, both ways"
)


@dataclass(frozen=True)
class RangeErrors:
    """Errors of the pixels with ``near < true depth <= far`` [m]."""

    near: float
    far: float
    errors: RegionErrors

    def as_dict(self) -> dict[str, float]:
        """Borders and errors by name."""
        return {"near": max(self.near, 0), "far": self.far, **self.errors.as_dict()}


@dataclass(frozen=True)
class DepthResult:
    """Metrics of a set of depth maps.

    Attributes
    ----------
    protocol : str
        What was compared, as a sentence.
    poses : str
        Source of the poses.
    images : int
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
    by_range : tuple of RangeErrors
    by_edge_distance : tuple of RangeErrors
        Pixels with ``near < distance to the next depth edge <= far`` [pixels].
    regions : dict of str to RegionErrors
        Further regions by name, as they were given.
    equal_pixels : tuple of two RegionErrors, optional
        Of these maps and of those of another method, over the pixels that both fill.
    """

    protocol: str
    poses: str
    images: int
    max_range: float
    density: float
    density_on_surfaces: float
    kitti: DepthErrors
    all: RegionErrors
    interior: RegionErrors
    dynamic: RegionErrors | None = None
    dynamic_interior: RegionErrors | None = None
    point_to_point: float = math.nan
    by_range: tuple[RangeErrors, ...] = field(default=())
    by_edge_distance: tuple[RangeErrors, ...] = field(default=())
    regions: Mapping[str, RegionErrors] = field(default_factory=dict)
    equal_pixels: tuple[RegionErrors, RegionErrors] | None = None

    def as_dict(self) -> dict[str, Any]:
        """All metrics by name, ready for JSON; None replaces NaN."""
        result: dict[str, Any] = {
            **{name: getattr(self, name) for name in _HEAD},
            **asdict(self.kitti),
            "point_to_point": self.point_to_point,
            "all": self.all.as_dict(),
            "interior": self.interior.as_dict(),
        }
        if self.dynamic is not None and self.dynamic_interior is not None:
            result["dynamic"] = self.dynamic.as_dict()
            result["dynamic_interior"] = self.dynamic_interior.as_dict()
        for name in ("by_range", "by_edge_distance"):
            result[name] = [row.as_dict() for row in getattr(self, name)]
        result["regions"] = {name: errors.as_dict() for name, errors in self.regions.items()}
        if self.equal_pixels is not None:
            names = ("these", "other")
            pair = zip(names, self.equal_pixels, strict=True)
            result["equal_pixels"] = {name: errors.as_dict() for name, errors in pair}
        return dict(plain(result))

    def table(self) -> Table:
        """Errors by region and range, one row each."""
        rows = [("all", *self.all.cells()), ("interior", *self.interior.cells())]
        if self.dynamic is not None and self.dynamic_interior is not None:
            rows.append(("moving objects", *self.dynamic.cells()))
            rows.append(("their interior", *self.dynamic_interior.cells()))
        for row in self.by_range:
            rows.append((f"{row.near:g}..{row.far:g} m", *row.errors.cells()))
        for row in self.by_edge_distance:
            near = max(row.near, 0)
            far = f"more than {near:g}" if math.isinf(row.far) else f"{near:g}..{row.far:g}"
            rows.append((f"{far} px from an edge", *row.errors.cells()))
        rows += [(name, *errors.cells()) for name, errors in self.regions.items() if errors.pixels]
        if self.equal_pixels is not None:
            names = ("pixels of both: this run", "pixels of both: other")
            rows += [
                (name, *errors.cells())
                for name, errors in zip(names, self.equal_pixels, strict=True)
            ]
        title = (
            f"depth: {self.protocol}; poses: {self.poses}; {self.images} images, "
            f"density {number(self.density, 1)} % ({number(self.density_on_surfaces, 1)} % "
            "of the pixels with a true depth)"
        )
        header = ("region", "pixels", "density %", "MAE m", "RMSE m", "MAE in shifts")
        return Table(title, (*header, "too near %", "too far %"), tuple(rows), NOTE)

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
    range_bins : sequence of float
        Borders of the depth ranges that are reported apart [m].

    Raises
    ------
    InputError
        The mode is unknown.
    """

    def __init__(
        self,
        mode: Mode = "valid",
        max_range: float = 80.0,
        poses: str = "not stated",
        range_bins: Sequence[float] = RANGE_BINS,
    ) -> None:
        if mode not in ("valid", "kitti"):
            raise InputError(f"unknown mode {mode!r}; there are 'valid' and 'kitti'")
        self._mode, self._max_range, self._poses = mode, max_range, poses
        self._bins = [b for b in range_bins if b < max_range] + [max_range]
        self._images: list[DepthErrors] = []
        self._sums = PixelSums(self._bins)
        self._pixels = self._with_depth = self._surfaces = self._on_surfaces = 0
        self._distance, self._distances = 0.0, 0
        self._edges = [PixelSums([0.0, max_range]) for _ in EDGE_BINS[1:]]
        self._regions: dict[str, PixelSums] = {}
        self._equal: tuple[PixelSums, PixelSums] | None = None
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

        Raises
        ------
        InputError
            The arrays differ in size, or a depth is negative or infinite.
        """
        predicted, truth = _depth("predicted", predicted), _depth("true", truth)
        other = None if other is None else _depth("other", other)
        _check_sizes(predicted, truth, dynamic, other, regions or {})
        self._count(predicted, truth)
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
        pixels = (
            error,
            d,
            np.abs(shifted(truth).ravel()[selected] - d),
            to_edge > EDGE_MARGIN,
            moving.ravel()[selected],
        )
        self._sums.add(*pixels)
        for (near, far), sums in zip(pairwise(EDGE_BINS), self._edges, strict=True):
            _add(sums, (to_edge > near) & (to_edge <= far), pixels)
        for name, region in (regions or {}).items():
            sums = self._regions.setdefault(name, PixelSums([0.0, self._max_range]))
            _add(sums, region.ravel()[selected], pixels)
        if other is not None:
            self._add_equal(other.ravel()[selected] - d, pixels)
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

    def _count(self, predicted: Depth, truth: Depth) -> None:
        """Count pixels for the densities."""
        surface, has_depth = ~np.isnan(truth), ~np.isnan(predicted)
        self._pixels += truth.size
        self._with_depth += int(np.count_nonzero(has_depth))
        self._surfaces += int(np.count_nonzero(surface))
        self._on_surfaces += int(np.count_nonzero(has_depth & surface))

    def _add_equal(self, error: Values, pixels: tuple[Any, ...]) -> None:
        """Add the pixels that both methods fill; ``error`` is that of the other one."""
        if self._equal is None:
            self._equal = PixelSums([0.0, self._max_range]), PixelSums([0.0, self._max_range])
        both = ~np.isnan(error) & ~np.isnan(pixels[0])
        _add(self._equal[0], both, pixels)
        _add(self._equal[1], both, (error, *pixels[1:]))

    def result(self) -> DepthResult:
        """Metrics of all images added so far."""
        filled = "empty pixels filled as in KITTI's kit"
        compared = filled if self._mode == "kitti" else "pixels with depth"
        return DepthResult(
            protocol=f"{compared}, truth up to {self._max_range:g} m",
            poses=self._poses,
            images=len(self._images),
            max_range=self._max_range,
            density=percent(self._with_depth, self._pixels),
            density_on_surfaces=percent(self._on_surfaces, self._surfaces),
            kitti=DepthErrors.mean(self._images),
            all=self._sums.errors(),
            interior=self._sums.errors(interior=1),
            dynamic=self._sums.errors(dynamic=1) if self._with_dynamic else None,
            dynamic_interior=(
                self._sums.errors(interior=1, dynamic=1) if self._with_dynamic else None
            ),
            point_to_point=ratio(self._distance, self._distances),
            by_range=tuple(
                RangeErrors(near, far, self._sums.errors(ranges=k))
                for k, (near, far) in enumerate(pairwise(self._bins))
            ),
            by_edge_distance=tuple(
                RangeErrors(near, far, sums.errors())
                for (near, far), sums in zip(pairwise(EDGE_BINS), self._edges, strict=True)
            ),
            regions={name: sums.errors() for name, sums in self._regions.items()},
            equal_pixels=(
                None if self._equal is None else (self._equal[0].errors(), self._equal[1].errors())
            ),
        )


def _add(sums: PixelSums, chosen: Mask, pixels: tuple[Any, ...]) -> None:
    """Add some of the pixels."""
    sums.add(*(column[chosen] for column in pixels))


def _check_sizes(
    predicted: Depth,
    truth: Depth,
    dynamic: Mask | None,
    other: Depth | None,
    regions: Mapping[str, Mask],
) -> None:
    masks = [] if dynamic is None else [dynamic]
    if any(image.shape != truth.shape for image in (predicted, *masks, *regions.values())):
        raise InputError(
            f"predicted depth {predicted.shape}, true depth {truth.shape} and the mask of "
            "moving objects must have one size; was the truth made for another camera?"
        )
    if other is not None and other.shape != truth.shape:
        raise InputError(
            f"the other depth {other.shape} and the true depth {truth.shape} must have one size; "
            "was it made for another camera?"
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
