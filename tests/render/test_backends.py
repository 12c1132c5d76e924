"""OpenGL back ends compared with the CPU, and missing libraries."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from render_reference import AXES, TRIANGLES, drive, reference, small_camera, straight

import docdepth._core as _core
from docdepth.cli.doctor import doctor
from docdepth.config import RenderParameters
from docdepth.errors import BackendError
from docdepth.render import backends
from docdepth.render.depth_map import compose_depth
from docdepth.render.frame import Frame

TIME = 130_000_000
LINUX = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="OpenGL on Linux only")
BROKEN = ("libEGL.so.1", "libEGL.so", "libOSMesa.so.8", "libOSMesa.so.6", "libOSMesa.so")


def opened(name):
    try:
        return backends.Renderer(name)
    except BackendError as error:
        pytest.skip(str(error))


@pytest.fixture(params=["egl", "surfaceless", "osmesa"])
def gl(request):
    return opened(request.param)


def any_gl():
    """The name of a back end that works on this machine."""
    found = backends.available()[1:]
    for backend in found:
        if backend.usable:
            return backend.name
    pytest.skip("no OpenGL: " + "; ".join(f"{b.name}: {b.detail}" for b in found))


def parameters_of(sizes):
    return RenderParameters(
        primitive="splats",
        behind=0.5,
        ahead=100.0,
        step=0.2,
        static_size=sizes[:2],
        dynamic_size=sizes[2:],
    )


def assert_agree(depth, expected, renderer):
    """Within 1 cm in 99.9 % of the pixels; Mesa's software, which rounds as IEEE, everywhere."""
    assert depth.shape == expected.shape
    assert depth.dtype == np.float32
    if renderer.software:
        np.testing.assert_array_equal(depth, expected)
    same = np.isnan(depth) & np.isnan(expected) | (np.abs(depth - expected) <= 0.01)
    assert same.mean() >= 0.999


DRAWN = [
    TRIANGLES,
    parameters_of((50, 3, 80, 35)),
    parameters_of((9.3, 1, 14, 2.6)),
    parameters_of((1, 0.4, 1, 1)),
]


@pytest.mark.parametrize("parameters", DRAWN)
def test_agrees_with_the_cpu(gl, parameters):
    camera = small_camera()
    for seed in range(3):
        trajectory, frames, _ = drive(np.random.default_rng(seed), TIME, parameters)
        asked = (camera, AXES, trajectory, TIME, frames.__getitem__, parameters)
        depth = compose_depth(*asked, renderer=gl)
        assert np.isfinite(depth).any()
        assert_agree(depth, compose_depth(*asked), gl)


def test_agrees_with_plain_numpy(gl):
    parameters, camera = DRAWN[2], small_camera()
    trajectory, frames, clouds = drive(np.random.default_rng(7), TIME, parameters)
    depth = compose_depth(
        camera, AXES, trajectory, TIME, frames.__getitem__, parameters, renderer=gl
    )
    assert_agree(depth, reference(camera, clouds), gl)


def test_splats_larger_than_a_point_can_be_are_squares(gl):
    camera = small_camera(400, 300, 200.0)
    trajectory, frames, _ = drive(np.random.default_rng(1), TIME, parameters_of((1, 1, 1, 1)))
    parameters = parameters_of((400, 20, 500, 270))  # Mesa's points have at most 255 pixels
    asked = (camera, AXES, trajectory, TIME, frames.__getitem__, parameters)
    assert_agree(compose_depth(*asked, renderer=gl), compose_depth(*asked), gl)
    asked = (*asked[:-1], parameters_of((1500, 20, 1, 1)))
    with pytest.raises(BackendError, match="the cpu draws any size"):
        compose_depth(*asked, renderer=gl)


def test_each_image_is_drawn_anew(gl):
    """One renderer for several frames, poses and image sizes; points on the device do not mix."""
    for seed, width in enumerate([160, 160, 160, 90, 1242]):
        parameters = DRAWN[seed % 3]
        camera = small_camera(width, 60, 60.0)
        trajectory, frames, _ = drive(np.random.default_rng(seed), TIME, parameters)
        for time in (TIME, TIME + 150_000_000):
            asked = (camera, AXES, trajectory, time, frames.__getitem__, parameters)
            assert_agree(compose_depth(*asked, renderer=gl), compose_depth(*asked), gl)
    empty = Frame(np.empty((0, 3), np.float32), np.empty(0, np.uint16), parameters)
    assert np.isnan(
        compose_depth(camera, AXES, straight(1), 0, lambda _: empty, parameters, renderer=gl)
    ).all()


@pytest.mark.parametrize("parameters", DRAWN[:2])
def test_real_drive(gl, drive_0005, parameters):
    """The documented agreement, for KITTI's camera and both presets."""
    from docdepth.datasets import open_dataset

    dataset = open_dataset(drive_0005)
    stream = dataset.cameras["image_02"]
    points = dataset.sweep(10).points
    classid = np.where(np.arange(len(points)) % 7 == 0, 100, 50).astype(np.uint16)
    frame = Frame(np.ascontiguousarray(points), classid, parameters)
    asked = (stream.camera, stream.T_camera_lidar, straight(1), 0, lambda _: frame, parameters)
    assert_agree(compose_depth(*asked, renderer=gl), compose_depth(*asked), gl)


def test_draws_from_many_threads(gl):
    parameters, camera = parameters_of((9, 2, 14, 3)), small_camera()
    trajectory, frames, _ = drive(np.random.default_rng(0), TIME, parameters)
    asked = (camera, AXES, trajectory, TIME, frames.__getitem__, parameters)
    expected = compose_depth(*asked)
    with ThreadPoolExecutor(3) as pool:
        for depth in pool.map(lambda _: compose_depth(*asked, renderer=gl), range(9)):
            assert_agree(depth, expected, gl)


def test_a_context_of_another_thread_is_refused(gl):
    core = _core.GlRenderer(gl.name)
    said = []

    def draw():
        try:
            core.render_splats(np.eye(3), 4, 4, [], [], (3.0, 1.0), (3.0, 1.0))
        except _core.GlError as error:
            said.append(str(error))

    thread = threading.Thread(target=draw)
    thread.start()
    thread.join()
    assert "belongs to another thread" in said[0]
    assert np.isnan(core.render_splats(np.eye(3), 4, 4, [], [], (3.0, 1.0), (3.0, 1.0))).all()


FORKED = """
import os, sys
import numpy as np
from docdepth.render import backends
from docdepth.errors import BackendError
empty = (np.eye(3), 4, 4, [], [], (3.0, 1.0), (3.0, 1.0))
renderer = backends.Renderer(sys.argv[1])
renderer.core.render_splats(*empty)
child = os.fork()
said = []
for draw in (
    lambda: renderer.core.render_splats(*empty),
    lambda: backends.Renderer(sys.argv[1]),
) if child == 0 else ():
    try:
        draw()
    except BackendError as error:
        said.append("forked" in str(error))
if child == 0:
    backends.choose("cpu").core.render_splats(*empty)
    os._exit(0 if said == [True, True] else 1)
status = os.waitpid(child, 0)[1]
renderer.core.render_splats(*empty)
sys.exit(os.waitstatus_to_exitcode(status))
"""


@pytest.mark.parametrize("name", ["egl", "surfaceless", "osmesa"])
def test_a_forked_child_gets_an_error_and_the_parent_continues(name):
    opened(name)
    done = subprocess.run(
        [sys.executable, "-c", FORKED, name], timeout=120, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr


def test_a_child_forked_before_opengl_was_used_may_use_it():
    script = """
import os, sys
from docdepth.render import backends
child = os.fork()
backends.Renderer(sys.argv[1])
sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) if child else 0)
"""
    name = any_gl()
    subprocess.run([sys.executable, "-c", script, name], timeout=120, check=True)


@LINUX
@pytest.mark.parametrize("backend", ["egl", "surfaceless", "osmesa"])
def test_a_missing_library_is_named(backend):
    with pytest.raises(_core.GlError, match=r"libnot_there\.so"):
        _core.GlRenderer(backend, library="libnot_there.so")
    with pytest.raises(_core.GlError, match=r"libc\.so\.6 has no (egl|OSMesa)GetProcAddress"):
        _core.GlRenderer(backend, library="libc.so.6")


@LINUX
def test_with_broken_libraries_the_cpu_renders(tmp_path):
    for name in BROKEN:
        (tmp_path / name).write_bytes(b"not a library")
    script = """
from docdepth.render import backends
from docdepth.errors import BackendError
assert backends.choose().name == "cpu"
found = {b.name: b for b in backends.available()}
assert found.pop("cpu").usable
assert set(found) == {"egl", "surfaceless", "osmesa"}, found
for name, backend in found.items():
    assert not backend.usable and ".so" in backend.detail, backend
    try:
        backends.choose(name)
    except BackendError as error:
        assert backend.detail in str(error)
    else:
        raise AssertionError(name)
"""
    environment = {**os.environ, "LD_LIBRARY_PATH": str(tmp_path), "COLUMNS": "40"}
    subprocess.run([sys.executable, "-c", script], env=environment, check=True)
    command = [sys.executable, "-c", "from docdepth.cli import main; main()"]
    asked = [*command, "render", str(tmp_path), "--renderer", "osmesa"]
    failed = subprocess.run(asked, env=environment, capture_output=True, text=True)
    assert failed.returncode == 2
    assert "renderer osmesa is not available: " in failed.stderr
    assert "libOSMesa.so.8" in failed.stderr
    listed = subprocess.run([*command, "doctor"], env=environment, capture_output=True, text=True)
    assert listed.returncode == 0
    assert "libEGL.so.1" in listed.stdout


@LINUX
def test_the_extension_is_not_linked_to_opengl():
    if not shutil.which("ldd"):
        pytest.skip("no ldd")
    linked = subprocess.run(["ldd", _core.__file__], capture_output=True, text=True, check=True)
    assert "libc.so" in linked.stdout
    for name in ("libGL", "libEGL", "libOSMesa", "libOpenGL", "libgallium", "libglapi"):
        assert name not in linked.stdout


def test_names(monkeypatch):
    monkeypatch.delenv("DOCDEPTH_RENDERER", raising=False)
    assert backends.choose().name == "cpu"
    monkeypatch.setenv("DOCDEPTH_RENDERER", "cpu")
    assert backends.choose().name == "cpu"
    monkeypatch.setenv("DOCDEPTH_RENDERER", "vulkan")
    with pytest.raises(BackendError, match="unknown renderer 'vulkan'; there are cpu"):
        backends.choose()
    for name in ("egl:", "egl:-1", "egl:x", "osmesa:0", "egl:99999999999"):
        with pytest.raises(BackendError, match="unknown renderer"):
            backends.choose(name)
    with pytest.raises(BackendError, match=r"renderer egl:999 is not available: .+"):
        backends.choose("egl:999")


def test_doctor_lists_every_back_end():
    rows = {name: (finding, well) for name, finding, well in doctor()}
    assert rows["renderer cpu"][1]
    for backend in backends.available():
        assert rows[f"renderer {backend.name}"] == (backend.detail, backend.usable)
