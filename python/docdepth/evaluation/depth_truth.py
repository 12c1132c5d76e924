"""True depth maps on disk, and the regions of their images whose errors are reported apart."""

from __future__ import annotations

import logging
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import DatasetError
from docdepth.evaluation.label_counts import class_name, classes_of
from docdepth.evaluation.pixels import Mask
from docdepth.geometry.camera import below_horizon
from docdepth.geometry.points import MOVING_LABELS
from docdepth.io.depth import maps_in, read_depth
from docdepth.io.run_folder import RunFolder
from docdepth.io.untrusted import ArrayError, read_array, read_layers, read_text
from docdepth.pipeline.convert import INSIDE

log = logging.getLogger(__name__)

Part = tuple[slice, slice]
_WHOLE: Part = (slice(None), slice(None))

_SELECTION = "groundtruth_depth"
"""Folder of ``val_selection_cropped`` with maps of all drives and cameras."""


CONFIDENCES = (0.5, 0.8, 0.95)
"""Borders of the confidences that are reported apart."""


class TrueDepth(NamedTuple):
    """True depth of an image, and what was made of it.

    Attributes
    ----------
    made, true : ndarray of float32, shape (h, w)
        Metres; NaN = none.
    K : ndarray of float64, shape (3, 3)
        Camera matrix of both.
    part : tuple of two slices
        Rows and columns of the whole image that they show.
    dynamic : ndarray of bool, shape (h, w), optional
        Pixels of moving objects, where the truth tells.
    regions : dict of str to ndarray of bool (h, w)
        Pixels below the horizon, and of a confidence if the run has that layer.
    classes : dict of str to ndarray of bool (h, w)
        Pixels of each true class, where the truth tells.
    is_exact : bool
        Whether the true depth is not in steps, as that of a PNG is.
    """

    made: NDArray[np.float32]
    true: NDArray[np.float32]
    K: NDArray[np.float64]
    part: Part
    dynamic: Mask | None
    regions: dict[str, Mask]
    classes: dict[str, Mask]
    is_exact: bool


class DepthTruth:
    """The true depth maps of a camera of a run.

    Parameters
    ----------
    folder : Path
        Folder of depth maps in any format, beside which ``class_2`` may mark what moves; or
        KITTI's depth completion, the whole of it or one drive, or its ``val_selection_cropped``,
        which hold maps of some images.
    depth_folder : str
        Of the camera, in ``depth/`` of the run.

    Attributes
    ----------
    maps : dict of str to Path
        Depth maps of the run that have a true one.
    """

    def __init__(self, folder: Path, run: RunFolder, depth_folder: str) -> None:
        camera, made = run.camera_in(depth_folder), maps_in(run.path / "depth" / depth_folder)
        if not made:
            raise DatasetError(
                f"{run.path}/depth has no depth maps",
                f"make them: `docdepth.run(..., {str(run.path)!r})`",
                code="no-maps",
            )
        calibration, T_camera_lidar, _ = run.calibration(depth_folder)
        self._K, self._below = calibration.K, below_horizon(calibration, T_camera_lidar)
        self._layers = run.path / "layers" / depth_folder
        self._intrinsics: str | None = None
        drive = (run.recording_path or run.path).name
        of_drive = (folder / part / drive for part in ("", "train", "val"))
        folder = next((path for path in of_drive if (path / INSIDE).is_dir()), folder)
        self.folder = folder
        if (folder / _SELECTION).is_dir():
            self._intrinsics = f"{drive}_image_{{}}_{camera}.txt"
            start, end = f"{drive}_{_SELECTION}_", f"_{camera}"
            found = maps_in(folder / _SELECTION)
            chosen = [n for n in found if n.startswith(start) and n.endswith(end)]
            self._truths = {n[len(start) : -len(end)]: found[n] for n in chosen}
        elif (folder / INSIDE).is_dir():
            self.folder = folder / INSIDE / camera
            self._truths = maps_in(self.folder)
        else:
            self._truths = maps_in(folder)
        self.maps = {name: path for name, path in made.items() if name in self._truths}
        if not self.maps:
            raise DatasetError(
                f"{self.folder} has no depth map of the {len(made)} images of the run; is it of "
                "this drive?"
            )
        if len(self.maps) < len(made):
            log.warning(
                "%s has no depth map of %d of %d images; they are not compared",
                self.folder, len(made) - len(self.maps), len(made),
            )  # fmt: skip
        self._classes = self.folder.parent / self.folder.name.replace("depth", "class")

    def read(self, name: str) -> TrueDepth:
        """Made and true depth of an image; the made one is cropped where the truth is."""
        made, true = read_depth(self.maps[name]), read_depth(self._truths[name])
        K, part = self._K, _WHOLE
        if self._intrinsics is not None and made.shape != true.shape:
            left, top = self._corner(name, made.shape, true.shape)
            height, width = true.shape
            K = K.copy()
            K[0, 2], K[1, 2] = K[0, 2] - left, K[1, 2] - top
            part = slice(top, top + height), slice(left, left + width)
            if min(left, top) < 0 or made[part].shape != true.shape:
                raise DatasetError(
                    f"{self._truths[name]} is no part of an image of {made.shape[1]} x "
                    f"{made.shape[0]} pixels; is it of this drive and camera?"
                )
        regions = {"below the horizon": self._below[part], **self._by_confidence(name, part)}
        is_exact = self._truths[name].suffix != ".png"
        file = self._classes / f"{name}.npy"
        if self._classes == self.folder or not file.is_file():
            return TrueDepth(made[part], true, K, part, None, regions, {}, is_exact)
        labels = array_of(file).astype(np.uint32)
        numbers = classes_of(labels.ravel()).reshape(labels.shape)
        classes = {class_name(one): numbers == one for one in np.unique(numbers).tolist()}
        dynamic = np.isin(numbers, MOVING_LABELS)
        return TrueDepth(made[part], true, K, part, dynamic, regions, classes, is_exact)

    def _by_confidence(self, name: str, part: Part) -> dict[str, Mask]:
        """Pixels between two confidences, if the run has that layer of the image."""
        file = self._layers / f"{name}.npz"
        layer = read_layers(file, "confidence").get("confidence")
        if layer is None:
            return {}
        confidence, names = layer[part], ("less", *(f"{border:g}" for border in CONFIDENCES), "1")
        return {
            f"confidence {names[k]}{' to' if k else ' than'} {names[k + 1]}": np.asarray(
                (confidence >= low) & (confidence < high)
            )
            for k, (low, high) in enumerate(pairwise((-np.inf, *CONFIDENCES, np.inf)))
        }

    def _corner(self, name: str, made: tuple[int, ...], true: tuple[int, ...]) -> tuple[int, int]:
        """Column and row where the crop begins: by its intrinsics, else the lower middle."""
        file = self.folder / "intrinsics" / str(self._intrinsics).format(name)
        if not file.is_file():
            return (made[1] - true[1]) // 2, made[0] - true[0]
        try:
            values = np.array(read_text(file).split(), np.float64).reshape(3, 3)
        except ValueError:
            raise DatasetError(
                f"{file} does not hold the nine numbers of a camera matrix"
            ) from None
        return round(self._K[0, 2] - values[0, 2]), round(self._K[1, 2] - values[1, 2])


def array_of(path: Path) -> NDArray[Any]:
    """An array beside true labels or depth maps; DatasetError if the file holds none."""
    try:
        return read_array(path)
    except ArrayError as error:
        raise DatasetError(f"{path} is no array of numpy ({error}); copy it again") from None
