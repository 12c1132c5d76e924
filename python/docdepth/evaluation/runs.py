"""Metrics of a run folder against ground truth on disk."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docdepth.concurrency import Progress, null_progress
from docdepth.datasets import open_dataset
from docdepth.errors import DatasetError
from docdepth.evaluation.depth import DepthEvaluation, DepthResult, Mode
from docdepth.evaluation.depth_truth import DepthTruth, array_of
from docdepth.evaluation.label_counts import instances
from docdepth.evaluation.labels import LabelEvaluation, LabelResult
from docdepth.evaluation.track_overlaps import track_packages
from docdepth.evaluation.tracks import TrackEvaluation, TrackResult
from docdepth.geometry.points import DYNAMIC
from docdepth.geometry.track import Track
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.depth import maps_in, read_depth
from docdepth.io.labels import read_labels, read_truth
from docdepth.io.run_folder import RunFolder
from docdepth.io.tracks import read_tracks, tracks_in
from docdepth.pipeline.plan import require

log = logging.getLogger(__name__)

_OTHER_SCALE = 1.5
"""Factor between true and made depth, in the median, that no error of depth explains."""


Look = Callable[..., None]
"""Sees what is compared, for a page of errors."""


def evaluate_labels(
    run: Path | str | RunFolder,
    labels: Path,
    progress: Progress = null_progress,
    look: Look | None = None,
) -> LabelResult:
    """Compare the classes of a run with SemanticKITTI labels.

    Input points that the run dropped (no usable return) count as static and belong to no range.

    Parameters
    ----------
    run : Path, str or RunFolder
        Run folder with classified frames.
    labels : Path
        Folder of ``NAME.label`` files, or its parent with a folder ``labels``. A folder ``speeds``
        beside it (``NAME.npy``, speed of each point in m/s) separates standing from moving objects.
    look : callable, optional
        Called for each sweep as :meth:`docdepth.evaluation.error_page.LabelPage.look`.
    """
    folder = RunFolder.open(run)
    require(folder, "classify")
    labels = truth_folder(labels, "labels", folder)
    evaluation = LabelEvaluation(poses=_poses(folder))
    times = folder.trajectory().times
    for index in range(len(times)):
        record, classid = folder.classified_frame(index)
        truth = read_truth(labels / f"{record.name}.label", record.input_points, index)
        dynamic = np.zeros(record.input_points, dtype=bool)
        dynamic[record.index] = classid >= DYNAMIC
        ranges = np.full(record.input_points, np.nan)
        ranges[record.index] = np.linalg.norm(record.points, axis=1)
        evaluation.add(truth, dynamic, ranges, _speeds(labels, record.name), _seconds(times))
        if look:
            look(record.name, record.points, classid, truth[record.index])
        progress("labels", index + 1, len(times))
    result = evaluation.result()
    counts = result.with_standing or result.counts
    if not counts.static + counts.dynamic:
        raise DatasetError(
            f"{labels}: no point has a label: 0 is unlabelled and 1 an outlier in SemanticKITTI's "
            "numbering; write 9 for what stands still and 251 for what moves"
        )
    if not counts.dynamic:
        log.warning("%s: no point is of a class that moves, 251 to 259", labels)
    return result


def evaluate_tracks(
    run: Path | str | RunFolder,
    labels: Path,
    tracks: Path | Sequence[Track] | None = None,
    progress: Progress = null_progress,
) -> TrackResult:
    """Compare the instances and tracks of a run with true ones.

    Parameters
    ----------
    run : Path, str or RunFolder
        Run folder with classified frames.
    labels : Path
        Folder of ``NAME.label`` files with instances, or its parent with a folder ``labels``. A
        folder ``speeds`` beside it tells which objects travel, ``poses.txt`` the true poses.
    tracks : Path or sequence of Track, optional
        True tracks; ``tracks.csv`` beside the folder of labels if left out. Without such a file
        boxes are not compared.
    """
    folder = RunFolder.open(run)
    require(folder, "classify")
    track_packages()  # tells what to install before all sweeps are read
    labels = truth_folder(labels, "labels", folder)
    if tracks is None:
        tracks = list(tracks_in(labels.parent).values())
    true_tracks = read_tracks(tracks) if isinstance(tracks, Path) else tracks
    trajectory = folder.trajectory()
    truth = _true_trajectory(labels.parent) or trajectory
    own_tracks = list(tracks_in(folder.path).values())
    evaluation = TrackEvaluation(true_tracks, own_tracks, _poses(folder))
    for index, time in enumerate(trajectory.times.tolist()):
        record = folder.frame(index)
        name, points = f"{record.name}.label", record.input_points
        both = labels, folder.path / "labels"
        true, found = (read_labels(at / name, points, index) for at in both)
        pose = truth.interpolate(int(np.clip(time, truth.times[0], truth.times[-1])))[0]
        evaluation.add(
            *(true, instances(found), _speeds(labels, record.name), _seconds(trajectory.times)),
            time=time,
            T_true_lidar=pose,
            T_made_lidar=trajectory.poses[index],
        )
        progress("tracks", index + 1, len(trajectory))
    return evaluation.result()


def _true_trajectory(sequence: Path) -> Trajectory | None:
    """True poses of the sequence that holds the labels, if it has any."""
    if not (sequence / "poses.txt").is_file():
        return None
    dataset = open_dataset(sequence)
    return None if dataset.poses is None else Trajectory(dataset.times, dataset.poses)


def _speeds(labels: Path, name: str) -> NDArray[np.float32] | None:
    path = labels.parent / "speeds" / f"{name}.npy"
    return array_of(path).astype(np.float32) if path.is_file() else None


def _seconds(times: NDArray[np.int64]) -> float:
    """Time from sweep to sweep [s]."""
    return float(np.median(np.diff(times))) * 1e-9 if len(times) > 1 else 0.0


def evaluate_depth(
    run: Path | str | RunFolder,
    depth: Path,
    mode: Mode = "valid",
    max_range: float = 80.0,
    camera: str | None = None,
    progress: Progress = null_progress,
    look: Look | None = None,
    other: Path | None = None,
) -> DepthResult:
    """Compare the depth maps of a run with true depth maps of the same names.

    Parameters
    ----------
    run : Path, str or RunFolder
        Run folder with depth maps.
    depth : Path
        Folder of depth maps in any format, or its parent with a folder ``depth_2``. A folder
        ``class_2`` beside it marks the pixels of moving objects. Or a drive of KITTI's depth
        completion, with ``proj_depth/groundtruth``, or its ``val_selection_cropped``. Images
        without a true map are not compared, and counted in a warning.
    mode : {"valid", "kitti"}
        ``kitti`` fills empty pixels first, as KITTI's development kit does.
    max_range : float
        Pixels with a larger true depth are not compared [m].
    camera : str, optional
        Name of the camera; needed if the run has several.
    look : callable, optional
        Called for each image as :meth:`docdepth.evaluation.error_page.DepthPage.look`.
    other : Path, optional
        Another run, or a folder of the depth maps of another method, of the same names. Both are
        compared over the pixels that both fill.
    """
    folder = RunFolder.open(run)
    depth = truth_folder(depth, "depth_2", folder)
    camera = folder.depth_folder(camera)
    require(folder, f"render {folder.camera_in(camera)}")
    truth = DepthTruth(depth, folder, camera)
    others = None if other is None else _maps_of(other, camera)
    evaluation = DepthEvaluation(mode=mode, max_range=max_range, poses=_poses(folder))
    ratios: list[float] = []
    for done, name in enumerate(truth.maps, 1):
        made, true, K, part, dynamic, regions, classes, _ = truth.read(name)
        beside = None if others is None else _map_in(others, name, part)
        evaluation.add(made, true, dynamic, K, regions | classes, beside)
        if look:
            look(name, made, true)
        if (both := np.isfinite(made) & np.isfinite(true)).any():
            ratios.append(float(np.median(true[both] / made[both])))
        progress("depth", done, len(truth.maps))
    if not ratios:
        raise DatasetError(
            f"{truth.folder} and the depth of {run} have no pixel in common; is the truth of this "
            "camera?"
        )
    ratio = np.median(ratios)
    if not 1 / _OTHER_SCALE < ratio < _OTHER_SCALE:
        log.warning(
            "the depth in %s is %.3g times that of the run; depth is in metres, PNG in metres x "
            "256 unless a depth.json beside it tells another scale: is the scale another?",
            truth.folder, ratio,
        )  # fmt: skip
    return evaluation.result()


def _maps_of(other: Path, camera: str) -> dict[str, Path]:
    """Depth maps of another run, for the same camera, or of a folder."""
    folder = other / "depth" / camera if (other / "depth").is_dir() else other
    maps = maps_in(folder) if folder.is_dir() else {}
    if not maps:
        raise DatasetError(f"{folder} has no depth maps; name another run, or a folder of them")
    return maps


def _map_in(maps: dict[str, Path], name: str, part: tuple[slice, slice]) -> NDArray[np.float32]:
    if name not in maps:
        folder = next(iter(maps.values())).parent
        raise DatasetError(f"{folder} has no depth map {name}; both methods need the same images")
    depth = read_depth(maps[name])
    return depth if depth.shape == depth[part].shape else depth[part]


def truth_folder(path: Path, inside: str, run: RunFolder) -> Path:
    """The folder itself, or the one in it that holds the truth."""
    if path.resolve().is_relative_to(run.path.resolve()):
        raise DatasetError(
            f"{path} lies in the run {run.path} itself; name the folder of the truth"
        )
    if not path.is_dir():
        raise DatasetError(f"{path} is {'not a folder' if path.exists() else 'not there'}")
    return path / inside if (path / inside).is_dir() else path


def _poses(folder: RunFolder) -> str:
    inputs = folder.manifest.inputs
    return (None if inputs is None else inputs.poses) or "docdepth"
