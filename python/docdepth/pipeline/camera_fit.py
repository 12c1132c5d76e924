"""What the images of a run say of its cameras, once its maps are drawn."""

from __future__ import annotations

import logging

import numpy as np

from docdepth.concurrency import Progress
from docdepth.datasets.base import CameraStream, Dataset
from docdepth.diagnostics.calibration import edges_of_images
from docdepth.diagnostics.camera_fit import LEAST_PATH, CameraFit, fit_camera
from docdepth.errors import Finding, log_findings
from docdepth.io.depth import maps_in, read_depth
from docdepth.io.manifest import StoredCameraFit
from docdepth.io.run_folder import RunFolder, stage_key
from docdepth.io.tracks import tracks_in
from docdepth.pipeline.cameras import open_cameras
from docdepth.pipeline.render import report

log = logging.getLogger(__name__)

_VERSION = 4  # counted up when the same images ask for another change
_IMAGES = 40


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


def fit_cameras(run: RunFolder, recording: Dataset, progress: Progress | None = None) -> bool:
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
            stored = _stored(found, stored.made_of, finding.text, apply)
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
        f"the images; they fit when {found.change}. Images of each quarter of the drive confirm "
        f"what the others ask for, in the mean; maps are {drawn}",
        "`camera_fit='report'` draws with calibration and times as they are given" if apply else "",
        "note",
    )


def _stored(found: CameraFit, made_of: str, verdict: str, apply: bool) -> StoredCameraFit:
    fit = found.fit
    tilt, pan, roll = fit.turn_deg.tolist()
    x, y, z = fit.shift_m.tolist()
    return StoredCameraFit(
        made_of=made_of,
        verdict=verdict,
        applied=apply,
        turn_deg=(tilt, pan, roll),
        shift_m=(x, y, z),
        time_ms=fit.time_ms,
    )


def _fit(run: RunFolder, stream: CameraStream, progress: Progress | None) -> CameraFit | None:
    maps = maps_in(run.path / "depth" / run.cameras[stream.name].folder)
    drawn = [k for k, name in enumerate(stream.names) if name in maps]
    trajectory = run.trajectory()
    if not drawn or np.ptp(trajectory.arc_length_at(stream.times[drawn])) < LEAST_PATH:
        return None
    found = edges_of_images(
        run.path, stream, drawn, lambda k: read_depth(maps[stream.names[k]]),
        trajectory, tracks_in(run.path), progress, _IMAGES,
    )  # fmt: skip
    return fit_camera(found)
