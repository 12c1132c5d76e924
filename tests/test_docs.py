"""Commands, options, parameters and snippets of the documentation are those of the code."""

from __future__ import annotations

import importlib
import importlib.util
import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer

import docdepth
from docdepth.cli import app
from docdepth.config import Parameters
from docdepth.datasets import format_names, open_dataset

ROOT = Path(__file__).parent.parent
README = ROOT / "README.md"
DOCS = sorted((ROOT / "docs").rglob("*.md"))
PAGES = [
    README,
    ROOT / "CONTRIBUTING.md",
    ROOT / "SECURITY.md",
    ROOT / "notebooks" / "README.md",
    *DOCS,
]

_FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_LINK = re.compile(r"!?\[[^]]*\]\(([^)\s]+)\)")
_CODE = re.compile(r"`([^`\n]+)`")


def _prose(page: Path) -> str:
    """A page without its fenced blocks, its lines joined where they wrap."""
    return _FENCE.sub("", page.read_text(encoding="utf-8")).replace("\n", " ")


def _blocks(page: Path, *languages: str) -> list[str]:
    found = _FENCE.findall(page.read_text(encoding="utf-8"))
    return [text for language, text in found if language in languages]


def _command_lines(page: Path) -> Iterator[list[str]]:
    """Words of each shell command of a page, fenced or inline."""
    lines = [line for block in _blocks(page, "", "bash") for line in block.splitlines()]
    for line in lines + _CODE.findall(_prose(page)):
        if line.startswith(("docdepth ", "python benchmarks/", "python docs/", "python examples/")):
            yield shlex.split(line, comments=True)


def test_relative_links_resolve() -> None:
    for page, link in ((p, link) for p in PAGES for link in _LINK.findall(_prose(p))):
        target, _, anchor = link.partition("#")
        if link.startswith("http"):
            continue
        file = (page.parent / target).resolve() if target else page
        assert file.exists(), f"{page.name} links to {target}"
        if anchor:
            assert anchor in _anchors(file), f"{page.name} links to {link}"


def _anchors(page: Path) -> set[str]:
    titles = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", title.lower()).strip().replace(" ", "-") for title in titles}


def test_every_format_stands_on_a_page() -> None:
    told = "".join((ROOT / "docs" / page).read_text() for page in ("recordings.md", "datasets.md"))
    assert [name for name in format_names() if f"`{name}`" not in told] == []


def test_commands_and_options_exist() -> None:
    root = typer.main.get_command(app)
    for page, (program, *words) in ((p, line) for p in PAGES for line in _command_lines(p)):
        line = shlex.join([program, *words])
        if program == "python":
            known = _options_of_script(ROOT / words[0])
        else:
            command = _command(root, words)
            assert command is not None, f"{page.name}: no such verb in {line!r}"
            known = {name for parameter in command.params for name in parameter.opts}
        options = {word.partition("=")[0] for word in words if re.match("--[a-z]", word)}
        assert options <= known, f"{page.name}: {options - known} in {line!r}"


def _options_of_script(path: Path) -> set[str]:
    """Options in the source of a script and of the modules beside it that it imports."""
    source = path.read_text(encoding="utf-8")
    options = set(re.findall(r'"(--[\w-]+)"', source))
    for module in re.findall(r"^from (\w+) import", source, re.MULTILINE):
        if (beside := path.with_name(f"{module}.py")).is_file():
            options |= _options_of_script(beside)
    return options


def _command(group: Any, words: list[str]) -> Any:
    """The command that the first words name; the group itself if an option comes first."""
    verbs = getattr(group, "commands", None)
    if verbs is None or not words or words[0].startswith("-"):
        return group
    return _command(verbs[words[0]], words[1:]) if words[0] in verbs else None


def test_options_in_the_text_exist() -> None:
    def every(command: Any) -> Iterator[str]:
        for parameter in command.params:
            yield from parameter.opts
        for child in getattr(command, "commands", {}).values():
            yield from every(child)

    sources = "".join(f.read_text(encoding="utf-8") for f in (ROOT / "benchmarks").glob("*.py"))
    known = {*every(typer.main.get_command(app)), *re.findall(r'"(--[\w-]+)"', sources)}
    for page, code in ((p, code) for p in PAGES for code in _CODE.findall(_prose(p))):
        if code.startswith("--"):
            assert code.split()[0].partition("=")[0] in known, f"{page.name}: {code}"


def test_parameters_in_the_text_exist() -> None:
    known = {
        f"{stage}.{name}"
        for stage, group in Parameters()
        if hasattr(group, "model_dump")
        for name in group.model_dump()
    }
    stages = "|".join(sorted({name.partition(".")[0] for name in known}))
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        named = re.findall(rf"(?:`|--set |--vary )((?:{stages})\.\w+)(?:`|=)", text)
        assert set(named) <= known, page.name


def test_page_of_parameters_is_current() -> None:
    spec = importlib.util.spec_from_file_location("parameters", ROOT / "docs" / "parameters.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert (ROOT / "docs" / "parameters.md").read_text(encoding="utf-8") == module.page(), (
        "docs/parameters.md is out of date: python docs/parameters.py > docs/parameters.md"
    )


def test_names_of_the_method_are_in_the_files_that_it_links_to() -> None:
    page = ROOT / "docs" / "method.md"
    text = " ".join(page.read_text(encoding="utf-8").split())
    found = re.findall(r"((?:`[\w.]+`(?: and )?)+) in \[[\w.]+\]\(([^)]+)\)", text)
    assert len(found) >= 8
    for names, link in found:
        source = (page.parent / link).read_text(encoding="utf-8")
        for name in _CODE.findall(names):
            assert re.search(rf"\b{name.rpartition('.')[2]}\b", source), f"{name} in {link}"


def test_public_names_are_on_the_page_of_python() -> None:
    page = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
    listed = set(re.findall(r"^\| `(\w+)", page, re.MULTILINE))
    assert listed == set(docdepth.__all__) - {"__version__"}


def test_snippets_of_the_readme_run(
    drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The reader's drive is replaced by a synthetic one of five sweeps, and nothing else."""
    monkeypatch.chdir(tmp_path)
    (depth_map,) = _blocks(README, "python")
    arrays, whole_run = _blocks(ROOT / "docs" / "python.md", "python")
    replaced = {
        '"2011_09_26/2011_09_26_drive_0005_sync"': repr(str(drive)),
        '"image_02"': '"image_2"',
        "index=50": "index=2",
    }
    space: dict[str, Any] = {}
    exec(_with(depth_map, replaced), space)
    camera = space["drive"].cameras["image_2"].camera
    assert space["depth"].shape == (camera.height, camera.width)
    assert np.isfinite(space["depth"]).mean() > 0.5

    recording = open_dataset(drive)
    space |= {
        "sweeps": [recording.sweep(i).points for i in range(len(recording))],
        "times_ns": recording.times,
        "poses": recording.poses,
    }
    exec(arrays, space)
    assert [len(d) for d in space["dynamic"]] == [len(s) for s in space["sweeps"]]

    replaced = {**replaced, "[50]": "[2]"}
    del replaced["index=50"]
    exec(_with(whole_run, replaced), space)
    assert space["colors"].shape == (*space["depth"].shape, 3)
    assert len(list((tmp_path / "run" / "depth").glob("*.png"))) == 4


def _with(text: str, replaced: dict[str, str]) -> str:
    for old, new in replaced.items():
        assert old in text, f"the snippet no longer holds {old}"
        text = text.replace(old, new)
    return text


def test_page_of_results_is_current() -> None:
    results = importlib.import_module("results")
    assert results.PAGE.read_text(encoding="utf-8") == results.page(), (
        "benchmarks/RESULTS.md is out of date: python benchmarks/results.py"
    )
