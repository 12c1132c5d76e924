"""Renderers: the CPU, or OpenGL without a window through EGL or OSMesa.

All of them render the same depth. OpenGL's libraries are loaded when a back end is chosen, so
docdepth works without them. The names of ``--renderer`` and ``DOCDEPTH_RENDERER`` are:

``cpu``
    docdepth's own rasteriser, the default: always available, and the fastest wherever measured
``egl``, ``egl:N``
    EGL on the first device that works, graphics cards first; or on device N
``surfaceless``
    EGL without a device (Mesa)
``osmesa``
    Mesa's off-screen library, removed from Mesa with version 25.1
"""

from __future__ import annotations

import os
import re
import threading
from dataclasses import dataclass
from typing import Any

import docdepth._core as _core
from docdepth.errors import BackendError

_CPU = "docdepth's own rasteriser"


class Renderer:
    """A back end that is ready to render, from any thread; each thread gets its own OpenGL context.

    Parameters
    ----------
    name : str
        ``cpu``, ``egl``, ``egl:N``, ``surfaceless`` or ``osmesa``.

    Attributes
    ----------
    name : str
        Of the back end.
    description : str
        The device, OpenGL's GL_RENDERER.
    software : bool
        The CPU renders.

    Raises
    ------
    BackendError
        The name is unknown, or the back end cannot be used on this machine.
    """

    def __init__(self, name: str = "cpu") -> None:
        if not isinstance(name, str):
            raise BackendError(f"the name of a renderer is a str, not {type(name).__name__}")
        self.name = name
        self._library = None if name == "cpu" else _library(name)
        self._threads = threading.local()
        core = self.core
        self.description: str = core.renderer if self._library else _CPU
        self.software: bool = core.software if self._library else True

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
            This process was forked after OpenGL had been used, which drivers do not support.
        """
        if self._library is None:
            return _core
        if not hasattr(self._threads, "core"):
            try:
                self._threads.core = _core.GlRenderer(*self._library)
            except _core.GlError as error:
                raise BackendError(
                    f"renderer {self.name} is not available: {error}; --renderer cpu always is, "
                    "and docdepth doctor lists all"
                ) from None
        return self._threads.core


def choose(name: str | None = None) -> Renderer:
    """Choose a renderer by name.

    Parameters
    ----------
    name : str, optional
        A name of the list above; if absent ``DOCDEPTH_RENDERER``, else ``cpu``.

    Returns
    -------
    Renderer

    Raises
    ------
    BackendError
        The name is unknown, or the back end cannot be used on this machine.
    """
    return Renderer(name or os.environ.get("DOCDEPTH_RENDERER") or "cpu")


@dataclass(frozen=True)
class Backend:
    """The result of trying a back end.

    Attributes
    ----------
    name : str
        As in ``--renderer``.
    usable : bool
        It can be used on this machine.
    detail : str
        The device that renders, or the reason why none does.
    """

    name: str
    usable: bool
    detail: str


def available() -> list[Backend]:
    """Try every back end, and EGL on each of its devices."""
    found = [Backend("cpu", True, _CPU)]
    names = ["surfaceless", "osmesa"]
    try:
        names = [f"egl:{i}" for i in range(len(_core.egl_devices()))] + names
    except _core.GlError as error:
        found.append(Backend("egl", False, str(error)))
    for name in names:
        try:
            found.append(Backend(name, True, _core.GlRenderer(*_library(name)).renderer))
        except _core.GlError as error:
            found.append(Backend(name, False, str(error)))
    return found


def _library(name: str) -> tuple[str, int]:
    """The library of a back end and the number of a device, -1 for any."""
    egl = re.fullmatch(r"egl(?::([0-9]{1,4}))?", name)
    if egl:
        return "egl", int(egl[1] or -1)
    if name in ("surfaceless", "osmesa"):
        return name, -1
    raise BackendError(
        f"unknown renderer {name!r}; there are cpu, egl, egl:N, surfaceless and osmesa"
    )
