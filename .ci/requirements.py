"""Print the packages that an extra of pyproject.toml needs: ``requirements.py EXTRA``."""

import re
import sys
from collections.abc import Iterator
from pathlib import Path

try:
    import tomllib
except ModuleNotFoundError:  # Python 3.10
    from pip._vendor import tomli as tomllib

PROJECT = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text())["project"]


def needed(extra: str) -> Iterator[str]:
    """What the extra names, and the extras of docdepth that it names."""
    for requirement in PROJECT["optional-dependencies"][extra]:
        if own := re.fullmatch(r"docdepth\[(.*)\]", requirement):
            for name in own[1].split(","):
                yield from needed(name)
        else:
            yield requirement


sys.stdout.write("\n".join(dict.fromkeys([*PROJECT["dependencies"], *needed(sys.argv[1])])) + "\n")
