"""Errors of the layer ``normal``, against the surfaces of true depth maps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docdepth.concurrency import Progress, null_progress
from docdepth.errors import DatasetError
from docdepth.evaluation.depth_truth import DepthTruth
from docdepth.evaluation.runs import truth_folder
from docdepth.evaluation.tables import Figures, Table, number, percent
from docdepth.pipeline.plan import require
from docdepth.pipeline.run_reader import Run

WITHIN_DEG = (11.25, 22.5, 30.0)
"""Angles of which tables of normals tell the share of pixels within."""

_FLAT = 1e-5
"""How much of the inverse depth of a pixel's eight neighbours may lie beside the plane through it:
more than float32 rounds, and a normal is right within half a degree."""

_RIGHT = 0.05
"""Normals count where the depth is less off, as a share of it: others are of another surface."""

_STEP = 0.01  # of the angles that are counted [degrees]
_FEWEST = 100  # pixels of a class


@dataclass(frozen=True)
class NormalErrors(Figures):
    """Angles between normals and true ones.

    Attributes
    ----------
    pixels : int
        That have both, and whose depth is less than 5 % off.
    density : float
        Their share of the pixels with a true normal and such a depth [%].
    median : float
        Angle [degrees].
    within : dict of str to float
        Share of pixels within 11.25, 22.5 and 30 degrees [%].
    """

    pixels: int
    density: float
    median: float
    within: dict[str, float]

    def cells(self) -> tuple[str, ...]:
        """The figures as text."""
        values = self.median, *self.within.values(), self.density
        return (str(self.pixels), *(number(v, 2 if k == 0 else 1) for k, v in enumerate(values)))


@dataclass(frozen=True)
class NormalResult(Figures):
    """Errors of the normals of a run.

    Attributes
    ----------
    errors : dict of str to NormalErrors
        ``all``, and each true class, where the truth tells it.
    """

    images: int
    errors: dict[str, NormalErrors]

    def table(self) -> Table:
        """A row for each class."""
        within = (f"within {angle:g} %" for angle in WITHIN_DEG)
        return Table(
            f"normals of {self.images} images, degrees",
            ("pixels of", "count", "median", *within, "density %"),
            tuple((name, *errors.cells()) for name, errors in self.errors.items()),
        )


class NormalEvaluation:
    """Sums up angles, image by image."""

    def __init__(self) -> None:
        self._images = 0
        self._angles: dict[str, NDArray[np.int64]] = {}
        self._wanted: dict[str, int] = {}

    def add(
        self,
        normal: NDArray[np.float32],
        true: NDArray[np.float32],
        counted: NDArray[np.bool_],
        regions: Mapping[str, NDArray[np.bool_]],
    ) -> None:
        """Add an image.

        Parameters
        ----------
        normal, true : ndarray of float32, shape (h, w, 3)
            Unit normals in the camera frame; NaN = none.
        counted : ndarray of bool, shape (h, w)
            Pixels to compare.
        regions : dict of str to ndarray of bool, shape (h, w)
            Pixels that are summed up apart.
        """
        self._images += 1
        wanted = counted & np.isfinite(true).all(axis=2)
        cosine = np.einsum("ijk,ijk->ij", normal, true).clip(-1, 1)
        found = wanted & np.isfinite(cosine)
        for name, region in {"all": wanted, **regions}.items():
            degrees = np.degrees(np.arccos(cosine[found & region]))
            counts = np.bincount((degrees / _STEP).astype(int), minlength=round(180 / _STEP) + 1)
            self._angles[name] = self._angles.get(name, 0) + counts
            self._wanted[name] = self._wanted.get(name, 0) + int((wanted & region).sum())

    def result(self) -> NormalResult:
        """The figures of all images."""
        large = [n for n, c in self._angles.items() if n == "all" or c.sum() >= _FEWEST]
        return NormalResult(self._images, {name: self._errors(name) for name in large})

    def _errors(self, name: str) -> NormalErrors:
        counts = self._angles[name]
        pixels, below = int(counts.sum()), np.cumsum(counts)
        within = {f"{a:g}": percent(int(below[round(a / _STEP) - 1]), pixels) for a in WITHIN_DEG}
        median = _STEP * (np.searchsorted(below, pixels / 2) + 0.5) if pixels else np.nan
        return NormalErrors(pixels, percent(pixels, self._wanted[name]), float(median), within)


def true_normals(depth: NDArray[np.float32], K: NDArray[np.float64]) -> NDArray[np.float32]:
    """Normals of an exact depth map, where a pixel and its eight neighbours show one plane.

    The inverse depth of a plane is linear in the image: ``1 / z = (a, b, c) . K^-1 (u, v, 1)``, and
    (a, b, c) is its normal.

    Parameters
    ----------
    depth : ndarray of float32, shape (h, w)
        Metres, NaN = none; not rounded as a PNG is.
    K : ndarray of float64, shape (3, 3)

    Returns
    -------
    ndarray of float32, shape (h, w, 3)
        In the camera frame (x right, y down, z forward), towards the camera; NaN where there is no
        plane.
    """
    inverse = np.pad(1 / depth.astype(np.float64), 1, constant_values=np.nan)
    height, width = depth.shape

    def moved(rows: int, columns: int) -> NDArray[np.float64]:
        return inverse[1 + rows : 1 + rows + height, 1 + columns : 1 + columns + width]

    middle = moved(0, 0)
    across, down = (moved(0, 1) - moved(0, -1)) / 2, (moved(1, 0) - moved(-1, 0)) / 2
    is_flat = np.ones(depth.shape, bool)
    for rows in (-1, 0, 1):
        for columns in (-1, 0, 1):
            off = moved(rows, columns) - middle - columns * across - rows * down
            is_flat &= np.abs(off) < _FLAT * middle
    x = (np.arange(width) - K[0, 2]) / K[0, 0]
    y = ((np.arange(height) - K[1, 2]) / K[1, 1])[:, None]
    a, b = K[0, 0] * across, K[1, 1] * down
    plane = np.stack([a, b, middle - a * x - b * y], axis=2)
    with np.errstate(invalid="ignore"):  # nothing at all in a direction: 0 / 0
        plane /= -np.linalg.norm(plane, axis=2, keepdims=True)
    return np.where(is_flat[..., None], plane, np.nan).astype(np.float32)


def evaluate_normals(
    run: Path | str, depth: Path, camera: str | None = None, progress: Progress = null_progress
) -> NormalResult:
    """Compare the normals of a run with those of true depth maps of the same names.

    Parameters
    ----------
    run : Path or str
        Run folder with depth maps. Normals that it has not stored are drawn, in seconds each.
    depth : Path
        As for :func:`~docdepth.evaluation.runs.evaluate_depth`, exact and dense.
    camera : str, optional
        Needed if the run has several.
    """
    opened = Run(run)
    subfolder = opened.folder.depth_folder(camera)
    name = opened.folder.camera_in(subfolder)
    require(opened.folder, f"render {name}")
    truth = DepthTruth(truth_folder(depth, "depth_2", opened.folder), opened.folder, subfolder)
    images, evaluation = {image.name: image for image in opened.cameras[name]}, NormalEvaluation()
    for done, one in enumerate(truth.maps, 1):
        found = truth.read(one)
        if not found.is_exact:
            raise DatasetError(
                f"{truth.folder} holds depth in steps, as PNG has it; normals need exact depth of "
                "every pixel, as NPY, TIFF or EXR of 32 bits"
            )
        with np.errstate(invalid="ignore"):
            is_right = np.abs(found.made - found.true) < _RIGHT * found.true
        normal = images[one].layers["normal"][found.part]
        evaluation.add(normal, true_normals(found.true, found.K), is_right, found.classes)
        progress("normals", done, len(truth.maps))
    return evaluation.result()
