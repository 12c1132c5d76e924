"""Depth maps in the layout of KITTI's release: ``DRIVE/proj_depth/groundtruth/CAMERA/NAME.png``."""

from __future__ import annotations

from pathlib import Path

from docdepth.concurrency import Progress
from docdepth.errors import ConfigError, DatasetError
from docdepth.io.depth import PNG_SCALE, maps_in, read_depth, write_depth
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline.plan import require

DEPTH_FORMATS = ("proj_depth",)
"""Layouts of depth maps that :func:`~.convert.convert` writes."""

INSIDE = Path("proj_depth") / "groundtruth"
"""Where in a drive KITTI keeps its depth maps, a folder a camera."""


def write_release(run: RunFolder, output: Path, progress: Progress | None = None) -> int:
    """Write the depth maps of all recorded cameras of a run as KITTI releases them.

    PNG of 16 bits, metres x 256, 0 where there is no depth.

    Parameters
    ----------
    run : RunFolder
        With depth maps that are up to date.
    output : Path
        Folder of the release; the drive is a folder in it and must not be there.
    progress : callable, optional
        Called with the step, the maps done and their number.

    Returns
    -------
    int
        Depth maps.

    Raises
    ------
    ConfigError
        The drive is in ``output``.
    DatasetError, InputError, RunError
        There are no depth maps, they are out of date, or too deep for such a PNG.
    """
    name = (run.recording_path or run.path).absolute().name
    drive = output / name
    if drive.exists():
        raise ConfigError(f"{drive} is there; name another folder, or remove it")
    recorded = {n: entry for n, entry in run.cameras.items() if entry.virtual is None}
    maps = []
    for camera, entry in recorded.items():
        require(run, f"render {camera}")
        found = maps_in(run.path / "depth" / entry.folder)
        maps += [(camera, image, path) for image, path in found.items()]
    if not maps:
        raise DatasetError(
            f"{run.path} has no depth maps", f"make them: `docdepth.run(..., {str(run.path)!r})`"
        )
    for done, (camera, image, path) in enumerate(maps, 1):
        write_depth(drive / INSIDE / camera / f"{image}.png", read_depth(path), "png", PNG_SCALE)
        if progress:
            progress("convert", done, len(maps))
    return len(maps)
