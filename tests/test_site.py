"""The site of the documentation is built without a warning."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

import docdepth

ROOT = Path(__file__).parent.parent

for package in ("sphinx", "furo", "myst_parser", "sphinx_copybutton"):
    pytest.importorskip(package)


@pytest.mark.slow
def test_the_site_has_every_page_and_every_public_name(tmp_path: Path) -> None:
    """Sphinx warns of links that lead nowhere, of pages in no chapter and of broken docstrings."""
    site = tmp_path / "site"
    options = ["-q", "-W", "--keep-going", "-d", str(tmp_path / "doctrees"), "-c", "docs"]
    command = [sys.executable, "-m", "sphinx", *options, ".", str(site)]
    built = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert built.returncode == 0, built.stderr[-3000:]

    assert (site / "index.html").is_file()
    for page in (ROOT / "docs").rglob("*.md"):
        assert (site / page.relative_to(ROOT).with_suffix(".html")).is_file(), (
            f"{page.name} is in no chapter"
        )
    described = set(re.findall(r'id="docdepth\.(\w+)"', (site / "docs/python.html").read_text()))
    assert described == set(docdepth.__all__) - {"__version__"}
