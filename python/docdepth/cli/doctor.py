"""Verbs that tell about docdepth itself: its parameters, and what this installation can do."""

from __future__ import annotations

import importlib
import importlib.metadata
import os
import platform
import re
from collections.abc import Mapping, Sequence
from typing import Annotated

import typer

from docdepth._core import __version__
from docdepth._text import as_setting
from docdepth.cli.options import Json, one_of, verb
from docdepth.cli.terminal import out, say, show_json
from docdepth.config import STAGES
from docdepth.parameter_table import parameter_table
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


@verb()
def parameters(
    stage: Annotated[
        str | None,
        typer.Argument(
            help=f"Stage: {', '.join(STAGES)}; all if absent.",
            show_default=False,
            **one_of(STAGES) | {"metavar": "STAGE"},
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """List the parameters that --set takes: values, ranges, and what each is for."""
    rows = [r for r in parameter_table() if stage in (None, r["name"].partition(".")[0])]
    if as_json:
        return show_json(rows)
    for row in rows:
        unit = f" {row['unit']}" if row["unit"] else ""
        paper = "" if row["paper"] == row["default"] else f", paper {as_setting(row['paper'])}"
        symbol = f" ({row['symbol']} in the paper)" if row["symbol"] else ""
        values = f"{as_setting(row['default'])}{unit}{paper}"
        allowed = f"allowed: {row['range']}" + (unit if row["unit"] else "")
        out.print(f"[bold]{row['name']}[/bold]  {values}; {allowed}", soft_wrap=True)
        say(f"    {row['description']}{symbol}")


@verb()
def doctor(as_json: Json = False) -> None:
    """List what this installation can do, and what it lacks.

    Each package is imported and each renderer tried.
    """
    rows = examine_all()
    if as_json:
        return show_json([{"name": n, "finding": f, "ok": well} for n, f, well in rows])
    for name, finding, well in rows:
        say(f"{'ok' if well else '--'}  {name:<24} {finding}")


def examine_all() -> list[tuple[str, str, bool]]:
    """Rows of name, finding, and whether it is well."""
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
            lacks = [debian for library, debian in _DEBIAN.items() if library in str(error)]
            remedy = f"; on Debian: apt install {lacks[0]}" if lacks else ""
            return f"{version} cannot be imported: {error}{remedy}", False
    return version, True


def _examine_extra(
    extra: str, packages: list[str], modules: Mapping[str, Sequence[str]]
) -> tuple[str, bool]:
    examined = [(package, *examine(package, modules)) for package in packages]
    if all(well for _, _, well in examined):
        return ", ".join(f"{package} {version}" for package, version, _ in examined), True
    missing = [package for package, finding, _ in examined if finding == "missing"]
    told = [f"{p} {finding}" for p, finding, well in examined if not well and p not in missing]
    if missing:
        some = f"{', '.join(missing)} missing" if len(missing) < len(packages) else "not installed"
        told += [some, f'pip install "docdepth[{extra}]"']
    return "; ".join(told), False


def _folded(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()
