"""What trials are judged by: true labels, true depth maps, or sweeps that were left out."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from docdepth.errors import DatasetError
from docdepth.evaluation.depth import ERRORS
from docdepth.evaluation.held_out import evaluate_held_out
from docdepth.evaluation.label_counts import NOTE
from docdepth.evaluation.runs import evaluate_depth, evaluate_labels
from docdepth.io.run_folder import RunFolder
from docdepth.tuning.results import Column, Outcome, View


@dataclass(frozen=True)
class LabelJudge:
    """Compares the classes of points with true labels.

    Parameters
    ----------
    truth : Path
        SemanticKITTI labels, as for :func:`docdepth.evaluation.runs.evaluate_labels`.
    """

    truth: Path
    camera: ClassVar[None] = None
    needs_maps: ClassVar[bool] = False
    stages: ClassVar[tuple[str, ...]] = ("odometry", "ground", "dynamics")
    what: ClassVar[str] = "labels"

    @property
    def view(self) -> View:
        """How its results are shown."""
        return _LABELS

    def check(self, run: RunFolder) -> None:
        """Refuse a truth that is not there."""
        _files(self.truth, "labels")

    def made_of(self, run: RunFolder) -> list[Any]:
        """What its figures depend on, apart from the labels of the trial."""
        return ["labels", _files(self.truth, "labels")]

    def measure(self, trial: Path, threads: int) -> dict[str, Any]:
        """All metrics of a trial."""
        return evaluate_labels(trial, self.truth).as_dict()


@dataclass(frozen=True)
class DepthJudge:
    """Compares depth maps with true ones.

    Parameters
    ----------
    truth : Path
        Depth maps, as for :func:`docdepth.evaluation.runs.evaluate_depth`.
    camera : str, optional
        Needed where the run has several.
    """

    truth: Path
    camera: str | None = None
    needs_maps: ClassVar[bool] = True
    stages: ClassVar[tuple[str, ...]] = ("odometry", "ground", "dynamics", "render")
    what: ClassVar[str] = "depth"

    @property
    def view(self) -> View:
        """How its results are shown."""
        return _DEPTH

    def check(self, run: RunFolder) -> None:
        """Refuse a truth that is not there, and a run without this camera."""
        _files(self.truth, "depth_2")
        run.calibration(run.depth_folder(self.camera))

    def made_of(self, run: RunFolder) -> list[Any]:
        """What its figures depend on, apart from the sweeps and the parameters of the trial."""
        return ["depth", _files(self.truth, "depth_2"), _camera(run, self.camera)]

    def measure(self, trial: Path, threads: int) -> dict[str, Any]:
        """All metrics of a trial."""
        return evaluate_depth(trial, self.truth, camera=self.camera).as_dict()


@dataclass(frozen=True)
class HeldOutJudge:
    """Compares depth with sweeps that were left out; needs no truth.

    Parameters
    ----------
    every : int
        Leave out every n-th sweep, one at a time.
    camera : str, optional
        Needed where the run has several.
    """

    every: int = 10
    camera: str | None = None
    needs_maps: ClassVar[bool] = False
    stages: ClassVar[tuple[str, ...]] = DepthJudge.stages
    what: ClassVar[str] = "depth"

    @property
    def view(self) -> View:
        """How its results are shown."""
        return _HELD_OUT

    def check(self, run: RunFolder) -> None:
        """Refuse a run without this camera."""
        run.calibration(run.depth_folder(self.camera))

    def made_of(self, run: RunFolder) -> list[Any]:
        """What its figures depend on, apart from the sweeps and the parameters of the trial."""
        return ["held out", self.every, _camera(run, self.camera)]

    def measure(self, trial: Path, threads: int) -> dict[str, Any]:
        """All metrics of a trial."""
        result = evaluate_held_out(trial, self.every, camera=self.camera, threads=threads)
        return result.as_dict()


Judge = LabelJudge | DepthJudge | HeldOutJudge


def _files(folder: Path, inside: str) -> list[tuple[str, int, int]]:
    """Name, size and time of the files of a truth."""
    if not folder.is_dir():
        raise DatasetError(f"{folder} is {'not a folder' if folder.exists() else 'not there'}")
    truth = folder / inside if (folder / inside).is_dir() else folder
    with os.scandir(truth) as files:
        known = [(file.path, file.stat()) for file in files if file.is_file()]
    return sorted((os.path.abspath(path), s.st_size, s.st_mtime_ns) for path, s in known)


def _camera(run: RunFolder, camera: str | None) -> list[Any]:
    """Name, calibration and times of a camera."""
    name = run.camera_in(run.depth_folder(camera))
    return [name, run.cameras.get(name), run.made_of(f"render {name}").get("camera")]


def _metric(name: str, header: str, label: str, digits: int, key: str = "") -> Column:
    return Column(name, header, label, digits, lambda outcome: outcome.metric(key or name))


def _time(name: str, header: str, label: str, *steps: str) -> Column:
    """Milliseconds per sweep of the steps whose names begin so."""

    def value(outcome: Outcome) -> float:
        return outcome.time(lambda step: step.startswith(steps))

    return Column(name, header, label, 1, value, scale=1e3)


_LABELS = View(
    lambda m: f"{m.get('protocol')}; poses: {m.get('poses')}; {m.get('sweeps')} sweeps",
    NOTE,
    (
        _metric("sa", "SA %", "static accuracy SA [%]", 2),
        _metric("da", "DA %", "dynamic accuracy DA [%]", 2),
        _metric("f1", "F1", "F1", 4),
        _metric("precision", "precision", "precision", 4),
        _metric("iou", "IoU", "IoU of the dynamic class", 4),
        _time("ground_seconds", "ground ms", "ground [ms per sweep]", "ground"),
        _time("vote_seconds", "voting ms", "voting [ms per sweep]", "key frames", "vote"),
    ),
    ("sa", "da", "precision", "iou"),
    "metric, 0..1",
    (("da", "precision"), ("vote_seconds", "iou")),
)

_ERROR_COLUMNS = (
    _metric("density", "density %", "density [%]", 1, "all.density"),
    _metric("mae", "MAE m", "MAE [m]", 3, "all.mae"),
    _metric("rmse", "RMSE m", "RMSE [m]", 3, "all.rmse"),
    _metric("too_near", "too near %", "too near [%]", 2, "all.too_near"),
    _metric("too_far", "too far %", "too far [%]", 2, "all.too_far"),
)
_ERROR_PLOTS = (("density", "mae"), ("too_near", "too_far"))

_DEPTH = View(
    lambda m: f"depth: {m.get('protocol')}; poses: {m.get('poses')}; {m.get('images')} images",
    ERRORS,
    (_metric("pixels", "pixels", "pixels", 0, "all.pixels"), *_ERROR_COLUMNS),
    ("mae", "rmse"),
    "error [m]",
    _ERROR_PLOTS,
)

_HELD_OUT = View(
    lambda m: (
        f"depth against {m.get('sweeps')} held-out sweeps, returns up to "
        f"{m.get('max_range', 0):g} m"
    ),
    ERRORS.replace("these pixels that", "the returns whose pixels"),
    (_metric("returns", "returns", "returns", 0, "all.pixels"), *_ERROR_COLUMNS),
    ("mae", "rmse"),
    "error [m]",
    _ERROR_PLOTS,
)
