"""A synthetic drive and its depth maps."""

from __future__ import annotations

from pathlib import Path

from docdepth.config import Preset, parameters
from docdepth.pipeline.run import run
from docdepth.pipeline.stage import Progress
from docdepth.synthetic import write_drive


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
    """

    def written(done: int, total: int) -> None:
        if progress:
            progress("synth", done, total)

    sequence = folder / "drive" / "sequences" / "00"
    if not (sequence / "docdepth.yaml").is_file():
        write_drive(folder / "drive", scene="city", frames=frames, seed=0, progress=written)
    values = parameters(preset)
    made = run(
        sequence, folder / "run", values, camera="image_2", threads=threads, progress=progress
    )
    return sequence, made.path
