"""Finds the format of a recording, by name or by its files, and opens it."""

from __future__ import annotations

import logging
import os
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Literal

from docdepth.datasets.base import Dataset
from docdepth.datasets.cloud_files import READERS
from docdepth.datasets.files import FILE, library_errors
from docdepth.datasets.format import ENTRY_POINTS, Format
from docdepth.datasets.formats import (
    argoverse2,
    boreas,
    cloud_folder,
    dgp,
    docdepth_run,
    helipr,
    kitti_360,
    kitti_odometry,
    kitti_raw,
    mulran,
    nclt,
    nuscenes,
    pandaset,
    waymo,
)
from docdepth.datasets.formats.bag import bag_recording
from docdepth.datasets.formats.pcap import hesai, ouster, velodyne
from docdepth.datasets.views import FrameRange
from docdepth.errors import DatasetError, raise_together

log = logging.getLogger(__name__)

_DEEPEST = 3  # levels below a folder that are searched: KITTI's ROOT/DATE/DRIVE, OUT/sequences/00
_TOOLS = {
    ".osf": "docdepth reads captures as pcap; write one by ouster-cli source IN save OUT.pcap",
    ".pcapng": "docdepth reads captures as pcap; write one by editcap -F pcap IN OUT",
    ".tfrecord": "docdepth reads Waymo's version 2, whose files are Parquet",
    ".active": "this bag was not closed; mend it by rosbag reindex, and call it NAME.bag",
}
"""What makes a recording that docdepth reads of another file, by its suffix."""

_PACKED = (".zip", ".tar", ".tgz", ".gz", ".bz2", ".xz", ".zst", ".zstd", ".lz4", ".7z", ".rar")
_MOST_NAMED = 8  # recordings in an error

# The first that recognises a path has it.
_OWN: tuple[Format, ...] = (
    kitti_raw.FORMAT,
    kitti_odometry.SEMANTIC_KITTI,
    kitti_odometry.KITTI_ODOMETRY,
    kitti_360.FORMAT,
    docdepth_run.FORMAT,
    nuscenes.FORMAT,
    argoverse2.FORMAT,
    dgp.FORMAT,
    waymo.FORMAT,
    helipr.FORMAT,
    mulran.FORMAT,
    nclt.FORMAT,
    boreas.FORMAT,
    pandaset.FORMAT,
    hesai.FORMAT,
    velodyne.FORMAT,
    ouster.FORMAT,
    bag_recording.FORMAT,
    cloud_folder.DYNAMIC_MAP,
    cloud_folder.FORMAT,
)


def format_names() -> tuple[str, ...]:
    """Names of all formats: docdepth's own, and those of installed packages."""
    return (*(known.name for known in _OWN), *sorted(_foreign()))


def open_dataset(
    path: Path | str,
    dataset: str | None = None,
    image_size: tuple[int, int] | None = None,
    frames: str | None = None,
    on_error: Literal["stop", "skip"] = "stop",
) -> Dataset:
    """Open a recording.

    Parameters
    ----------
    path : Path
        The folder or file of one recording, or a folder that holds a single one.
    dataset : str, optional
        Name of its format, as ``--dataset``: ``kitti_raw``, ``bag``, ``folder``; found by its files
        if left out.
    image_size : (int, int), optional
        Width and height of the images in pixels, if no file tells them.
    frames : str, optional
        ``A:B``, sweeps A to B - 1 alone; all if left out.
    on_error : {"stop", "skip"}
        Whether a recording is refused if sweeps are broken that are looked at to open it. Reading
        these fails in any case.

    Raises
    ------
    DatasetError
        There is no such path or format, the path is of no known format, or a file is missing or
        broken. All problems of a recording are told together.
    CalibrationError
        The calibration is missing or contradicts the images.
    """
    path = Path(path)
    wanted = None if dataset is None else _named(dataset.replace("-", "_"))
    try:
        place, found = _find_recording(path, wanted)
        with library_errors(f"{place} ({found.name})", "copy the recording again"):
            recording = found.open(place, image_size)
        if on_error == "stop":
            raise_together(getattr(recording, "broken", ()))
        if found.experimental:
            log.warning(
                "%s: the reader of %s is experimental: it was never tried on a real recording; "
                "compare what docdepth inspect says with the documents of the data set",
                place, found.name,
            )  # fmt: skip
    except OSError as error:
        raise DatasetError(
            f"{error.filename or path} cannot be read ({error.strerror}); "
            "check that it is there and that you may read it"
        ) from None
    return FrameRange(recording, frames) if frames else recording


def experimental_formats() -> tuple[str, ...]:
    """Names of docdepth's formats whose readers were never tried on a real recording."""
    return tuple(known.name for known in _OWN if known.experimental)


def find_recordings(root: Path, dataset: str | None = None) -> list[Path]:
    """Every recording below a folder, or the one that it is.

    Parameters
    ----------
    dataset : str, optional
        Of this format alone, by name.
    """
    formats = _all() if dataset is None else [_named(dataset.replace("-", "_"))]
    if not root.is_dir():
        raise DatasetError(f"{root} is no folder; name one with recordings below it")
    if any(known.recognises(root) for known in formats):
        return [root]
    return [place for place, _ in _recordings_below(root, _DEEPEST, formats)]


def _foreign() -> dict[str, EntryPoint]:
    """Formats of other packages by name; none takes a name of docdepth's own."""
    own = {known.name for known in _OWN}
    return {p.name: p for p in entry_points(group=ENTRY_POINTS) if p.name not in own}


def _load(point: EntryPoint) -> Format:
    """The format of another package."""
    try:
        found = point.load()
    except Exception as error:
        raise DatasetError(
            f"the loader {point.name} ({point.value}) cannot be imported: {error}; "
            "mend or remove the package that brings it"
        ) from error
    if not isinstance(found, Format) or found.name != point.name:
        raise DatasetError(
            f"the loader {point.name} ({point.value}) is no docdepth.datasets.Format of this name"
        )
    return found


def _named(name: str) -> Format:
    own, foreign = {known.name: known for known in _OWN}, _foreign()
    if name not in own | foreign:
        raise DatasetError(f"unknown dataset {name!r}; there are {', '.join(format_names())}")
    return own[name] if name in own else _load(foreign[name])


def _all() -> list[Format]:
    """All formats; those of other packages come first, since they know their files better."""
    formats = []
    for point in _foreign().values():
        try:
            formats.append(_load(point))
        except DatasetError as error:
            log.warning("%s", error)
    return [*formats, *_OWN]


def _find_recording(path: Path, wanted: Format | None) -> tuple[Path, Format]:
    """Where the recording is, and its format."""
    formats = _all() if wanted is None else [wanted]
    for known in formats:
        if known.recognises(path):
            return path, known
    if not path.exists():  # one that is recognised may be a part of the folder above
        raise DatasetError(f"{path} is not there")
    below = _recordings_below(path, _DEEPEST, formats) if path.is_dir() else []
    if len(below) == 1:
        return below[0]
    if below:
        names = ", ".join(str(folder) for folder, _ in below[:_MOST_NAMED])
        more = f" and {len(below) - _MOST_NAMED} more" if len(below) > _MOST_NAMED else ""
        raise DatasetError(f"{path} holds {len(below)} recordings; name one of {names}{more}")
    if wanted is not None:
        raise DatasetError(f"{path} is no recording of {wanted.name} ({wanted.expected})")
    packed = _packed(path)
    if packed:
        raise DatasetError(f"{packed} is packed; unpack it and name what comes out")
    if tool := _TOOLS.get(path.suffix.lower()):
        raise DatasetError(f"{path}: {tool}")
    for above in path.absolute().parents[:_DEEPEST]:
        wholes = [f for f in formats if f.found_below or path.is_file()]
        fitting = (f for f in wholes if os.access(above, os.R_OK) and f.recognises(above))
        if part := next(fitting, None):
            raise DatasetError(
                f"{path} is a part of a recording that docdepth reads ({part.name}); name {above}"
            )
    clouds = _clouds_below(path)
    if clouds:
        raise DatasetError(
            f"{clouds} holds point clouds, but no file describes the recording; write "
            f"{path / FILE} with sweeps: {clouds.relative_to(path)}"
        )
    names = ", ".join(known.name for known in formats)
    raise DatasetError(
        f"{path} is no recording that docdepth reads ({names})",
        "say by `dataset` which it should be, to be told what is missing",
    )


def _packed(path: Path) -> Path | None:
    """An archive or a compressed file: the path itself, or the first one in it."""
    inside = sorted(path.iterdir()) if path.is_dir() else [path]
    return next((file for file in inside if file.suffix.lower() in _PACKED), None)


def _clouds_below(path: Path) -> Path | None:
    """The first folder of point clouds: the path itself, or one in it."""
    places = [path, *sorted(path.iterdir())] if path.is_dir() else []
    for place in places:
        kinds = {file.suffix.lower() for file in place.iterdir()} if place.is_dir() else set()
        if kinds & (READERS.keys() - {".txt"}):
            return place
    return None


def _recordings_below(path: Path, levels: int, formats: list[Format]) -> list[tuple[Path, Format]]:
    """Recordings in the folders of a folder."""
    found: list[tuple[Path, Format]] = []
    if not levels or not os.access(path, os.R_OK | os.X_OK):
        return found
    for child in sorted(path.iterdir()):
        known = next((f for f in formats if f.recognises(child)), None)
        if known is None:
            found += _recordings_below(child, levels - 1, formats) if child.is_dir() else []
        elif known.found_below:
            found.append((child, known))
    return found
