"""How a run is carried out, and the memory and disk that it needs by estimate.

For memory the largest of three stages counts, each with what it holds at once: the key frames of a
window, the voxels of a chunk of ground, the sweeps of an image. None of them grows with the drive,
as benchmarks/endless.py measures.
"""

from __future__ import annotations

import math
import os
import re
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, ConfigDict, Field, model_validator

from docdepth.concurrency import MOST_THREADS, Progress
from docdepth.config import Parameters, replaced
from docdepth.datasets.base import CameraStream, Dataset
from docdepth.errors import CalibrationError, ConfigError, Finding, collect_findings
from docdepth.geometry.points import evenly, usable_points
from docdepth.ground.growing import CHUNK_OVERLAP
from docdepth.io.inputs import Checked
from docdepth.io.manifest import Keep
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline.parallel import WorkerPool
from docdepth.render.backends import Renderer

BASE = 100e6
"""Of the program [bytes]."""

_PER_SWEEP = 1e3
"""Records of files, poses and times of a sweep [bytes]."""

_VOTES, _VOTES_PER_POINT = 280e6, 2.1e3
"""Of the images of some 40 key frames, and of a point of a sweep [bytes]."""

_PER_VOXEL = 125.0
"""Of a voxel of the ground map while its ground grows [bytes]."""

_DENSE_SWEEP = 80_000
"""Points of a sweep half of which fall into voxels that other points have filled."""

_SWEEPS_A_METRE = 1.0
"""Of a vehicle at 36 km/h and ten sweeps a second. Those of a slower one fall into the same
voxels."""

_RENDER_PER_POINT = 4.1e3
"""Of a point of a sweep: some 60 sweeps are in memory to draw an image [bytes]."""

PER_PIXEL = 45
"""Of an image [bytes]."""

_LEAST_CHUNK = 50.0
"""Shorter chunks of ground save little, since each overlaps its neighbours by 100 m [m]."""

_SAMPLES = 5
"""Sweeps that are read to know how many points there are."""


def _renderer(renderer: Any) -> Any:
    return Renderer(renderer) if isinstance(renderer, str) else renderer or Renderer()


class Execution(Checked):
    """How a run is carried out: workers, memory, renderer, and what stays.

    Each field with a description is an option of ``docdepth run``. A script that asks for jobs
    needs the line ``if __name__ == "__main__":``.
    """

    model_config = ConfigDict(arbitrary_types_allowed=True)

    threads: int = Field(
        0,
        ge=0,
        le=MOST_THREADS,
        description="Number of threads; 0 = all cores. Does not change the result.",
        json_schema_extra={"metavar": "N"},
    )
    jobs: int = Field(
        1,
        ge=1,
        le=1024,
        description="Number of local processes that share the work after odometry. Does not change "
        "the result.",
        json_schema_extra={"metavar": "N"},
    )
    scheduler: str | None = Field(
        None,
        description="Address of a Dask scheduler (tcp://HOST:8786) whose workers do the work "
        "instead. They must see recording and run folder under the same paths.",
        json_schema_extra={"metavar": "ADDRESS"},
    )
    memory: str | None = Field(
        None,
        description="Memory limit of all processes together, for example 4G. Shortens the chunks "
        "of ground; a run that needs more does not start. Does not change the result.",
        json_schema_extra={"metavar": "SIZE"},
    )
    renderer: Annotated[Renderer, BeforeValidator(_renderer)] = Field(
        Renderer(), description="Rasteriser; all give the same pixels. cpu if absent."
    )
    keep: Keep | None = Field(
        None,
        description="Files to keep when the run is complete. frames: all. results: delete the "
        "deskewed sweeps, about 80 % of the size, which view, map and render need. Default: as the "
        "run was started; frames for a new run.",
    )
    force: bool = Field(
        False,
        description="Continue a run with other inputs or parameters; results that depend on them "
        "are made again.",
    )
    dry_run: bool = Field(
        False, description="Check all inputs and list what would be made; write nothing."
    )
    progress: Progress | None = None

    @model_validator(mode="after")
    def _one_kind_of_workers(self) -> Execution:
        if self.scheduler is not None and self.jobs > 1:
            raise ConfigError(
                "`jobs` are for this machine, `scheduler` for a cluster", "give one of them"
            )
        return self

    def workers(self) -> WorkerPool:
        """Who does the work."""
        return WorkerPool(self.threads, self.jobs, self.scheduler)

    def but(self, **changes: Any) -> Execution:
        """The same with other values."""
        return self.model_copy(update=changes)


def memory_of_run(
    points: int,
    sweeps: int,
    cameras: Sequence[CameraStream],
    parameters: Parameters,
    jobs: int = 1,
) -> int:
    """Peak memory of a run by estimate [bytes]."""
    sizes = [stream.camera.width * stream.camera.height for stream in cameras]
    votes = _VOTES + _VOTES_PER_POINT * points
    merged = _SWEEPS_A_METRE * (parameters.ground.chunk_length + 2 * CHUNK_OVERLAP)
    ground = _ground_per_sweep(points) * min(merged, sweeps)
    render = _RENDER_PER_POINT * points + PER_PIXEL * max(sizes, default=0)
    return int(jobs * (BASE + max(votes, ground, render)) + _PER_SWEEP * sweeps)


def _ground_per_sweep(points: int) -> float:
    """Bytes of the voxels that a sweep fills."""
    return _PER_VOXEL * points / (1 + points / _DENSE_SWEEP)


def within_memory(
    budget: str,
    recording: Dataset,
    cameras: Sequence[CameraStream],
    parameters: Parameters,
    jobs: int = 1,
) -> Parameters:
    """Parameters with chunks of ground so short that a run keeps to a budget of memory.

    Nothing else changes: labels do not depend on where chunks begin.
    """
    count, memory = len(recording), bytes_of(budget)
    some = evenly(count, _SAMPLES)
    points = max(int(np.count_nonzero(usable_points(recording.sweep(k).points))) for k in some)
    left = (memory - _PER_SWEEP * count) / jobs - BASE
    fits = left / _ground_per_sweep(max(points, 1)) / _SWEEPS_A_METRE - 2 * CHUNK_OVERLAP
    longest = parameters.ground.chunk_length
    length = min(longest, max(10 * math.floor(fits / 10), _LEAST_CHUNK))
    if memory_of_run(points, count, cameras, parameters, jobs) > memory:
        parameters = replaced(parameters, {"ground.chunk_length": length})
    needed = memory_of_run(points, count, cameras, parameters, jobs)
    if needed > memory:
        raise ConfigError(
            f"`memory={budget!r}`: the run needs {needed / 1e9:.2f} GB by estimate, even with "
            f"chunks of ground of {length:g} m; give more memory" + ", or fewer `jobs`" * (jobs > 1)
        )
    return parameters


def store_memory_budget(run: RunFolder, within: Parameters) -> None:
    """Note the chunks of ground of :func:`within_memory`. They are no parameter of the run: with
    another budget it is still the same run."""
    length = within.ground.chunk_length
    shorter = length < run.parameters.ground.chunk_length
    run.manifest.chunk_length = length if shorter else None


def parameters_within_budget(run: RunFolder) -> Parameters:
    """The parameters of a run, with the chunks of ground that its budget of memory allows."""
    values, length = run.parameters, run.manifest.chunk_length
    if length is not None and length < values.ground.chunk_length:
        return replaced(values, {"ground.chunk_length": length})
    return values


def bytes_of(size: str) -> int:
    """Bytes of a size as people write it: ``4G``, ``1.5 GB``, ``800M``."""
    found = re.fullmatch(r"(\d+(?:\.\d+)?)\s*([kMGT]?)B?", size.strip())
    if found is None:
        raise ConfigError(f"`memory={size!r}`: give a size, for example 4G or 800M")
    return int(float(found[1]) * 1000 ** " kMGT".index(found[2] or " "))


_FRAME_BYTES = 29  # of a point in frames/*.ply
_PICTURE_BYTES = 0.3  # of a pixel in report/*.jpg
_LAYER_BYTES = 4.0  # of a pixel of a layer
_FORMAT_BYTES = {"png": 1.2, "exr": 2.5, "exr-half": 1.5, "tiff": 3.5, "npz": 3.0, "npy": 4.0}
_CGROUP = Path("/sys/fs/cgroup")


@dataclass(frozen=True)
class Estimate:
    """What a run needs, in bytes."""

    memory: int
    disk: int


def estimate(
    points: NDArray[np.int64],
    sweeps: int,
    cameras: Sequence[CameraStream],
    parameters: Parameters,
    jobs: int = 1,
) -> Estimate:
    """Estimate memory and disk."""
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
        with collect_findings(found):
            check_image_size(stream.camera.width, stream.camera.height, stream.name)
    memory = available_memory()
    if not found and memory is not None and needed.memory > memory:
        text = (
            f"the run needs {size_text(needed.memory)} of memory for these sweeps and images by "
            f"estimate, {size_text(memory)} are free"
        )
        remedy = "give `memory` or fewer `jobs`, or end other programs"
        found.append(Finding("memory", "", text, remedy, "error"))
    if output is None:
        return found
    existing = next(p for p in [output.absolute(), *output.absolute().parents] if p.is_dir())
    free = shutil.disk_usage(existing).free + _used(output)
    if needed.disk > free:
        text = (
            f"the run writes {size_text(needed.disk)} by estimate, {size_text(free)} are free there"
        )
        found.append(Finding("disk", str(output), text, "make room or name another disk", "error"))
    return found


def check_image_size(width: int, height: int, name: str = "the image") -> None:
    """Refuse images that cannot be held in memory, also of virtual cameras."""
    needed, memory = int(BASE) + PER_PIXEL * width * height, available_memory()
    if memory is not None and needed > memory:
        raise CalibrationError(
            f"{name}: {width} x {height} pixels need {size_text(needed)} of memory by estimate, "
            f"{size_text(memory)} are free",
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


def size_text(count: int) -> str:
    """A number of bytes as people read it."""
    return f"{count / 1e9:.1f} GB" if count >= 1e8 else f"{count / 1e6:.0f} MB"
