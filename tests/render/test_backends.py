"""OpenGL draws what the CPU draws, by each context that works here; missing libraries are named."""

from __future__ import annotations

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from render_reference import TRIANGLES, compose_depth, drawing, drive, render_sweep, small_camera

import docdepth._core as _core
from docdepth.config import RenderParameters
from docdepth.errors import BackendError
from docdepth.render import backends

TIME = 130_000_000
SOFTWARE = ("llvmpipe", "softpipe", "swrast")


@pytest.fixture(params=["egl", "osmesa"])
def gl(request):
    try:
        return backends.Renderer(request.param)
    except BackendError as error:
        pytest.skip(str(error))


def splats(*sizes):
    sizes = {"static_size": sizes[:2], "dynamic_size": sizes[2:]}
    return RenderParameters(primitive="splats", behind=0.5, ahead=100.0, step=0.2, **sizes)


DRAWN = [
    TRIANGLES,
    splats(50, 3, 80, 35),
    splats(9.3, 1, 14, 2.6),
    splats(1, 0.4, 1, 1),
    splats(400, 20, 500, 270),  # drivers draw points of at most 255 pixels
]


def assert_drawn_alike(gl, *asked):
    """Within 1 cm in 99.9 % of the pixels; Mesa's software, which rounds as IEEE, everywhere."""
    depth, expected = compose_depth(*asked, renderer=gl), compose_depth(*asked)
    if any(name in gl.description for name in SOFTWARE):
        np.testing.assert_array_equal(depth, expected)
    same = np.isnan(depth) & np.isnan(expected) | (np.abs(depth - expected) <= 0.01)
    assert same.mean() >= 0.999
    return depth


def test_each_context_draws_what_the_cpu_draws(gl):
    """Several scenes, sizes and times by one context: copies on the device do not mix."""
    for seed, parameters in enumerate(DRAWN):
        for width, height, focal in [(160, 60, 60.0), (401, 230, 200.0)]:
            trajectory, frames, _ = drive(np.random.default_rng(seed), TIME, parameters)
            for time in (TIME, TIME + 150_000_000):
                camera = small_camera(width, height, focal)
                depth = assert_drawn_alike(
                    gl, *drawing(frames, trajectory, time, parameters, camera)
                )
                assert np.isfinite(depth).any()
    empty = render_sweep(np.empty((0, 3), np.float32), np.empty(0, np.uint16), parameters)
    assert np.isnan(assert_drawn_alike(gl, *drawing(empty, parameters=parameters))).all()


def test_draws_from_many_threads(gl):
    trajectory, frames, _ = drive(np.random.default_rng(0), TIME, DRAWN[2])
    asked = drawing(frames, trajectory, TIME, DRAWN[2])
    with ThreadPoolExecutor(3) as pool:
        list(pool.map(lambda _: assert_drawn_alike(gl, *asked), range(9)))


def test_splats_beyond_the_limit_are_refused(gl):
    trajectory, frames, _ = drive(np.random.default_rng(1), TIME, DRAWN[2])
    with pytest.raises(BackendError, match="the cpu draws any size"):
        compose_depth(*drawing(frames, trajectory, TIME, splats(1500, 20, 1, 1)), renderer=gl)


FORKED = """
import os, sys
import numpy as np
from docdepth.render import backends
from docdepth.errors import BackendError
empty = (np.eye(3), 4, 4, [], [], (3.0, 1.0), (3.0, 1.0))
renderer = backends.Renderer(sys.argv[1])
renderer.core.render_splats(*empty)
child = os.fork()
if child == 0:
    refused = 0
    for draw in (
        lambda: renderer.core.render_splats(*empty),
        lambda: backends.Renderer(sys.argv[1]),
    ):
        try:
            draw()
        except BackendError as error:
            refused += "forked" in str(error)
    backends.Renderer("cpu").core.render_splats(*empty)
    os._exit(0 if refused == 2 else 1)
status = os.waitpid(child, 0)[1]
renderer.core.render_splats(*empty)
sys.exit(os.waitstatus_to_exitcode(status))
"""


def test_a_forked_child_gets_an_error_and_the_parent_continues(gl):
    command = [sys.executable, "-c", FORKED, gl.name]
    done = subprocess.run(command, timeout=120, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="OpenGL on Linux only")
def test_broken_libraries_are_named_and_the_cpu_renders(tmp_path):
    for name in ("libEGL.so.1", "libEGL.so", "libOSMesa.so.8", "libOSMesa.so.6", "libOSMesa.so"):
        (tmp_path / name).write_bytes(b"not a library")
    environment = {**os.environ, "LD_LIBRARY_PATH": str(tmp_path)}
    verb = [sys.executable, "-c", "from docdepth.cli import main; main()"]

    def ended(*arguments):
        return subprocess.run(
            [*verb, *arguments], env=environment, capture_output=True, text=True, check=False
        )

    failed, listed = ended("render", str(tmp_path), "--renderer", "osmesa"), ended("doctor")
    assert failed.returncode == 2
    assert "renderer osmesa is not available: " in failed.stderr
    assert "libOSMesa.so.8" in failed.stderr
    assert listed.returncode == 0
    assert "libEGL.so.1" in listed.stdout
    assert "libOSMesa.so.8" in listed.stdout


def test_names():
    assert backends.Renderer().core is _core
    for name in ("vulkan", "egl:", "egl:-1", "egl:x", "osmesa:0", "egl:99999999999", None):
        with pytest.raises(BackendError, match="unknown renderer"):
            backends.Renderer(name)
    with pytest.raises(BackendError, match=r"renderer egl:999 is not available: .+"):
        backends.Renderer("egl:999")
