"""What this installation can do, and why it cannot do the rest."""

from __future__ import annotations

import importlib
import importlib.metadata
import os
import platform

from docdepth import __version__
from docdepth.render import backends

_REQUIRED = (
    "numpy", "opencv-python-headless", "kiss-icp", "small-gicp", "pydantic",
)  # fmt: skip
_EXTRAS = {
    "exr": ("OpenEXR",),
    "synth": ("trimesh", "embreex"),
    "viz": ("open3d", "matplotlib"),
}


def doctor() -> list[tuple[str, str, bool]]:
    """Rows of name, finding, and whether it is well.

    Returns
    -------
    list of (str, str, bool)
    """
    rows = [
        ("docdepth", __version__, True),
        ("Python", platform.python_version(), True),
        ("machine", f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores", True),
    ]
    for package in _REQUIRED:
        rows.append((package, *_version(package)))
    for extra, packages in _EXTRAS.items():
        missing = [p for p in packages if not _version(p)[1]]
        finding = f'missing; pip install "docdepth[{extra}]"' if missing else "installed"
        rows.append((f"extra {extra}", finding, not missing))
    for backend in backends.available():
        rows.append((f"renderer {backend.name}", backend.detail, backend.usable))
    return rows


def _version(package: str) -> tuple[str, bool]:
    try:
        return importlib.metadata.version(package), True
    except importlib.metadata.PackageNotFoundError:
        return "missing", False
