"""Memory of a run by a formula, and a run that keeps to a budget.

The largest of three stages counts, each with what it holds at once: the key frames of a window, the
voxels of a chunk of ground, the sweeps of an image. None of them grows with the drive, as
benchmarks/endless.py measures.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

import numpy as np

from docdepth.config import Parameters, replaced
from docdepth.datasets.base import CameraStream, Dataset
from docdepth.errors import ConfigError
from docdepth.geometry.points import usable_points
from docdepth.ground.growing import CHUNK_OVERLAP
from docdepth.io.run_folder import RunFolder

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


def memory_of_run(
    points: int,
    sweeps: int,
    cameras: Sequence[CameraStream],
    parameters: Parameters,
    jobs: int = 1,
) -> int:
    """Peak memory of a run by estimate [bytes].

    Parameters
    ----------
    points : int
        Of the largest sweep.
    sweeps : int
    cameras : sequence of CameraStream
    parameters : Parameters
    jobs : int
        Processes that share the work.
    """
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

    Parameters
    ----------
    budget : str
        ``4G``, ``800M``, or a number of bytes.
    recording : Dataset
    cameras : sequence of CameraStream
    parameters : Parameters
    jobs : int
        Processes that share the work.

    Raises
    ------
    ConfigError
        The budget is no size, or the run needs more by estimate.
    """
    count, memory = len(recording), bytes_of(budget)
    some = np.linspace(0, count - 1, min(count, _SAMPLES)).astype(int)
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


def keep_budget(run: RunFolder, within: Parameters) -> None:
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
    """Bytes of a size as people write it: ``4G``, ``1.5 GB``, ``800M``.

    Raises
    ------
    ConfigError
        It is none.
    """
    found = re.fullmatch(r"(\d+(?:\.\d+)?)\s*([kMGT]?)B?", size.strip())
    if found is None:
        raise ConfigError(f"`memory={size!r}`: give a size, for example 4G or 800M")
    return int(float(found[1]) * 1000 ** " kMGT".index(found[2] or " "))
