"""Count how the house is built: ``python tests/structure.py [CHECKOUT ...]``.

A room is a package below ``python/docdepth`` or a module beside them. An arrow is one room that
imports another. A room's floor is one above the highest room that it imports. Lines of code are
lines without docstrings, comments and blanks.
"""

from __future__ import annotations

import ast
import io
import re
import sys
import tokenize
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

BLOCK = 6
"""Lines of a block that counts as duplicated."""

_NO_FUNCTION = re.compile(
    r"(template\s*<[^>]*>\s*)?(if|for|while|switch|catch|do|else|struct|class|enum|union)\b"
    r"|.*\bnamespace\b",
    re.S,
)


@dataclass(frozen=True)
class Function:
    """A function of either language and its number of lines of code."""

    lines: int
    place: str
    name: str


@dataclass(frozen=True)
class House:
    """The sources of one checkout."""

    root: Path

    @property
    def package(self) -> Path:
        return self.root / "python" / "docdepth"

    @cached_property
    def python(self) -> list[Path]:
        return sorted(self.package.rglob("*.py"))

    @cached_property
    def cpp(self) -> list[Path]:
        return sorted([*self.root.glob("cpp/**/*.cpp"), *self.root.glob("cpp/**/*.hpp")])

    def modules_at_the_top(self) -> list[str]:
        """Python files that lie directly in the package."""
        return sorted(path.name for path in self.package.glob("*.py"))

    def arrows(self) -> set[tuple[str, str]]:
        """Pairs of rooms: the first imports the second. Imports inside functions count too."""
        found = set()
        for path in self.python:
            room = self._room(path.relative_to(self.package).parts)
            for name in _imports(path):
                other = self._room_of_import(name)
                if other and room and other != room:
                    found.add((room, other))
        return found

    def imports(self) -> dict[str, set[str]]:
        """What each module imports of the package, inside functions and for types, too.

        The package itself is left out: it imports nothing before someone asks.
        """
        names = {_module(path, self.package): path for path in self.python}
        found = {}
        for module, path in names.items():
            wanted = set(_imports(path))
            wanted |= {name.rpartition(".")[0] for name in wanted - names.keys()}
            found[module] = (wanted & names.keys()) - {module, self.package.name}
        return found

    def rooms(self) -> set[str]:
        rooms = {self._room(path.relative_to(self.package).parts) for path in self.python}
        return rooms - {""}

    def floors(self) -> dict[str, int]:
        """Floor of each room, from 1.

        Raises
        ------
        ValueError
            Rooms import each other in a circle.
        """
        below = defaultdict(set)
        for room, other in self.arrows():
            below[room].add(other)
        floors: dict[str, int] = {}

        def floor(room: str, above: tuple[str, ...]) -> int:
            if room in above:
                raise ValueError(f"a cycle of imports: {' -> '.join([*above, room])}")
            if room not in floors:
                floors[room] = 1 + max((floor(b, (*above, room)) for b in below[room]), default=0)
            return floors[room]

        for room in self.rooms():
            floor(room, ())
        return floors

    def functions(self) -> list[Function]:
        """Every function of both languages, the longest first."""
        found = [f for path in self.python for f in _python_functions(path, self.root)]
        found += [f for path in self.cpp for f in _cpp_functions(path, self.root)]
        return sorted(found, key=lambda f: -f.lines)

    def public_fields(self) -> list[str]:
        """Parameters that a user can set: fields of the models in ``config.py``."""
        tree = ast.parse((self.package / "config.py").read_text())
        return [
            f"{model.name}.{field.target.id}"
            for model in tree.body
            if isinstance(model, ast.ClassDef)
            for field in model.body
            if isinstance(field, ast.AnnAssign)
            and isinstance(field.value, ast.Call)
            and isinstance(field.value.func, ast.Name)
            and field.value.func.id == "Field"
            and isinstance(field.target, ast.Name)
        ]

    def duplicated_blocks(self) -> list[tuple[str, str]]:
        """Where a block of six lines of code or more stands again: its place, and the first one."""
        first: dict[tuple[str, ...], str] = {}
        found = []
        for path in [*self.python, *self.cpp]:
            lines = list(_significant(path))
            inside = False
            for k in range(len(lines) - BLOCK + 1):
                block = tuple(text for _, text in lines[k : k + BLOCK])
                place = f"{path.relative_to(self.root)}:{lines[k][0]}"
                known = first.setdefault(block, place)
                if known != place and not inside:
                    found.append((place, known))
                inside = known != place
        return found

    def _room(self, parts: tuple[str, ...]) -> str:
        top = parts[0].removesuffix(".py")
        return "" if top in ("__init__", "__main__") else top

    def _room_of_import(self, name: str) -> str | None:
        parts = name.split(".")
        if parts[0] != "docdepth" or len(parts) < 2:
            return None
        there = self.package / parts[1]
        return parts[1] if there.is_dir() or there.with_suffix(".py").is_file() else None


def _module(path: Path, package: Path) -> str:
    return ".".join(path.relative_to(package.parent).with_suffix("").parts).removesuffix(
        ".__init__"
    )


def _imports(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def _code_lines(source: str) -> set[int]:
    """Numbers of lines that hold code: no comment, no docstring."""
    lines: set[int] = set()
    skipped = (tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT)
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type not in skipped and token.type != tokenize.ENDMARKER:
            lines.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(ast.parse(source)):
        text = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        if text and isinstance(node.value.value, str):
            lines.difference_update(range(node.lineno, (node.end_lineno or 0) + 1))
    return lines


def _python_functions(path: Path, root: Path) -> Iterator[Function]:
    source = path.read_text()
    code = _code_lines(source)
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            length = len(code & set(range(node.lineno, (node.end_lineno or 0) + 1)))
            yield Function(length, f"{path.relative_to(root)}:{node.lineno}", node.name)


def _without_comments(source: str) -> str:
    """C++ without comments, and strings emptied; lines stay where they are."""

    def blank(match: re.Match[str]) -> str:
        text = match.group(0)
        return '""' if text[0] == '"' else "''" if text[0] == "'" else "\n" * text.count("\n")

    pattern = r'R"\((?:.|\n)*?\)"|"(?:\\.|[^"\\\n])*"|\'(?:\\.|[^\'\\\n])+\'|//[^\n]*|/\*.*?\*/'
    return re.sub(pattern, blank, source, flags=re.S)


def _cpp_functions(path: Path, root: Path) -> Iterator[Function]:
    """Blocks whose head looks like that of a function; lambdas belong to theirs."""
    source = _without_comments(path.read_text())
    stack: list[tuple[str, int] | None] = []
    head = start = 0
    for k, character in enumerate(source):
        if character == "{":
            text = source[head:k].strip()
            inside = any(entry is not None for entry in stack)
            is_function = "(" in text and not _NO_FUNCTION.match(text) and not inside
            name = re.search(r"([\w:~]+)\s*\(", text)
            start = source[:k].count("\n") + 1
            stack.append((name.group(1), start) if is_function and name else None)
            head = k + 1
        elif character == "}":
            entry = stack.pop() if stack else None
            if entry is not None:
                end = source[:k].count("\n") + 1
                body = source.splitlines()[entry[1] - 1 : end]
                length = sum(bool(line.strip()) for line in body)
                yield Function(length, f"{path.relative_to(root)}:{entry[1]}", entry[0])
            head = k + 1
        elif character == ";":
            head = k + 1


def _significant(path: Path) -> Iterator[tuple[int, str]]:
    """Lines of code that say something: no imports, no lone punctuation."""
    source = path.read_text()
    if path.suffix == ".py":
        code = _code_lines(source)
        lines = [(n, line) for n, line in enumerate(source.splitlines(), 1) if n in code]
    else:
        lines = list(enumerate(_without_comments(source).splitlines(), 1))
    for number, line in lines:
        text = " ".join(line.split())
        if re.search(r"\w", text) and not re.match(r"(from|import|#include|using)\b", text):
            yield number, text


def report(house: House) -> str:
    """All counts as text."""
    floors = house.floors()
    packages = sorted(p.parent.name for p in house.package.glob("*/__init__.py"))
    lines = [
        f"{house.root}",
        f"modules at the top: {len(house.modules_at_the_top())}",
        f"packages: {len(packages)} ({', '.join(packages)})",
        f"rooms: {len(floors)}, on {max(floors.values())} floors, {len(house.arrows())} arrows",
        f"public fields: {len(house.public_fields())}",
        f"duplicated blocks of {BLOCK} lines: {len(house.duplicated_blocks())}",
        "longest functions, lines of code:",
        *(f"  {f.lines:4} {f.name} ({f.place})" for f in house.functions()[:10]),
    ]
    levels = Counter(floors.values())
    lines.append("rooms a floor: " + ", ".join(f"{k}: {levels[k]}" for k in sorted(levels)))
    return "\n".join(lines)


if __name__ == "__main__":
    for checkout in sys.argv[1:] or [str(Path(__file__).resolve().parents[1])]:
        print(report(House(Path(checkout))))
