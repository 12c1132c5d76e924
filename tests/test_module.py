"""Nothing that is passed to the compiled module ends the interpreter."""

from __future__ import annotations

import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import docdepth._core as _core
import hostile

PROGRAM = Path(hostile.__file__)


@pytest.mark.parametrize("seed", [1, 2])
def test_bad_arguments_end_in_an_exception(seed):
    """Never in a signal, never out of memory, never after seconds."""
    command = [sys.executable, PROGRAM, str(seed), "4000"]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert ended.returncode == 0, ended.stdout[-600:] + ended.stderr[-2000:]
    assert ended.stdout.splitlines()[-1].startswith("ended {")


def test_every_function_is_called():
    known = {name.partition(".")[0] for name in hostile.callables()}
    public = {name for name in dir(_core) if not name.startswith("_")} - {"GlError"}
    assert public - known <= {"KeyFrame"}  # it has no constructor


def test_an_object_that_was_never_made_cannot_be_had():
    for kind in (_core.Frame, _core.GroundMap, _core.ScanMesh, _core.KeyFrame):
        with pytest.raises(TypeError):
            kind.__new__(kind)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("neighbors", 10**9, r"^neighbors = 1000000000 must lie between 1 and 1000$"),
        ("seed_radius", -1.0, "^seed_radius = -1 must lie between"),
        ("voxel_size", float("nan"), "^voxel_size = nan must lie between"),
    ],
)
def test_refusals_are_sentences(name, value, message):
    parameters = _core.GroundParameters()
    setattr(parameters, name, value)
    with pytest.raises(ValueError, match=message):
        _core.GroundMap(parameters)


def test_an_image_that_cannot_be_held_is_refused():
    K = np.array([[9.0, 0, 4], [0, 9, 3], [0, 0, 1]])
    with pytest.raises(ValueError, match="width times height = 2500000000 must lie between 1 and"):
        _core.render_splats(K, 50_000, 50_000, [], [], (50, 3), (80, 35))


def test_growth_of_the_ground_ends_when_it_is_interrupted():
    """A chunk of half a kilometre grows for many seconds."""
    x, y = np.meshgrid(np.arange(1000), np.arange(1000))
    floor = np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3).astype(np.float32) * np.float32(0.03)
    ground_map = _core.GroundMap(_core.GroundParameters(), 1)
    ground_map.insert(floor, np.eye(4))

    def interrupt(*_):
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGALRM, interrupt)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.05)
        with pytest.raises(KeyboardInterrupt):
            ground_map.grow()
    finally:
        signal.signal(signal.SIGALRM, before)
    assert not ground_map.label(floor, np.eye(4)).any(), "it had grown to its end"
    assert ground_map.grow() == len(ground_map)


def test_a_ground_map_is_filled_from_several_threads():
    ground_map = _core.GroundMap(_core.GroundParameters(), 2)
    numbers = np.random.default_rng(0)
    clouds = [numbers.uniform(-9, 9, (5000, 3)).astype(np.float32) for _ in range(24)]

    def use(points: np.ndarray) -> int:
        ground_map.insert(points, np.eye(4))
        ground_map.grow()
        return int(ground_map.label(points, np.eye(4)).sum())

    with ThreadPoolExecutor(6) as pool:
        assert len(list(pool.map(use, clouds))) == len(clouds)
