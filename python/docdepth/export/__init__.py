"""A run in the layouts of other programs: one module a layout."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from docdepth.concurrency import Progress, null_progress
from docdepth.errors import ConfigError
from docdepth.export.colored_map import write_colored_map
from docdepth.export.mcap import write_mcap
from docdepth.export.occupancy import write_occupancy
from docdepth.export.posed_images import write_colmap, write_nerfstudio
from docdepth.io.atomic import new_output
from docdepth.pipeline.run_reader import Run, open_run

EXPORTS: dict[str, Callable[[Run, Path, Progress], int]] = {
    "nerfstudio": write_nerfstudio,
    "colmap": write_colmap,
    "mcap": write_mcap,
    "occupancy": write_occupancy,
    "map": write_colored_map,
}
"""What writes each layout; it returns how many images it has written, sweeps of occupancy, or
points of the map."""

_OF_FILES = (".mcap", ".json", ".ply", ".laz", ".npz", ".npy", ".bin", ".zip")
"""Suffixes that tell that a user expects a file."""


def export(
    run: Run | Path | str, output: Path | str, to: str, progress: Progress = null_progress
) -> int:
    """Write the photos, poses, depth, masks, points or occupancy of a run for another program.

    Parameters
    ----------
    output : Path
        A new folder.
    to : str
        One of :data:`EXPORTS`.

    Returns
    -------
    int
        Images, sweeps of occupancy, or points of the map.
    """
    output = Path(output)
    if to not in EXPORTS:
        raise ConfigError(f"unknown layout {to!r}; there are {', '.join(EXPORTS)}")
    if output.suffix in _OF_FILES and not output.is_dir():
        raise ConfigError(f"{to} is a folder of files; name it {output.with_suffix('')}")
    with new_output(output):
        return EXPORTS[to](run if isinstance(run, Run) else open_run(run), output, progress)
