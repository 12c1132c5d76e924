"""Renderers: the CPU, or OpenGL without a window by EGL or OSMesa.

All of them render the same depth. OpenGL's libraries are loaded when a renderer is opened, so
docdepth works without them. The names of ``--renderer`` are:

``cpu``
    docdepth's own rasteriser, the default: always available, and the fastest wherever measured
``egl``, ``egl:N``
    EGL on the first device that works, graphics cards first; or on device N
``osmesa``
    Mesa's off-screen library, removed from Mesa with version 25.1
"""

from __future__ import annotations

import re
import threading
from dataclasses import dataclass
from typing import Any

import docdepth._core as _core
from docdepth.errors import BackendError

_CPU = "docdepth's own rasteriser"


class Renderer:
    """A renderer, for any thread; each thread gets its own OpenGL context.

    Parameters
    ----------
    name : str
        ``cpu``, ``egl``, ``egl:N`` or ``osmesa``.

    Attributes
    ----------
    name : str
        As given.
    description : str
        The device, OpenGL's GL_RENDERER.

    Raises
    ------
    BackendError
        The name is unknown, or the renderer cannot be used on this machine.
    """

    def __init__(self, name: str = "cpu") -> None:
        if not re.fullmatch(r"cpu|osmesa|egl(:[0-9]{1,4})?", str(name)):
            raise BackendError(
                f"unknown renderer {name!r}; it must be the str cpu, egl, egl:N or osmesa"
            )
        self.name = name
        self._threads = threading.local()
        self.description: str = _CPU if name == "cpu" else self.core.renderer

    def __repr__(self) -> str:
        return f"<Renderer {self.name}: {self.description}>"

    def __reduce__(self) -> tuple[type[Renderer], tuple[str]]:
        return Renderer, (self.name,)

    @property
    def core(self) -> Any:
        """The object with ``render_splats`` and ``render_meshes`` for this thread.

        Raises
        ------
        BackendError
            OpenGL cannot be used here, for example as this process was forked after its use.
        """
        if self.name == "cpu":
            return _core
        if not hasattr(self._threads, "core"):
            library, _, device = self.name.partition(":")
            try:
                self._threads.core = _core.GlRenderer(library, int(device or -1))
            except _core.GlError as error:
                raise BackendError(
                    f"renderer {self.name} is not available: {error}",
                    "`renderer='cpu'` always is; `docdepth.render.backends.available()` lists all",
                ) from None
        return self._threads.core


@dataclass(frozen=True)
class Backend:
    """The result of trying a renderer."""

    name: str  # as in ``--renderer``
    usable: bool  # it can be used on this machine
    detail: str  # the device that renders, or the reason why none does


def available() -> list[Backend]:
    """Try every renderer, and EGL on each of its devices."""
    found = [Backend("cpu", True, _CPU)]
    for name in [*([f"egl:{i}" for i in range(_core.egl_devices())] or ["egl"]), "osmesa"]:
        library, _, device = name.partition(":")
        try:
            renderer = _core.GlRenderer(library, int(device or -1)).renderer
            found.append(Backend(name, True, renderer))
        except _core.GlError as error:
            found.append(Backend(name, False, str(error)))
    return found
