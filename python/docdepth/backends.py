"""Which device draws: the processor, or OpenGL without a window through EGL or OSMesa.

All of them draw the same splats. OpenGL's libraries are looked for when a back end is asked for,
so docdepth needs none of them. A back end is named as in ``--renderer`` and ``DOCDEPTH_RENDERER``:

``auto``
    a graphics card through EGL where there is one, else ``cpu``
``cpu``
    docdepth's own rasteriser, which is always there
``egl``, ``egl:N``
    EGL on its first device that works, graphics cards first, or on device N
``surfaceless``
    EGL without a device (Mesa)
``osmesa``
    Mesa's off-screen library, which Mesa dropped with version 25.1
"""

from __future__ import annotations

import logging
import os
import re
import threading
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from docdepth import _core
from docdepth.errors import BackendError, InputError

log = logging.getLogger(__name__)


class Renderer(Protocol):
    """What draws splats.

    Attributes
    ----------
    name : str
        As in ``--renderer``.
    description : str
        The device: GL_RENDERER of OpenGL.
    """

    name: str
    description: str

    def render_splats(self, *args: Any, **settings: Any) -> NDArray[np.float32]:
        """Depth of the nearest splat at each pixel; arguments of ``_core.render_splats``."""
        ...


class CpuRenderer:
    """docdepth's own rasteriser, on all cores."""

    name = "cpu"
    description = "docdepth's own rasteriser"

    def render_splats(self, *args: Any, **settings: Any) -> NDArray[np.float32]:
        return _core.render_splats(*args, **settings)


class GlRenderer:
    """OpenGL without a window. Each thread that draws gets its own context.

    Parameters
    ----------
    name : str
        ``egl``, ``egl:N``, ``surfaceless`` or ``osmesa``.

    Raises
    ------
    BackendError
        The back end cannot be used here, with the reason; also when drawing in a process that was
        forked after OpenGL had been used, which drivers do not survive.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self._backend, self._device = _parse(name)
        self._contexts = threading.local()
        context = self._context()
        self.description: str = context.renderer
        self.software: bool = context.software

    def render_splats(self, *args: Any, **settings: Any) -> NDArray[np.float32]:
        context = self._context()
        try:
            return context.render_splats(*args, **settings)
        except _core.GlError as error:
            raise BackendError(f"renderer {self.name}: {error}") from None

    def render_triangles(
        self,
        K: NDArray[np.float64],
        width: int,
        height: int,
        vertices: NDArray[np.float32],
        triangles: NDArray[np.uint32],
        T_camera_vertices: NDArray[np.float64],
    ) -> NDArray[np.float32]:
        """z of the nearest triangle at each pixel's centre.

        Parameters
        ----------
        K : ndarray of float64, shape (3, 3)
            Pixels; integer pixel coordinates are pixel centres.
        width, height : int
            Pixels.
        vertices : ndarray of float32, shape (N, 3)
            Metres.
        triangles : ndarray of uint32, shape (M, 3)
            Rows of ``vertices``.
        T_camera_vertices : ndarray of float64, shape (4, 4)
            Takes vertices to the camera.

        Returns
        -------
        ndarray of float32, shape (height, width)
            Metres, exact in perspective; NaN where there is no triangle.

        Raises
        ------
        InputError
            Shapes or dtypes are wrong, or a corner is not among the vertices.
        """
        context = self._context()
        try:
            return context.render_triangles(
                K, width, height, vertices, triangles, T_camera_vertices
            )
        except _core.GlError as error:
            raise BackendError(f"renderer {self.name}: {error}") from None
        except (TypeError, ValueError) as error:
            raise InputError(f"triangles cannot be drawn: {error}") from None

    def _context(self) -> _core.GlRenderer:
        context = getattr(self._contexts, "context", None)
        if context is None:
            try:
                context = _core.GlRenderer(self._backend, self._device)
            except _core.GlError as error:
                raise BackendError(
                    f"renderer {self.name} is not available: {error}; --renderer cpu always is, "
                    "and docdepth doctor lists all"
                ) from None
            self._contexts.context = context
        return context


@dataclass(frozen=True)
class Backend:
    """A back end that could draw here.

    Attributes
    ----------
    name : str
        As in ``--renderer``.
    renderer : str or None
        The device that draws; None if it cannot.
    reason : str or None
        Why it cannot.
    """

    name: str
    renderer: str | None
    reason: str | None


def available() -> list[Backend]:
    """Every back end, tried out; EGL once for each of its devices."""
    backends = [Backend("cpu", CpuRenderer.description, None)]
    names = ["surfaceless", "osmesa"]
    try:
        names = [f"egl:{i}" for i in range(len(_core.egl_devices()))] + names
    except _core.GlError as error:
        backends.append(Backend("egl", None, str(error)))
    for name in names:
        try:
            backends.append(Backend(name, _core.GlRenderer(*_parse(name)).renderer, None))
        except _core.GlError as error:
            backends.append(Backend(name, None, str(error)))
    return backends


def choose(name: str | None = None) -> Renderer:
    """The renderer of a name, ready to draw.

    Parameters
    ----------
    name : str, optional
        As in the list above; ``DOCDEPTH_RENDERER`` if absent, else ``auto``.

    Raises
    ------
    BackendError
        There is no such back end, or it cannot be used here. ``auto`` never fails.
    """
    name = name or os.environ.get("DOCDEPTH_RENDERER") or "auto"
    if name == "auto":
        return _graphics_card() or CpuRenderer()
    return CpuRenderer() if name == "cpu" else GlRenderer(name)


def _graphics_card() -> GlRenderer | None:
    """The first that draws in hardware. Software devices are known without being started."""
    try:
        devices = _core.egl_devices()
    except _core.GlError as error:
        log.info("no graphics card: %s", error)
        return None
    for device in (i for i, hardware in enumerate(devices) if hardware):
        try:
            renderer = GlRenderer(f"egl:{device}")
        except BackendError as error:
            log.info("%s", error)
            continue
        if not renderer.software:
            return renderer
        log.info("EGL device %d is drawn by %s", device, renderer.description)
    return None


def _parse(name: str) -> tuple[str, int]:
    """Library and device number, -1 for any."""
    egl = re.fullmatch(r"egl(?::([0-9]{1,4}))?", name)
    if egl:
        return "egl", int(egl[1] or -1)
    if name in ("surfaceless", "osmesa"):
        return name, -1
    raise BackendError(
        f"unknown renderer {name!r}; there are auto, cpu, egl, egl:N, surfaceless and osmesa"
    )
