"""The site out of the Markdown pages, as they stand in the repository: make docs.

The repository is the source folder, so that a link leads to the same place here and on the site.
Files of code that pages link to become pages themselves.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from pathlib import Path

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.parsers import Parser

import docdepth

ROOT = Path(__file__).parent.parent
CHAPTERS = {
    "Use": (
        *("docs/quickstart", "docs/recordings", "docs/datasets", "docs/calibration"),
        "notebooks/README",
    ),
    "Look up": ("docs/python", "docs/parameters", "docs/formats"),
    "Understand": (
        "docs/method",
        "docs/architecture",
        "docs/accuracy",
        "docs/comparison",
        "benchmarks/RESULTS",
    ),
    "Decisions": (
        "docs/adr/README",
        *(f"docs/adr/{page.stem}" for page in sorted((ROOT / "docs/adr").glob("0*.md"))),
    ),
    "Project": ("CONTRIBUTING", "CHANGELOG", "SECURITY"),
}
PAGES = ["README.md", *(f"{page}.md" for pages in CHAPTERS.values() for page in pages)]
LANGUAGES = {".py": "python", ".cpp": "cpp"}


def linked_code() -> Iterator[str]:
    """Files of code that pages link to, from the root of the repository."""
    for page in PAGES:
        text = (ROOT / page).read_text(encoding="utf-8")
        for link in re.findall(r"\]\(([^)#\s]+)", text):
            file = (ROOT / page).parent / link
            if file.suffix in LANGUAGES:
                yield file.resolve().relative_to(ROOT).as_posix()


project = "docdepth"
author = "The docdepth developers"
project_copyright = author
version = release = docdepth.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_copybutton"]
source_suffix = {".md": "markdown", **dict.fromkeys(LANGUAGES, "code")}
root_doc = "README"
include_patterns = sorted({*PAGES, *linked_code()})
myst_heading_anchors = 3
highlight_language = "bash"  # fences that name no language hold commands
autodoc_typehints = "none"  # docstrings tell types, with shapes and units
autodoc_member_order = "bysource"
napoleon_google_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = False

html_theme = "furo"
html_title = f"docdepth {version}"
html_static_path = html_css_files = ["site.css"]
html_show_sourcelink = False
html_copy_source = False
html_theme_options = {
    "navigation_with_keys": True,
    "light_css_variables": {"code-font-size": "var(--font-size--small--3)"},  # 95 columns
}
toc_object_entries = False  # the tables of names lead to them


class CodeParser(Parser):
    """A file of code as a page."""

    supported = ("code",)

    def parse(self, inputstring: str, document: nodes.document) -> None:
        """Fill the document with the file's path and its text."""
        env = document.settings.env
        path = Path(env.doc2path(env.docname))
        env.metadata[env.docname]["orphan"] = True  # reached by links only
        folder = path.parent.relative_to(ROOT).as_posix()
        section = nodes.section(ids=["code"], names=["code"])
        section += nodes.title("", path.name)
        section += nodes.paragraph("", "", nodes.literal("", folder))
        section += nodes.literal_block(inputstring, inputstring, language=LANGUAGES[path.suffix])
        document += section


def contents() -> Iterator[str]:
    """Tables of contents for the margin, in the words of README."""
    for title, pages in CHAPTERS.items():
        yield "\n".join(["```{toctree}", ":hidden:", f":caption: {title}", "", *pages, "```"])


def reference() -> Iterator[str]:
    """The docstring of every public name, stage by stage as the package lists them."""
    yield "## Reference"
    for name in re.findall(r":(?:func|class):`(\w+)`", docdepth.__doc__ or ""):
        thing = getattr(docdepth, name)
        if not isinstance(thing, type):
            yield f"```{{eval-rst}}\n.. autofunction:: docdepth.{name}\n```"
            continue
        # The docstring of the class tells its fields. What only a library calls has no signature.
        fields = getattr(thing, "__dataclass_fields__", getattr(thing, "_fields", ()))
        members = f"\n   :members:\n   :undoc-members:\n   :exclude-members: {', '.join(fields)}"
        if name in ("Dataset", "Parameters"):
            name += "()"
        options = "" if name == "Parameters()" else members
        yield f"```{{eval-rst}}\n.. autoclass:: docdepth.{name}{options}\n```"


def complete(app: Sphinx, name: str, source: list[str]) -> None:
    """Add to a page what only the site has."""
    if name == root_doc:
        source[0] += "\n" + "\n\n".join(contents())
    if name == "docs/python":
        names = r"^\| `(\w+)([^`]*)`"
        source[0] = re.sub(names, r"| {py:obj}`\1\2 <docdepth.\1>`", source[0], flags=re.MULTILINE)
        source[0] += "\n" + "\n\n".join(reference())


def finish(app: Sphinx, error: Exception | None) -> None:
    """Make README's page the first one."""
    if error is None:
        shutil.copyfile(Path(app.outdir) / "README.html", Path(app.outdir) / "index.html")


def setup(app: Sphinx) -> None:
    """Register what this file adds to Sphinx."""
    app.add_source_parser(CodeParser)
    app.connect("source-read", complete)
    app.connect("build-finished", finish)
