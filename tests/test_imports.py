"""Imports point in one direction, between modules and between packages."""

import ast
import re
from graphlib import TopologicalSorter
from pathlib import Path

import docdepth

PACKAGE = Path(docdepth.__file__).parent


def _imports() -> dict[str, set[str]]:
    """What each module imports of the package, inside functions and for types too."""
    names = {}
    for path in PACKAGE.rglob("*.py"):
        parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
        names[".".join(part for part in parts if part != "__init__")] = path
    found = {}
    for module, path in names.items():
        wanted: set[str] = set()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                wanted |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                wanted |= {f"{node.module}.{alias.name}" for alias in node.names}
        wanted |= {name.rpartition(".")[0] for name in wanted - names.keys()}
        found[module] = (wanted & names.keys()) - {module, "docdepth"}
    return found


def test_no_module_imports_itself_by_way_of_others() -> None:
    TopologicalSorter(_imports()).prepare()


def test_packages_import_only_packages_above_them_on_the_page_of_architecture() -> None:
    page = (Path(__file__).parents[1] / "docs" / "architecture.md").read_text(encoding="utf-8")
    rows = [line.split("|")[1] for line in page.splitlines() if line.startswith("| `")]
    order = [name for row in rows for name in re.findall(r"`(\w+)`", row)]
    tops = {path.stem for path in PACKAGE.iterdir() if path.suffix == ".py" or path.is_dir()}
    assert set(order) == {name for name in tops if not name.startswith(("__", "_core"))}
    for module, imported in _imports().items():
        for other in imported:
            one, two = (f"{name}.".split(".")[1] for name in (module, other))
            if one in order and one != two:
                assert order.index(two) < order.index(one), f"{module} imports {other}"
