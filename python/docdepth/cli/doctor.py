"""What this installation can do, and why it cannot do the rest."""

from __future__ import annotations

import importlib
import importlib.metadata
import os
import platform
import re
from collections.abc import Mapping, Sequence

from docdepth._core import __version__
from docdepth.render import backends

# Debian's packages of the system libraries that Python packages load.
_DEBIAN = {
    "libusb-1.0": "libusb-1.0-0",
    "libGL.": "libgl1",
    "libOpenGL.": "libopengl0",
    "libEGL.": "libegl1",
    "libOSMesa.": "libosmesa6",
    "libgomp.": "libgomp1",
    "libX11.": "libx11-6",
    "libglib-2.0": "libglib2.0-0",
    "libgthread-2.0": "libglib2.0-0",
    "libstdc++.": "libstdc++6",
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
    needed = requirements()
    if not needed:
        rows.append(("packages", "unknown: docdepth is not installed; run: pip install .", False))
    modules = importlib.metadata.packages_distributions()
    for package in needed.get("", ()):
        rows.append((package, *examine(package, modules)))
    for extra in sorted(set(needed) - {""}):
        rows.append((f"extra {extra}", *_examine_extra(extra, needed[extra], modules)))
    for backend in backends.available():
        rows.append((f"renderer {backend.name}", backend.detail, backend.usable))
    return rows


def requirements() -> dict[str, list[str]]:
    """Packages by extra, as pyproject.toml names them; the key "" holds what is always needed."""
    try:
        meta = importlib.metadata.metadata("docdepth")
    except importlib.metadata.PackageNotFoundError:
        return {}
    found: dict[str, list[str]] = {extra: [] for extra in ["", *meta.get_all("Provides-Extra", [])]}
    for requirement in meta.get_all("Requires-Dist", []):
        name = re.match(r"[\w.-]+", requirement)
        extra = re.search(r"extra\s*==\s*['\"]([\w-]+)", requirement)
        packages = found.setdefault(extra[1] if extra else "", [])
        if name and name[0] != "docdepth" and name[0] not in packages:
            packages.append(name[0])
    return found


def examine(package: str, modules: Mapping[str, Sequence[str]]) -> tuple[str, bool]:
    """Version of a package if its modules can be imported, else the reason; and whether it is well.

    Parameters
    ----------
    package : str
        Name of the distribution.
    modules : mapping of str to list of str
        Distributions of each importable module.
    """
    try:
        version = importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "missing", False
    for module in sorted(m for m, of in modules.items() if _folded(package) in map(_folded, of)):
        if not module.isidentifier() or module.startswith("_"):
            continue  # stubs and parts
        try:
            importlib.import_module(module)
        except Exception as error:
            return f"{version} cannot be imported: {error}{_remedy(str(error))}", False
    return version, True


def _examine_extra(
    extra: str, packages: list[str], modules: Mapping[str, Sequence[str]]
) -> tuple[str, bool]:
    findings = {package: examine(package, modules) for package in packages}
    if all(well for _, well in findings.values()):
        return ", ".join(f"{p} {version}" for p, (version, _) in findings.items()), True
    missing = [package for package, (finding, _) in findings.items() if finding == "missing"]
    broken = [
        f"{p} {finding}" for p, (finding, well) in findings.items() if not well and p not in missing
    ]
    if missing:
        some = f"{', '.join(missing)} missing" if len(missing) < len(packages) else "not installed"
        broken += [some, f'pip install "docdepth[{extra}]"']
    return "; ".join(broken), False


def _remedy(error: str) -> str:
    """The Debian package of the library that an import lacks."""
    packages = [package for library, package in _DEBIAN.items() if library in error]
    return f"; on Debian: apt install {packages[0]}" if packages else ""


def _folded(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()
