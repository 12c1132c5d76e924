"""Whether the camera of a run is right, and what a wrong one does to depth.

Returns that were left out are looked at from the LiDAR, so they say nothing about the camera. The
images do: depth edges lie beside the edges that they show. The change that brings both together
also tells what each pixel should have shown.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docdepth.concurrency import Progress, null_progress
from docdepth.datasets import CameraStream
from docdepth.diagnostics.calibration import (
    IMAGES,
    CalibrationCheck,
    RunEdges,
    compare,
    edges_of_images,
)
from docdepth.errors import CalibrationError, DatasetError, RunError
from docdepth.evaluation.depth_metrics import RELATIVE_ERROR
from docdepth.geometry.camera import Camera, pixels_in_image
from docdepth.geometry.points import evenly
from docdepth.geometry.se3 import rigid, rotation_exp, transform_points
from docdepth.io.depth import maps_in, read_depth
from docdepth.io.run_folder import RunFolder
from docdepth.io.tracks import tracks_in
from docdepth.pipeline.camera_fit import (
    FITTED_IMAGES,
    LEAST_PATH,
    CameraFit,
    fit_camera,
    stored_fit,
)
from docdepth.pipeline.cameras import fitted
from docdepth.pipeline.plan import require
from docdepth.pipeline.run_inputs import recorded_camera


@dataclass(frozen=True)
class CameraError:
    """Difference of depth maps as they are and as a right camera would see them.

    Attributes
    ----------
    verdict : str
        What is wrong with the camera, in words.
    mae : float
        Mean absolute difference [m]. NaN where no change of the camera fits the images.
    wrong : float
        Pixels that differ by more than 5 % [%], or NaN.
    """

    verdict: str
    mae: float
    wrong: float

    @property
    def line(self) -> str:
        """The verdict, and what it means for depth if that is known."""
        if math.isnan(self.mae):
            return f"{self.verdict}; what it adds to the error of depth is not known"
        return (
            f"{self.verdict}; that alone puts {self.wrong:.1f} % of the pixels more than 5 % off, "
            f"{self.mae:.2f} m in the mean of all pixels"
        )


def camera_error(
    run: Path | str | RunFolder,
    camera: str | None = None,
    max_depth: float = 80.0,
    progress: Progress = null_progress,
) -> CameraError | None:
    """Estimate how wrong depth maps are because of their camera.

    Parameters
    ----------
    run : Path, str or RunFolder
        With depth maps.
    camera : str, optional
        Its name; needed if the run has several.
    max_depth : float
        Pixels with a larger depth are not compared [m].

    Returns
    -------
    CameraError or None
        None where the camera agrees with the images, or they cannot tell: the run has no images,
        draws splats, or stands, or its maps are missing or out of date.
    """
    folder = RunFolder.open(run)
    try:
        found = edges_of_run(folder, camera, progress)
    except (CalibrationError, DatasetError, RunError):
        return None
    if not found.enough:
        return None
    try:
        check = compare(found)
    except CalibrationError as error:
        return CameraError(str(error), math.nan, math.nan)
    if check.agrees:
        return None
    name = folder.depth_folder(camera)
    files = list(maps_in(folder.path / "depth" / name).values())
    change = check.fit.of_points(np.mean(found.motions, axis=0))
    maps = (read_depth(files[k]) for k in evenly(len(files), IMAGES))
    mae, wrong = difference(maps, found.stream.camera, change, max_depth)
    return CameraError(check.verdict, mae, wrong)


@dataclass(frozen=True)
class FittedCamera:
    """What the images of a run say of a camera, and the camera by them.

    Attributes
    ----------
    fit : CameraFit, optional
        With fits without each eighth of the drive; None where these cannot tell.
    stream : CameraStream
        The camera as the images want it; as the run has it where that is not sure.
    """

    check: CalibrationCheck
    fit: CameraFit | None
    stream: CameraStream

    @property
    def is_changed(self) -> bool:
        """Whether the images surely want another camera."""
        return self.fit is not None and self.fit.is_sure

    @property
    def lines(self) -> list[str]:
        """What was found, in words."""
        if self.fit is None:
            said = (
                f"a fit needs ten images or more, and along less than {LEAST_PATH:g} m a clear pan"
            )
        else:
            moved = f"edges move by {self.fit.moved_deg:.2f} +- {self.fit.error_deg:.2f} degrees"
            sure = f"{moved} when {self.fit.change}; each eighth of the drive confirms the others"
            said = sure if self.is_changed else f"{moved} by a fit: nothing to change that is sure"
        return [*self.check.lines, said]

    @property
    def figures(self) -> dict[str, object]:
        """The result as plain values."""
        fit = None if self.fit is None else {
            "is_sure": self.fit.is_sure,
            "moved_deg": self.fit.moved_deg,
            "error_deg": self.fit.error_deg,
        }  # fmt: skip
        return self.check.figures | {"fit": fit}


def fit_calibration(
    run: Path | str | RunFolder,
    camera: str | None = None,
    progress: Progress = null_progress,
) -> FittedCamera:
    """Compare depth edges of a run with the edges of its images, and fit the camera to them.

    Edges in boxes of moving objects do not count.

    Parameters
    ----------
    run : Path, str or RunFolder
        With depth maps, and images in its recording.
    camera : str, optional
        Its name; needed if the run has several.
    """
    found = edges_of_run(run, camera, progress, FITTED_IMAGES)
    check, stream = compare(found), found.stream
    trajectory = RunFolder.open(run).trajectory()
    times = stream.times[np.isin(stream.names, found.names)]
    fit = fit_camera(found, float(np.ptp(trajectory.arc_length_at(times))))
    if fit is not None and fit.is_sure:
        stream = fitted(stream, stored_fit(fit, applied=True))
    return FittedCamera(check, fit, stream)


def edges_of_run(
    run: Path | str | RunFolder,
    camera: str | None,
    progress: Progress,
    most: int = IMAGES,
) -> RunEdges:
    """Read what :func:`fit_calibration` compares; its parameters and errors."""
    folder = RunFolder.open(run)
    if folder.parameters.render.primitive == "splats":
        raise CalibrationError(
            f"{folder.path} draws splats, which reach over the edges of things; compare a run with "
            "render.primitive=triangles, as preset default has"
        )
    stream, maps = images_and_maps(folder, camera, "compare depth with")
    indices = [k for k, image in enumerate(stream.names) if image in maps]
    return edges_of_images(
        folder.path, stream, indices, lambda k: read_depth(maps[stream.names[k]]),
        folder.trajectory(), tracks_in(folder.path), progress, most,
    )  # fmt: skip


def images_and_maps(
    folder: RunFolder, camera: str | None, purpose: str
) -> tuple[CameraStream, dict[str, Path]]:
    """A camera of a run with its images, and its depth maps by name."""
    name = folder.depth_folder(camera)
    require(folder, f"render {folder.camera_in(name)}")
    stream = recorded_camera(folder, name)
    if stream is None or not stream.images:
        raise DatasetError(f"{folder.path}: its recording has no images to {purpose}")
    return stream, maps_in(folder.path / "depth" / name)


def difference(
    maps: Iterable[NDArray[np.float32]],
    camera: Camera,
    change: NDArray[np.float64],
    max_depth: float = 80.0,
) -> tuple[float, float]:
    """Difference of depth maps before and after a change of their camera.

    Parameters
    ----------
    maps : iterable of ndarray of float32, shape (h, w)
        Metres along the optical axis; NaN without depth.
    change : ndarray of float64, shape (6,)
        Of points in the camera's frame: turn about its axes x, y, z [rad], then shift [m].
    max_depth : float
        [m]

    Returns
    -------
    mae, wrong : float
        Metres, and percent of pixels that differ by more than 5 %, over those that have both. What
        the maps hide, and a camera elsewhere would see, is not counted.
    """
    total, wrong, count = 0.0, 0, 0
    for depth in maps:
        right = changed(depth, camera, change)
        both = np.isfinite(depth) & np.isfinite(right) & (right <= max_depth)
        off = np.abs(depth[both] - right[both]).astype(np.float64)
        total += off.sum()
        wrong += int((off > RELATIVE_ERROR * right[both]).sum())
        count += len(off)
    return (total / count, 100 * wrong / count) if count else (math.nan, math.nan)


def changed(
    depth: NDArray[np.float32], camera: Camera, change: NDArray[np.float64]
) -> NDArray[np.float32]:
    """A depth map whose points are moved, each drawn into one pixel; the nearest one shows."""
    v, u = np.nonzero(np.isfinite(depth))
    points = depth[v, u] * (np.linalg.inv(camera.K) @ np.array([u, v, np.ones(len(u))]))
    moved = transform_points(rigid(rotation_exp(change[:3]), change[3:]), points.T)
    rows, u, v = pixels_in_image(moved, camera)
    result = np.full(depth.shape, np.inf, np.float32)
    np.minimum.at(result, (v, u), moved[rows, 2].astype(np.float32))
    return np.where(np.isinf(result), np.float32(np.nan), result)
