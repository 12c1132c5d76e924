"""A synthetic drive, its depth maps, pictures, and how true they are."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from docdepth.config import Preset, parameters
from docdepth.datasets import open_dataset
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline import run_classify, run_odometry, run_render
from docdepth.synthetic import write_drive

Progress = Callable[[str, int, int], None]


def demo(
    folder: Path,
    preset: Preset = "default",
    frames: int = 40,
    threads: int = 0,
    progress: Progress | None = None,
) -> tuple[Path, Path]:
    """Make ``folder/drive`` and run every stage on it into ``folder/run``.

    Returns
    -------
    (Path, Path)
        The sequence folder of the drive and the run folder.
    """

    def tell(done: int, total: int) -> None:
        if progress:
            progress("synth", done, total)

    sequence = folder / "drive" / "sequences" / "00"
    if not (sequence / "docdepth.yaml").is_file():
        write_drive(folder / "drive", scene="city", frames=frames, seed=0, progress=tell)
    dataset = open_dataset(sequence)
    source: dict[str, Any] = {
        "dataset": str(sequence.resolve()),
        "name": None,
        "camera": "image_2",
        "poses": None,
        "camera_times": None,
        "image_size": None,
    }
    run = RunFolder.create(folder / "run", source, parameters(preset))
    run_odometry(run, dataset, progress=progress, threads=threads)
    run_classify(run, threads, progress)
    run_render(run, dataset.cameras["image_2"], threads, progress)
    return sequence, run.path
