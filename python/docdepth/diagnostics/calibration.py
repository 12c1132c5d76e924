"""Whether depth edges of a run lie on the edges of its images: does the calibration hold?"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from docdepth.concurrency import Progress, null_progress
from docdepth.datasets import CameraStream
from docdepth.diagnostics.alignment import in_words
from docdepth.diagnostics.depth_edges import Edges, edges_of_map, pixels_of_tracks, profiles
from docdepth.diagnostics.edge_fit import EdgeFit, ImageEdges, displaced, fit_edges
from docdepth.errors import CalibrationError, Finding
from docdepth.geometry.camera import View
from docdepth.geometry.points import evenly
from docdepth.geometry.se3 import inverse, rotation_log
from docdepth.geometry.track import Tracks
from docdepth.geometry.trajectory import Trajectory

Floats = NDArray[np.float64]

IMAGES = 20
"""Images that are compared, evenly chosen along the path."""

APART = 0.5
"""Path between two of them [m]. Seen from one place, the upper edge of a thing lies at its last
beam, too low in every image alike; from places apart other beams meet it."""

OFF = np.array([*np.radians([0.1] * 3), *[0.02] * 3, 0.005])
"""Turn [rad] and shift [m] above which a calibration is wrong, which checkerboards reach; and time
[s]."""

_AROUND = 50_000_000  # ns before and after an image between which its motion is taken
_DEVIATIONS = 2.0  # by which it must lie above
_FEWEST_IMAGES = 5
_FEWEST_EDGES = 1000  # in all images
_LEAST_SCORE = 1.2  # right ones reach 1.4 to 2.2, another drive's images 1.0 to 1.1
_GIVEN_COLOR, _FITTED_COLOR = (60, 60, 255), (90, 255, 90)  # BGR: red, green


@dataclass(frozen=True)
class CalibrationCheck:
    """What depth edges and image edges of a run say about the calibration."""

    fit: EdgeFit
    # edges, images: how many were compared
    edges: int
    images: int
    worst: str  # name of the image that gains most from the fit
    # (h, w, 3): that image, BGR: depth edges where they are (red) and where the fit has them
    # (green)
    picture: NDArray[np.uint8]

    @property
    def agrees(self) -> bool:
        """Whether the calibration agrees with the images."""
        surely = np.abs(self.fit.change) - _DEVIATIONS * self.fit.deviations
        return bool((surely < OFF).all())

    @property
    def verdict(self) -> str:
        """The result in words."""
        most = np.abs(self.fit.change) + _DEVIATIONS * self.fit.deviations
        if self.agrees:
            return (
                "the calibration agrees with the images: it is off by less than "
                f"{np.degrees(most[:3].max()):.2f} degrees, {100 * most[3:6].max():.0f} cm and "
                f"{1000 * most[6]:.0f} ms"
            )
        return f"the calibration is off: depth edges fit the images when {clear_change(self.fit)}"

    @property
    def lines(self) -> list[str]:
        """The verdict and the figures behind it."""
        right, down = self.fit.pixels
        turn = _with_errors(self.fit.turn_deg, np.degrees(self.fit.deviations[:3]), 2)
        shift = _with_errors(100 * self.fit.shift_m, 100 * self.fit.deviations[3:6], 1)
        late = _with_errors(1e3 * self.fit.change[6:], 1e3 * self.fit.deviations[6:], 1)
        return [
            self.verdict,
            f"in the median image edges lie {abs(right):.1f} px "
            f"{'right' if right > 0 else 'left'} of depth edges and {abs(down):.1f} px "
            f"{'below' if down > 0 else 'above'} them",
            f"points would have to turn by {turn} degrees about the camera's axes x, y, z and move "
            f"by {shift} cm, and images be taken {late} ms later",
            f"{self.edges} edges in {self.images} images; contrast below them is "
            f"{self.fit.score:.2f} times that beside them",
        ]

    @property
    def figures(self) -> dict[str, object]:
        """The result as plain values."""
        fit = self.fit
        return {
            "agrees": self.agrees,
            "verdict": self.verdict,
            "pixels": fit.pixels.tolist(),
            "turn_deg": fit.turn_deg.tolist(),
            "turn_error_deg": np.degrees(fit.deviations[:3]).tolist(),
            "shift_m": fit.shift_m.tolist(),
            "shift_error_m": fit.deviations[3:6].tolist(),
            "time_ms": fit.time_ms,
            "time_error_ms": 1e3 * float(fit.deviations[6]),
            "half_beam_mrad": (1e3 * fit.half_beam).tolist(),
            "score": fit.score,
            "edges": self.edges,
            "images": self.images,
            "worst": self.worst,
        }


def compare(found: RunEdges) -> CalibrationCheck:
    """What depth edges and image edges say about the calibration."""
    stream = found.stream
    if not found.enough:
        raise CalibrationError(
            f"{found.path} has {len(found.edges)} images from places {APART} m apart, with "
            f"{found.count} depth edges of standing things; {_FEWEST_IMAGES} such images with "
            f"{_FEWEST_EDGES} edges are needed to judge a calibration",
            "take a drive that moves",
            code="few-edges",
        )
    fit = fit_edges(found.seen)
    if fit.score < _LEAST_SCORE:
        raise CalibrationError(
            f"depth edges of {found.path} fit the images of {stream.name} by chance only: the "
            "calibration is off by more than two degrees, the images are of another drive or "
            "time, or they are too dark or blurred to tell",
            code="by-chance",
        )
    worst = int(np.argmax(fit.gains))
    picture = _picture(found, worst, fit)
    return CalibrationCheck(fit, found.count, len(found.edges), found.names[worst], picture)


def check_camera_calibration(found: RunEdges) -> tuple[str | None, list[Finding]]:
    """The verdict in words, None where there are too few edges; and what is bad."""
    if not found.enough:
        return None, []
    try:
        result = compare(found)
    except CalibrationError as error:
        return error.text, [Finding(error.code, "", error.text, error.remedy)]
    name, verdict = found.stream.name, result.verdict
    return verdict, [] if result.agrees else [Finding("calibration-off", name, verdict)]


@dataclass(frozen=True)
class RunEdges:
    """Images of a run, evenly chosen, and their depth edges.

    Attributes
    ----------
    path : Path
        Of the run.
    names : list of str
        Of the images.
    images : list of ndarray of uint8, shape (h, w, 3)
        BGR, rectified.
    edges : list of Edges
        Of standing things.
    motions : list of ndarray of float64, shape (6,)
        Turn and shift of standing points in the camera's frame in a second [rad, m].
    """

    path: Path
    stream: CameraStream
    names: list[str]
    images: list[NDArray[np.uint8]]
    edges: list[Edges]
    motions: list[Floats]

    @cached_property
    def seen(self) -> ImageEdges:
        """The edges, and what the images show there."""
        camera = self.stream.camera
        pairs = zip(self.edges, self.images, strict=True)
        samples = [profiles(edges, image, camera) for edges, image in pairs]
        return ImageEdges(camera, self.edges, samples, self.motions)

    def with_each(self, step: int) -> RunEdges:
        """With each ``step``-th edge of each image."""
        return replace(self, edges=[one.rows(np.arange(0, len(one), step)) for one in self.edges])

    @property
    def count(self) -> int:
        return sum(len(one) for one in self.edges)

    @property
    def enough(self) -> bool:
        """Whether they can tell of a calibration."""
        return len(self.edges) >= _FEWEST_IMAGES and self.count >= _FEWEST_EDGES


def edges_of_images(
    run: Path,
    stream: CameraStream,
    indices: Sequence[int],
    depth: Callable[[int], NDArray[np.float32]],
    trajectory: Trajectory,
    tracks: Tracks,
    progress: Progress = null_progress,
    most: int = IMAGES,
) -> RunEdges:
    """Depth edges of some images, evenly along the path.

    Parameters
    ----------
    stream : CameraStream
        With images.
    indices : sequence of int
        Images that have a depth map, by time.
    depth : callable
        Depth map of an image by its index, float32 of shape (h, w) [m].
    """
    times = stream.times[list(indices)]
    poses = trajectory.interpolate(times)
    apart = Trajectory(times, poses).subsample(APART)
    chosen = [int(apart[k]) for k in evenly(len(apart), most)]
    images, edges, motions = [], [], []
    for done, k in enumerate(chosen, 1):
        image = stream.rectified_image(indices[k])
        assert image is not None
        view = View(stream.camera, stream.T_camera_lidar @ inverse(poses[k]), int(times[k]))
        moving = pixels_of_tracks(tracks, view)
        images.append(image)
        edges.append(edges_of_map(depth(indices[k]), moving, float(stream.camera.K[1, 1])))
        motions.append(_motion(trajectory, int(times[k]), stream))
        progress("camera", done, len(chosen))
    return RunEdges(run, stream, [stream.names[indices[k]] for k in chosen], images, edges, motions)


def _motion(trajectory: Trajectory, time: int, stream: CameraStream) -> Floats:
    """Turn and shift of standing points in the camera's frame in a second [rad, m], (6,)."""
    ends = np.clip([time - _AROUND, time + _AROUND], *trajectory.times[[0, -1]])
    before, after = trajectory.interpolate(ends) @ inverse(stream.T_camera_lidar)
    moved = inverse(after) @ before
    seconds = 1e-9 * max(int(ends[1] - ends[0]), 1)  # of a single pose, which stays
    result: Floats = np.concatenate([rotation_log(moved[:3, :3]), moved[:3, 3]]) / seconds
    return result


def _with_errors(values: Floats, errors: Floats, digits: int) -> str:
    pairs = zip(values, errors, strict=True)
    return ", ".join(f"{value:.{digits}f} +- {error:.{digits}f}" for value, error in pairs)


def clear_change(fit: EdgeFit) -> str:
    """The parts of a change that stand out of their errors, in words."""
    return change_in_words(fit, np.abs(fit.change) > _DEVIATIONS * fit.deviations)


def change_in_words(fit: EdgeFit, parts: NDArray[np.bool_]) -> str:
    """Some parts (7,) of a change in words."""
    change = np.where(parts, [*fit.turn_deg, *fit.shift_m, fit.time_ms], 0.0)
    tilt, pan, roll, x, y, z = (round(float(part), 2) for part in change[:6])
    place = tilt, pan, roll, x, y, z
    found = [in_words(place)] if any(place) else []
    if round(change[6], 1):
        when = "later" if change[6] > 0 else "earlier"
        found.append(f"images are taken {abs(change[6]):.1f} ms {when}")
    return " and ".join(found)


def _picture(found: RunEdges, k: int, fit: EdgeFit) -> NDArray[np.uint8]:
    grey = cv2.cvtColor(cv2.cvtColor(found.images[k], cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
    picture, edges = np.asarray(grey, np.uint8), found.edges[k]
    moved = displaced(edges, fit.of_points(found.motions[k]), found.stream.camera)
    for places, color in ((edges.pixels, _GIVEN_COLOR), (moved, _FITTED_COLOR)):
        for u, v in np.rint(places).astype(int).tolist():
            cv2.circle(picture, (u, v), 1, color, -1)
    return picture
