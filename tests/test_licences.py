"""Licences of all that ``pip install docdepth`` brings, one by one; run as a script for the table.

docdepth is Apache-2.0 and is imported into other people's programs, so its core may need permissive
licences only. MPL-2.0 is allowed too: what it asks for stays within the files that it covers.
"""

from __future__ import annotations

import importlib.metadata
import re
import sys
from collections.abc import Callable
from email.message import Message
from pathlib import Path

import pytest

ALLOWED = (
    *("MIT", "BSD", "0BSD", "APACHE", "ISC", "PSF", "PYTHON-2.0"),
    *("ZLIB", "CC0", "UNLICENSE", "MPL-2.0"),
)
# How classifiers and older fields spell these.
SPELLINGS = {
    "PYTHON SOFTWARE FOUNDATION": "PSF",
    "MOZILLA PUBLIC LICENSE 2.0": "MPL-2.0",
    "MPL 2.0": "MPL-2.0",
    "THE UNLICENSE": "UNLICENSE",
}

Metadata = Callable[[str], Message]


def requirements(metadata: Message) -> list[str]:
    """Names of what a distribution needs here, extras left out."""
    needed = []
    for line in metadata.get_all("Requires-Dist") or []:
        requirement, _, marker = line.partition(";")
        if "extra" not in marker and applies(marker):
            needed.append(re.split(r"[\s\[<>=!~(@]", requirement.strip(), maxsplit=1)[0])
    return needed


def applies(marker: str) -> bool:
    """Whether a marker holds here; one that cannot be told is taken to hold."""
    from packaging.markers import InvalidMarker, Marker

    try:
        return not marker.strip() or Marker(marker).evaluate()
    except InvalidMarker:
        return True


def core(metadata: Metadata, start: list[str]) -> dict[str, str]:
    """Licence of everything that is needed, by name."""
    found: dict[str, str] = {}
    waiting = list(start)
    while waiting:
        name = re.sub(r"[-_.]+", "-", waiting.pop()).lower()
        if name not in found:
            about = metadata(name)
            found[name] = licence(about)
            waiting += requirements(about)
    return dict(sorted(found.items()))


def licence(metadata: Message) -> str:
    """What a distribution says of its licence: expression, classifiers, or the old field."""
    if expression := metadata.get("License-Expression"):
        return expression
    classifiers = [c for c in metadata.get_all("Classifier") or [] if c.startswith("License ::")]
    names = [c.rpartition(" :: ")[2] for c in classifiers if c != "License :: OSI Approved"]
    old = (metadata.get("License") or "").strip().partition("\n")[0]
    return "; ".join(names) or old or "unknown"


def is_permissive(text: str) -> bool:
    """Whether each part of a licence is allowed; of alternatives one is enough."""
    text = text.upper()
    for spelling, short in SPELLINGS.items():
        text = text.replace(spelling, short)
    if re.search("GPL|GENERAL PUBLIC", text) and " OR " not in text:
        return False
    alternatives = [part.strip(" ()") for part in re.split(r"\bOR\b", text)]
    return any(
        all(
            re.match(rf"[\s(]*(THE )?({'|'.join(map(re.escape, ALLOWED))})", part)
            for part in re.split(r"\bAND\b|;", alternative)
        )
        for alternative in alternatives
    )


def declared() -> list[str]:
    """The core requirements of docdepth as pyproject.toml has them."""
    text = (Path(__file__).resolve().parents[1] / "pyproject.toml").read_text()
    block = re.search(r"^dependencies = \[(.*?)^\]", text, re.M | re.S)
    assert block is not None
    return [re.split(r"[<>=~\[]", line, maxsplit=1)[0] for line in re.findall(r'"(.+?)"', block[1])]


def table() -> dict[str, str]:
    return core(importlib.metadata.metadata, declared())


def test_the_core_needs_permissive_licences_only() -> None:
    licences = table()
    assert {"numpy", "opencv-python-headless", "small-gicp"} <= licences.keys()
    assert {k: v for k, v in licences.items() if not is_permissive(v)} == {}


def about(requires: list[str] = [], **fields: str) -> Message:  # noqa: B006
    message = Message()
    for name in requires:
        message["Requires-Dist"] = name
    for name, value in fields.items():
        message[name.replace("_", "-")] = value
    return message


def test_a_licence_that_is_not_permissive_is_found_wherever_it_is_needed() -> None:
    gpl = "License :: OSI Approved :: GNU General Public License v3 or later (GPLv3+)"
    packages = {
        "docdepth": about(["numpy>=1.24", "Mesh_Tools", 'open3d; extra == "viz"']),
        "numpy": about(License_Expression="BSD-3-Clause AND MIT"),
        "mesh-tools": about(["plyfile (>=1.0)"], License="MIT"),
        "plyfile": about(License_Expression="GPL-3.0-or-later"),
    }
    licences = core(packages.__getitem__, ["docdepth"])
    assert licences.keys() == {"docdepth", "numpy", "mesh-tools", "plyfile"}
    assert [k for k, v in licences.items() if not is_permissive(v)] == ["docdepth", "plyfile"]
    assert licences["docdepth"] == "unknown"
    assert not is_permissive(licence(about(Classifier=gpl, License="MIT-like")))


@pytest.mark.parametrize(
    ("text", "allowed"),
    [
        ("MIT", True), ("Apache-2.0 OR BSD-3-Clause", True), ("GPL-3.0-only OR MIT", True),
        ("BSD License", True), ("Apache Software License; MIT License", True),
        ("Python Software Foundation License", True), ("MIT AND Python-2.0", True),
        ("Mozilla Public License 2.0 (MPL 2.0)", True), ("The MIT License (MIT)", True),
        ("LGPL-2.1-or-later", False), ("AGPL-3.0", False), ("GPLv3", False), ("GPL", False),
        ("MIT AND GPL-2.0-only", False), ("MIT License; GNU General Public License v2", False),
        ("Other/Proprietary License", False), ("unknown", False), ("", False),
    ],
)  # fmt: skip
def test_what_is_permissive(text: str, allowed: bool) -> None:
    assert is_permissive(text) == allowed


if __name__ == "__main__":
    for name, text in table().items():
        version = importlib.metadata.version(name)
        sys.stdout.write(f"{name:24} {version:14} {'' if is_permissive(text) else '!! '}{text}\n")
