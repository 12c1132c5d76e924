"""A synthetic drive and its depth maps."""

from __future__ import annotations

from pathlib import Path

from docdepth.concurrency import Progress
from docdepth.config import Preset, parameters
from docdepth.errors import DatasetError
from docdepth.pipeline.run import run
from docdepth.synthetic import write_drive
from docdepth.synthetic.writer import described, sequence_folder, written_drive

_SCENE, _SENSOR = "city", "HDL-64"


def demo(
    folder: Path,
    preset: Preset = "default",
    frames: int = 40,
    threads: int = 0,
    progress: Progress | None = None,
) -> tuple[Path, Path]:
    """Write a drive to ``folder/drive`` and run every stage on it into ``folder/run``.

    Returns
    -------
    (Path, Path)
        The sequence folder of the drive and the run folder.

    Raises
    ------
    DatasetError
        The folder holds another drive.
    """

    sequence = sequence_folder(folder / "drive")
    about = written_drive(sequence)
    if about is not None and (about["scene"], about["seed"], about["frames"]) != (
        _SCENE,
        0,
        frames,
    ):
        raise DatasetError(
            f"{folder} holds the demo of another drive ({described(about)}), not of {frames} "
            "frames; choose another folder with -o, or delete this one"
        )
    if not (sequence / "docdepth.yaml").is_file():
        write_drive(folder / "drive", _SCENE, _SENSOR, frames, seed=0, progress=progress)
    values = parameters(preset)
    made = run(
        sequence, folder / "run", values, camera="image_2", threads=threads, progress=progress
    )
    return sequence, made.path
