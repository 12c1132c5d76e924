"""What images say of the cameras of a run, before its maps are drawn."""

from __future__ import annotations

import logging
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from docdepth.concurrency import Progress
from docdepth.datasets.base import CameraStream, Dataset
from docdepth.diagnostics.calibration import edges_of_images
from docdepth.diagnostics.camera_fit import FEWEST_IMAGES, CameraFit, fit_camera
from docdepth.errors import Finding, log_findings
from docdepth.geometry.camera import View
from docdepth.io.manifest import StoredCameraFit
from docdepth.io.run_folder import RunFolder, stage_key
from docdepth.io.tracks import tracks_in
from docdepth.pipeline.cameras import fitted, open_cameras
from docdepth.render.backends import Renderer
from docdepth.render.depth_map import compose_depth, render_list
from docdepth.render.render_sweep import RenderSweep, SweepCache, prepare_sweep
from docdepth.render.selection import needed_sweeps

log = logging.getLogger(__name__)

_VERSION = 2  # counted up when the same images ask for another change
_IMAGES = 40


def fit_cameras(
    run: RunFolder,
    recording: Dataset,
    threads: int,
    renderer: Renderer | None = None,
    progress: Progress | None = None,
) -> bool:
    """Fit cameras of a run, as they were given, to their images; run.yaml keeps what was found.

    Returns
    -------
    bool
        Whether a camera is another one now.
    """
    changed = False
    mode = run.inputs.camera_fit
    names = [name for name, entry in run.cameras.items() if entry.virtual is None]
    for stream in open_cameras(run.inputs, recording, names) if names else []:
        entry = run.cameras[stream.name]
        if mode == "off" or not stream.images or run.parameters.render.primitive == "splats":
            continue
        given = stream.T_camera_lidar.tolist(), stream.times.tolist(), stream.camera.as_dict()
        made_of = stage_key(_VERSION, run.stage("classify").key, mode, *given)
        if entry.fit is not None and entry.fit.made_of == made_of:
            continue
        found = _fit(run, stream, threads, renderer, progress)
        stored = StoredCameraFit(made_of=made_of)
        if found is not None and found.is_sure:
            finding = _finding(stream.name, found, mode == "apply")
            log_findings(log, [finding])
            stored = _stored(found, made_of, finding.text, mode == "apply")
        before = fitted(stream, entry.fit), fitted(stream, stored)
        changed |= not all(map(np.array_equal, *([s.T_camera_lidar, s.times] for s in before)))
        run.cameras[stream.name] = entry.model_copy(update={"fit": stored})
        run.save()
    return changed


def _finding(name: str, found: CameraFit, apply: bool) -> Finding:
    drawn = "with this change" if apply else "without it"
    return Finding(
        "camera-fit",
        name,
        f"depth edges lie {found.moved_deg:.2f} degrees beside those of the images; they fit when "
        f"{found.change}. Both halves of the drive ask for it; maps are drawn {drawn}",
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


def _fit(
    run: RunFolder,
    stream: CameraStream,
    threads: int,
    renderer: Renderer | None,
    progress: Progress | None,
) -> CameraFit | None:
    trajectory, tracks = run.trajectory(), tracks_in(run.path)
    covered = trajectory.covers(stream.times) & ~trajectory.in_gap(stream.times)
    inside = np.flatnonzero(covered).tolist()
    if len(inside) < FEWEST_IMAGES:
        return None
    depth = _maps(run, stream, threads, renderer)
    found = edges_of_images(
        run.path, stream, inside, depth, trajectory, tracks, progress, _IMAGES, FEWEST_IMAGES
    )
    return fit_camera(found)


def _maps(
    run: RunFolder, stream: CameraStream, threads: int, renderer: Renderer | None
) -> Callable[[int], NDArray[np.float32]]:
    """Draws the depth map of an image by its index."""
    trajectory, tracks, p = run.trajectory(), tracks_in(run.path), run.parameters.render

    def load(index: int, whole: bool) -> RenderSweep:
        frame, _ = run.classified_frame(index)
        return prepare_sweep(frame, index, trajectory, p, tracks, whole)

    cache = SweepCache(load)

    def depth(index: int) -> NDArray[np.float32]:
        time = int(stream.times[index])
        with ThreadPoolExecutor(2) as pool:
            needed = needed_sweeps(trajectory, time, p, tracks)
            sweeps = {i: s.result() for (i, _), s in cache.request(needed.items(), pool).items()}
        view = View.at(stream.camera, stream.T_camera_lidar, trajectory, time)
        drawn = render_list(view, trajectory, sweeps.__getitem__, p, tracks)
        return compose_depth(drawn, threads, renderer)

    return depth
