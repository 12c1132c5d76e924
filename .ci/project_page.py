"""Prepare the page that a package registry shows: ``project_page.py ADDRESS REVISION``.

README's links and pictures become absolute, and the project's metadata names the repository. Only
a release knows both address and revision, so the workflow runs this before it builds.
"""

import re
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]


def absolute(text: str, address: str, revision: str) -> str:
    """Markdown whose relative links lead into the repository, and pictures to their bytes."""

    def link(found: re.Match[str]) -> str:
        view = "raw" if found[1].startswith("!") else "blob"
        return f"{found[1]}({address}/{view}/{revision}/{found[2]})"

    return re.sub(r"(!?\[[^]]*\])\((?!\w+:|#)([^)\s]+)\)", link, text)


def with_addresses(text: str, address: str) -> str:
    """pyproject.toml whose ``[project.urls]`` name the repository."""
    pages = {"Repository": "", "Issues": "/issues", "Changelog": "/blob/main/CHANGELOG.md"}
    lines = "".join(f'{name} = "{address}{page}"\n' for name, page in pages.items())
    return re.sub(r"(?m)^(\[project\.urls\].*\n)", rf"\1{lines}", text)


if __name__ == "__main__":
    address, revision = sys.argv[1:]
    readme, project = ROOT / "README.md", ROOT / "pyproject.toml"
    readme.write_text(absolute(readme.read_text("utf-8"), address, revision), "utf-8")
    project.write_text(with_addresses(project.read_text("utf-8"), address), "utf-8")
