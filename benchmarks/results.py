"""Write the tables of all benchmarks into RESULTS.md: ``python benchmarks/results.py``.

A benchmark that is called with ``--results benchmarks/measured/NAME.json`` stores its tables there,
with the command and the version that made them.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import subprocess
import sys
from collections.abc import Callable, Sequence
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from docdepth.evaluation.tables import Table  # cost.py runs other versions of docdepth

FOLDER = Path(__file__).with_name("measured")
PAGE = Path(__file__).with_name("RESULTS.md")

HEAD = """\
# Results of the benchmarks

<!-- generated: python benchmarks/results.py -->

Each section holds the tables of one benchmark, the command that makes them, and the version that
was measured. [Accuracy](../docs/accuracy.md) explains the figures and says what they mean.
"""


def parser_of(doc: str | None) -> argparse.ArgumentParser:
    """A parser of a benchmark with this docstring, which takes ``--results FILE``."""
    parser = argparse.ArgumentParser(description=(doc or "").splitlines()[0])
    parser.add_argument(
        "--results", type=Path, metavar="FILE", help="store the tables, for RESULTS.md"
    )
    return parser


def script(main: Callable[[], object]) -> None:
    """Run a benchmark; an error of docdepth ends it with its sentence."""
    from docdepth.errors import DocDepthError

    try:
        main()
    except DocDepthError as error:
        sys.exit(str(error))


def publish(tables: Sequence[Table], file: Path | None) -> None:
    """Print tables as Markdown, and store them with the command that this process was given."""
    print("\n".join(table.markdown() for table in tables), flush=True)
    if file is None:
        return
    from docdepth._core import __version__

    words = [word for word in sys.argv[1:] if word != "--results" and word != str(file)]
    script = f"benchmarks/{Path(sys.argv[0]).name}"
    content = {
        "title": tables[0].title,
        "commands": [shlex.join(["python", script, *words])],
        "measured": f"version {__version__} at {_commit()}, {date.today()}, {os.cpu_count()} cores",
        "tables": [vars(table) for table in tables],
    }
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def _commit() -> str:
    command = ["git", "describe", "--always", "--dirty"]
    told = subprocess.run(command, cwd=FOLDER.parent, capture_output=True, text=True, check=False)
    return told.stdout.strip() or "an unknown commit"


def page() -> str:
    """The whole page as Markdown."""
    sections = [HEAD]
    for file in sorted(FOLDER.glob("*.json")):
        content = json.loads(file.read_text(encoding="utf-8"))
        sections.append(f"## {content['title']}\n\nMeasured: {content['measured']}.\n")
        sections.append("\n".join(["```", *content["commands"], "```\n"]))
        sections += [_table(table, content["title"]) for table in content["tables"]]
    return "\n".join(sections)


def _table(stored: dict[str, object], title: str) -> str:
    from docdepth.evaluation.tables import Table

    table = Table(**stored)  # type: ignore[arg-type]
    text = table.markdown()
    return text.partition("\n\n")[2] if table.title == title else text


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__.splitlines()[0]).parse_args()
    PAGE.write_text(page(), encoding="utf-8")
