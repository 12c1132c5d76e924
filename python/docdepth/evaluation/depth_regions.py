"""Regions of an image whose depth errors are reported apart: horizon, confidence, classes."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import DamagedFileError
from docdepth.evaluation.label_counts import class_name
from docdepth.evaluation.pixels import Mask
from docdepth.geometry.camera import below_horizon
from docdepth.io.npy import ArrayError, read_arrays
from docdepth.io.run_folder import RunFolder

CONFIDENCES = (0.5, 0.8, 0.95)
"""Borders of the confidences that are reported apart."""


class DepthRegions:
    """Pixels below the horizon, of a confidence if the run has that layer, of a true class.

    Parameters
    ----------
    run : RunFolder
    depth_folder : str
        Of the camera, in ``depth/`` of the run.
    """

    def __init__(self, run: RunFolder, depth_folder: str) -> None:
        camera, T_camera_lidar, _ = run.calibration(depth_folder)
        self._below = below_horizon(camera, T_camera_lidar)
        self._layers = run.path / "layers" / depth_folder

    def of(
        self, name: str, classes: NDArray[np.uint32] | None, part: tuple[slice, slice]
    ) -> dict[str, Mask]:
        """Masks (h, w) by what they show.

        Parameters
        ----------
        name : str
            Of the image.
        classes : ndarray of uint32, shape (h, w), optional
            SemanticKITTI class of each pixel.
        part : tuple of two slices
            Rows and columns of the image that are compared.
        """
        regions = {"below the horizon": self._below[part]}
        file = self._layers / f"{name}.npz"
        if file.is_file():
            confidence = _confidence(file)
            if confidence is not None:
                regions |= _by_confidence(confidence[part])
        if classes is not None:
            for number in np.unique(classes).tolist():
                regions[class_name(number)] = classes == number
        return regions


def _confidence(file: Path) -> NDArray[np.float32] | None:
    """The layer of an image; None if it has other layers only."""
    try:
        return read_arrays(file).get("confidence")
    except (OSError, ArrayError) as error:
        raise DamagedFileError(file, str(error)) from None


def _by_confidence(confidence: NDArray[np.float32]) -> dict[str, Mask]:
    borders = (-np.inf, *CONFIDENCES, np.inf)
    names = ("less", *(f"{border:g}" for border in CONFIDENCES), "1")
    return {
        f"confidence {names[k]}{' than' if not k else ' to'} {names[k + 1]}": np.asarray(
            (confidence >= low) & (confidence < high)
        )
        for k, (low, high) in enumerate(pairwise(borders))
    }
