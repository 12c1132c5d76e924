"""Which device draws: the processor, or OpenGL without a window through EGL or OSMesa.

All of them draw the same. OpenGL's libraries are looked for when a back end is asked for, so
docdepth needs none of them. A back end is named as in ``--renderer`` and ``DOCDEPTH_RENDERER``:

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
from typing import Any

from docdepth import _core
from docdepth.errors import BackendError

log = logging.getLogger(__name__)

CPU = "docdepth's own rasteriser"


class Renderer:
    """A back end that is ready to draw, from any thread: each gets an OpenGL context of its own.

    Parameters
    ----------
    name : str
        ``cpu``, ``egl``, ``egl:N``, ``surfaceless`` or ``osmesa``.

    Attributes
    ----------
    name : str
    description : str
        The device: GL_RENDERER of OpenGL.
    software : bool
        The processor draws.

    Raises
    ------
    BackendError
        There is no such back end, or it cannot be used here.
    """

    def __init__(self, name: str = "cpu") -> None:
        self.name = name
        self._library = None if name == "cpu" else _library(name)
        self._threads = threading.local()
        core = self.core
        self.description: str = core.renderer if self._library else CPU
        self.software: bool = core.software if self._library else True

    @property
    def core(self) -> Any:
        """What has ``render_splats`` and its like in this thread.

        Raises
        ------
        BackendError
            OpenGL has been used before this process was forked, which drivers do not survive.
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
    """The renderer of a name.

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
    return _graphics_card() or Renderer("cpu") if name == "auto" else Renderer(name)


def _graphics_card() -> Renderer | None:
    """The first that draws in hardware. Software devices are known without being started."""
    try:
        devices = _core.egl_devices()
    except _core.GlError as error:
        log.info("no graphics card: %s", error)
        return None
    for device in (i for i, hardware in enumerate(devices) if hardware):
        try:
            renderer = Renderer(f"egl:{device}")
        except BackendError as error:
            log.info("%s", error)
            continue
        if not renderer.software:
            return renderer
        log.info("EGL device %d is drawn by %s", device, renderer.description)
    return None


@dataclass(frozen=True)
class Backend:
    """A back end that was tried out.

    Attributes
    ----------
    name : str
        As in ``--renderer``.
    well : bool
        It can be used here.
    finding : str
        The device that draws, or why it cannot.
    """

    name: str
    well: bool
    finding: str


def available() -> list[Backend]:
    """Every back end, tried out; EGL once for each of its devices."""
    found = [Backend("cpu", True, CPU)]
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
    """Library and device number, -1 for any."""
    egl = re.fullmatch(r"egl(?::([0-9]{1,4}))?", name)
    if egl:
        return "egl", int(egl[1] or -1)
    if name in ("surfaceless", "osmesa"):
        return name, -1
    raise BackendError(
        f"unknown renderer {name!r}; there are auto, cpu, egl, egl:N, surfaceless and osmesa"
    )
