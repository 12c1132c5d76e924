"""Memory and disk that a run needs by estimate, and whether they are there."""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docdepth.config import Parameters
from docdepth.datasets import CameraStream
from docdepth.errors import CalibrationError, Finding, collected
from docdepth.pipeline.memory import BASE, PER_PIXEL, memory_of_run

_FRAME_BYTES = 29  # of a point in frames/*.ply
_PICTURE_BYTES = 0.3  # of a pixel in report/*.jpg
_LAYER_BYTES = 4.0  # of a pixel of a layer
_FORMAT_BYTES = {"png": 1.2, "exr": 2.5, "exr-half": 1.5, "tiff": 3.5, "npz": 3.0, "npy": 4.0}
_CGROUP = Path("/sys/fs/cgroup")


@dataclass(frozen=True)
class Estimate:
    """What a run needs, in bytes.

    Attributes
    ----------
    memory, disk : int
    """

    memory: int
    disk: int


def estimate(
    points: NDArray[np.int64],
    sweeps: int,
    cameras: Sequence[CameraStream],
    parameters: Parameters,
    jobs: int = 1,
) -> Estimate:
    """Estimate memory and disk.

    Parameters
    ----------
    points : ndarray of int64, shape (n,)
        Of some sweeps.
    sweeps : int
        All.
    cameras : sequence of CameraStream
    parameters : Parameters
    jobs : int
        Processes that share the work.
    """
    output = parameters.output
    pixel = sum(_FORMAT_BYTES.get(format, 4.0) for format in output.format) + _PICTURE_BYTES
    pixel += _LAYER_BYTES * len(output.layers)
    sizes = [camera.camera.width * camera.camera.height for camera in cameras]
    images = sum(size * len(c.times) for size, c in zip(sizes, cameras, strict=True))
    memory = memory_of_run(int(points.max()), sweeps, cameras, parameters, jobs)
    return Estimate(memory, int(_FRAME_BYTES * sweeps * np.median(points) + pixel * images))


def check_resources(
    needed: Estimate, cameras: Sequence[CameraStream], output: Path | None
) -> list[Finding]:
    """Compare an estimate with what the machine has."""
    found: list[Finding] = []
    for stream in cameras:
        with collected(found):
            check_image_size(stream.camera.width, stream.camera.height, stream.name)
    memory = available_memory()
    if not found and memory is not None and needed.memory > memory:
        text = (
            f"the run needs {gigabytes(needed.memory)} of memory for these sweeps and images by "
            f"estimate, {gigabytes(memory)} are free"
        )
        remedy = "give `memory` or fewer `jobs`, or end other programs"
        found.append(Finding("memory", "", text, remedy, "error"))
    if output is None:
        return found
    existing = next(p for p in [output.absolute(), *output.absolute().parents] if p.is_dir())
    free = shutil.disk_usage(existing).free + _used(output)
    if needed.disk > free:
        text = (
            f"the run writes {gigabytes(needed.disk)} by estimate, {gigabytes(free)} are free there"
        )
        found.append(Finding("disk", str(output), text, "make room or name another disk", "error"))
    return found


def check_image_size(width: int, height: int, name: str = "the image") -> None:
    """Refuse images that cannot be held in memory, also of virtual cameras.

    Raises
    ------
    CalibrationError
        An image of this size needs more memory than there is.
    """
    needed, memory = int(BASE) + PER_PIXEL * width * height, available_memory()
    if memory is not None and needed > memory:
        raise CalibrationError(
            f"{name}: {width} x {height} pixels need {gigabytes(needed)} of memory by estimate, "
            f"{gigabytes(memory)} are free",
            "give a smaller image size",
            code="memory",
        )


def available_memory() -> int | None:
    """Bytes of memory that a program can still take; None if the system does not tell."""
    free = [_free_of_machine(), _free_of_group()]
    return min((value for value in free if value is not None), default=None)


def _free_of_machine() -> int | None:
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return 1024 * int(line.split()[1])
    except (OSError, ValueError, IndexError):
        pass
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (ValueError, OSError, AttributeError):
        return None


def _free_of_group() -> int | None:
    """Of a container: its limit less what it holds and cannot give back."""
    try:
        limit = int((_CGROUP / "memory.max").read_text())
        used = int((_CGROUP / "memory.current").read_text())
        rows = (line.split() for line in (_CGROUP / "memory.stat").read_text().splitlines())
        cached = sum(int(value) for key, value in rows if key in ("active_file", "inactive_file"))
    except (OSError, ValueError):
        return None
    return max(0, limit - used + cached)


def _used(folder: Path) -> int:
    """Bytes that a run which goes on has written already."""
    total = 0
    for place, _, files in os.walk(folder):
        for file in files:
            try:
                total += os.lstat(os.path.join(place, file)).st_size
            except OSError:
                continue
    return total


def gigabytes(count: int) -> str:
    """A number of bytes as people read it."""
    return f"{count / 1e9:.1f} GB"
