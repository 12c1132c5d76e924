"""Cameras fitted to their images, once the maps of a run are drawn."""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from docdepth.concurrency import Progress, null_progress
from docdepth.datasets.base import CameraStream, Dataset
from docdepth.diagnostics.calibration import RunEdges, change_in_words, edges_of_images
from docdepth.diagnostics.edge_fit import EdgeFit, ImageEdges, fit_edges
from docdepth.errors import Finding, log_findings
from docdepth.io.depth import maps_in, read_depth
from docdepth.io.manifest import StoredCameraFit
from docdepth.io.run_folder import RunFolder, stage_key
from docdepth.io.tracks import tracks_in
from docdepth.pipeline.cameras import open_cameras
from docdepth.pipeline.render import report

log = logging.getLogger(__name__)

_VERSION = 9  # counted up when the same images ask for another change
FITTED_IMAGES = 40
"""Images to which a camera is fitted, evenly along the path."""


def cameras_to_fit(run: RunFolder, recording: Dataset) -> list[CameraStream]:
    """Cameras as they were given that have not been compared with their images yet.

    A fit of another calibration, or of another ``camera_fit``, is taken back.
    """
    found = []
    names = [name for name, entry in run.cameras.items() if entry.virtual is None]
    for stream in open_cameras(run.inputs, recording, names) if names else []:
        entry = run.cameras[stream.name]
        if entry.fit is not None and entry.fit.made_of != _made_of(run, stream):
            entry = run.cameras[stream.name] = entry.model_copy(update={"fit": None})
        asks = run.inputs.camera_fit != "off" and run.parameters.render.primitive != "splats"
        if asks and stream.images and entry.fit is None:
            found.append(stream)
    return found


def fit_cameras(run: RunFolder, recording: Dataset, progress: Progress = null_progress) -> bool:
    """Fit cameras to their images by the depth maps of the run; run.yaml keeps the result.

    Returns
    -------
    bool
        Whether a camera was changed, so that its maps have to be drawn again.
    """
    apply, verdicts = run.inputs.camera_fit == "apply", []
    streams = cameras_to_fit(run, recording)
    for stream in streams:
        found = _fit(run, stream, progress)
        stored = StoredCameraFit(made_of=_made_of(run, stream))
        if found is not None and found.is_sure:
            finding = _finding(stream.name, found, apply)
            verdicts.append(finding)
            stored = stored_fit(found, apply, stored.made_of, finding.text)
        run.cameras[stream.name] = run.cameras[stream.name].model_copy(update={"fit": stored})
    log_findings(log, verdicts)
    if streams:
        run.save()
    if verdicts and not apply:
        report(run)
    return bool(verdicts) and apply


def _made_of(run: RunFolder, stream: CameraStream) -> str:
    given = stream.T_camera_lidar.tolist(), stream.times.tolist(), stream.camera.as_dict()
    return stage_key(_VERSION, run.inputs.camera_fit, *given)


def _finding(name: str, found: CameraFit, apply: bool) -> Finding:
    drawn = "drawn again with this change" if apply else "drawn without it"
    return Finding(
        "camera-fit",
        name,
        f"depth edges lie {found.moved_deg:.2f} +- {found.error_deg:.2f} degrees beside those of "
        f"the images; they fit when {found.change}. Images of each eighth of the drive confirm "
        f"what the others ask for, in the mean; maps are {drawn}",
        "`camera_fit='report'` draws with calibration and times as they are given" if apply else "",
        "note",
    )


def stored_fit(
    found: CameraFit, applied: bool, made_of: str = "", verdict: str = ""
) -> StoredCameraFit:
    """A fit as run.yaml holds it."""
    fit = found.fit
    tilt, pan, roll = fit.turn_deg.tolist()
    x, y, z = fit.shift_m.tolist()
    return StoredCameraFit(
        made_of=made_of,
        verdict=verdict,
        applied=applied,
        turn_deg=(tilt, pan, roll),
        shift_m=(x, y, z),
        time_ms=fit.time_ms,
    )


def _fit(run: RunFolder, stream: CameraStream, progress: Progress) -> CameraFit | None:
    maps = maps_in(run.path / "depth" / run.cameras[stream.name].folder)
    drawn = [k for k, name in enumerate(stream.names) if name in maps]
    trajectory = run.trajectory()
    if not drawn:
        return None
    path = float(np.ptp(trajectory.arc_length_at(stream.times[drawn])))
    found = edges_of_images(
        run.path, stream, drawn, lambda k: read_depth(maps[stream.names[k]]),
        trajectory, tracks_in(run.path), progress, FITTED_IMAGES,
    )  # fmt: skip
    return fit_camera(found, path)


Floats = NDArray[np.float64]

LEAST_PATH = 60.0
"""Path along which the images were taken [m]. The parts of a shorter drive see the same street, and
have agreed on a roll of 0.6 degrees that was wrong: along it upper edges lie at the same beam in
all images. Left and right edges do not, so there a pan may be found."""

_FEWEST_IMAGES = 10
_LEAST_MOVED_DEG = 0.04  # half a pixel of most cameras; smaller changes are not applied
_PARTS = 8  # of the drive, each of which is left out once; of four the error is half chance
_EVERY = 4  # edges of an image that are used: next to each other they err alike
_TURN, _TURN_AND_TIME = np.arange(7) < 3, np.array([True] * 3 + [False] * 3 + [True])
_PAN = np.arange(7) == 1
_LEAST_PAN_DEG = 0.1  # along a short path; right cameras have seemed to be off by 0.07
_LEAST_SCORE = 1.2  # right ones reach 1.4 to 2.2, another drive's images 1.0 to 1.1
_ERRORS = 2.0  # standard errors by which the displacement exceeds zero
_LEAST_GAIN = 3.0  # standard errors by which the gain does
_MOST_ERROR_DEG = 0.1  # right ones reach 0.02 to 0.08; 0.3 and more where two changes fit alike


@dataclass(frozen=True)
class CameraFit:
    """A change of a camera by its images, and whether it is sure."""

    fit: EdgeFit  # by all images
    moved_deg: float  # by how much it moves depth edges, RMS
    # standard error of that: by how much fits without a part of the drive differ (jackknife)
    error_deg: float
    # mean growth of the score of an image by the fit without its part, in standard errors
    gain: float

    @property
    def is_sure(self) -> bool:
        """Whether edges surely move, and onto edges of images that the fit has not seen."""
        return (
            self.moved_deg > max(_LEAST_MOVED_DEG, _ERRORS * self.error_deg)
            and self.error_deg < _MOST_ERROR_DEG
            and self.gain > _LEAST_GAIN
            and self.fit.score > _LEAST_SCORE
        )

    @property
    def change(self) -> str:
        """The whole change in words."""
        return change_in_words(self.fit, np.ones(7, np.bool_))


def fit_camera(found: RunEdges, path: float = np.inf) -> CameraFit | None:
    """Fit a camera to the images of a run, and again without each eighth of the drive.

    Turn, place and time are fitted together. Seen from a few metres a turn looks like a shift, so
    each part by itself is less sure than where the edges lie. Along a short path [m] only a pan is
    fitted. None where images are too few, or a clear pan is not what they ask for.
    """
    if not found.enough or len(found.edges) < _FEWEST_IMAGES:
        return None
    every, images = found.with_each(_EVERY).seen, np.arange(len(found.edges))
    if path >= LEAST_PATH:
        free, whole = None, fit_edges(every, near=fit_edges(every, _TURN_AND_TIME))
    else:
        free, whole = _PAN, fit_edges(every, _PAN)
        if not _explains(every, whole.change, fit_edges(every, _TURN).change):
            return None
    gains, changes = [], []
    for part in np.array_split(images, _PARTS):
        rest, own = every.some(np.setdiff1d(images, part)), every.some(part)
        if not any(map(len, rest.edges)) or not any(map(len, own.edges)):
            return None
        fit = fit_edges(rest, free, near=whole)
        gains.append(own.gains(fit))
        changes.append(fit.change)
    differ = [every.moved(change) for change in np.array(changes) - np.mean(changes, axis=0)]
    error = np.sqrt((_PARTS - 1) * np.mean(np.square(differ)))
    gain = np.concatenate(gains)
    return CameraFit(
        whole,
        _degrees(every, every.moved(whole.change)),
        _degrees(every, float(error)),
        float(gain.mean() / (gain.std(ddof=1) / np.sqrt(len(gain)) + 1e-9)),
    )


def _explains(every: ImageEdges, pan: Floats, asked: Floats) -> bool:
    """Whether a clear pan takes edges most of the way to the right or left that a turn asks for.

    Else it stands in for a roll. A shift and a time are not told from a pan along a short path.
    """
    to_right = np.concatenate(every.rows)[:, 0]
    left = np.sum((to_right @ (asked - pan)) ** 2)
    clear = _degrees(every, every.moved(pan)) > _LEAST_PAN_DEG
    return bool(clear and 2 * left < np.sum((to_right @ asked) ** 2))


def _degrees(every: ImageEdges, pixels: float) -> float:
    return pixels * float(np.degrees(1 / every.camera.K[0, 0]))
