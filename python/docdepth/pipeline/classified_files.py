"""Files of the classes of a run, whoever has found them."""

from __future__ import annotations

from pathlib import Path

from docdepth.geometry.lidar_frame import LidarFrame
from docdepth.io.labels import write_labels
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline.stage import is_outdated

GROUND_FOLDER, TRACKING = "ground", "tracks"
"""Folders in the notes of a run. With them, single frames are classified again."""


def write_classified(
    run: RunFolder, index: int, classified: LidarFrame, of: dict[str, str]
) -> None:
    """Write labels of all rows of the input, and the frame with its classes.

    Parameters
    ----------
    run : RunFolder
    index : int
    classified : LidarFrame
    of : dict
        What classes are made of.
    """
    path = run.path / "labels" / f"{classified.name}.label"
    key = {**of, "frame": str(index)}
    if run.key(path) != key:
        write_labels(path, classified, run.writer(key))
    if of.items() <= run.frame_key(index).items():
        return  # only the labels were missing
    of_frame = {"odometry": run.recorded_key(run.frame_path(index)).get("odometry", "")}
    run.write_frame(index, classified, {**of_frame, **of})


def is_classified(run: RunFolder, index: int, labels: Path | None, of: dict[str, str]) -> bool:
    """Whether the frame and the label file of a sweep are whole and made of ``of``."""
    wanted = of.items()
    return (
        labels is not None
        and wanted <= run.key(labels).items()
        and wanted <= run.frame_key(index).items()
    )


def remove_outdated(run: RunFolder, ground_key: dict[str, str], key: dict[str, str]) -> None:
    """Delete what was kept of other parameters, and labels of sweeps that are no more."""
    for folder, made_of in (
        (run.notes / GROUND_FOLDER, ground_key),
        (run.notes / TRACKING, key),
        (run.path / "labels", key),
        (run.path, key),
    ):
        records = run.records(folder)
        for name in records.names():
            if is_outdated(records.recorded_key(name), made_of):
                run.remove(folder / name)
        records.compact()
