"""Classes of another method in place of our own: ``--labels DIR``."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from docdepth.concurrency import Progress, null_progress
from docdepth.errors import DatasetError
from docdepth.geometry.points import DYNAMIC
from docdepth.io.frames import read_frame_name, read_input_points
from docdepth.io.run_folder import RunFolder
from docdepth.io.tracks import TRACKS
from docdepth.pipeline.label_folder import LabelFolder
from docdepth.pipeline.plan import classify_stage
from docdepth.pipeline.stage import Stage, remove_others
from docdepth.pipeline.sweep_store import TRACKING, write_classified

log = logging.getLogger(__name__)


def open_labels(run: RunFolder) -> LabelFolder:
    """The labels that a run was given.

    Raises
    ------
    DatasetError
        They are not there, or are those that the run itself has written.
    """
    labels = run.inputs.labels
    assert labels is not None
    given = LabelFolder(labels)
    if given.folder.resolve().is_relative_to(run.path.resolve()):
        raise DatasetError(
            f"{given.folder} lies in the run {run.path} itself; name a folder of other labels"
        )
    return given


def take_labels(
    run: RunFolder, progress: Progress | None = None, stage: Stage | None = None
) -> None:
    """Write the classes that a run was given into ``classes/`` and ``labels/``.

    Ground is not grown and key frames do not vote. Tracks are those of the run whose labels these
    are, if any.

    Parameters
    ----------
    run : RunFolder
        Its odometry is done, and its inputs name the labels.
    progress : callable, optional
    stage : Stage, optional
        :func:`~.plan.classify_stage` of the run.

    Raises
    ------
    DatasetError
        Labels of a sweep are missing, damaged, or of another number of points.
    RunError
        A file of the run is damaged.
    """
    with run.lock("classify"):
        trajectory, stage = run.trajectory(), stage or classify_stage(run)
        left, count, key = stage.left(), len(trajectory), stage.made_of
        if not left and stage.is_made_once():
            return
        report = progress or null_progress
        given = open_labels(run)
        _check(given, run, left)
        with stage.working() as profile:
            tracks = given.tracks(trajectory)
            profile.more |= {"labels": str(given.folder), "tracks": tracks is not None}
            if tracks is not None:
                content = tracks
                run.write(run.path / TRACKS, lambda stream: stream.write(content), key)
            something_moves = False
            for index in left:
                with profile.timer("read"):
                    classified = given.classified(run.deskewed(index), index)
                assert classified.classid is not None
                something_moves |= bool((classified.classid >= DYNAMIC).any())
                with profile.timer("write"):
                    write_classified(run, index, classified, key)
                profile.frames += 1
                report("classify", count - len(left) + profile.frames, count)
            if not something_moves and len(left) == count:
                log.warning(
                    "no point of %s is dynamic: what moves has the class 251 to 259 in .label "
                    "files, 100 and above in .npy files, or True, the intensity 1 in .pcd files",
                    given.folder,
                )  # fmt: skip
            stage.remove_outdated()
            remove_others(run, run.state_dir / TRACKING, key)


def _check(given: LabelFolder, run: RunFolder, frames: Sequence[int]) -> None:
    """Refuse labels that do not fit, before any class is written."""
    for frame in frames:
        path = run.frame_path(frame)
        points = read_input_points(path)
        given.check_count(read_frame_name(path), frame, points, partial(_returns, run, frame))


def _returns(run: RunFolder, frame: int) -> NDArray[np.uint32]:
    return run.deskewed(frame).index
