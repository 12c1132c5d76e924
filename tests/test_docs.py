"""The documentation says what is there: links, commands, parameters and snippets."""

from __future__ import annotations

import importlib
import importlib.util
import json
import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer

from docdepth.cli import app
from docdepth.config import Parameters, parameters, parse_settings
from docdepth.datasets import open_dataset
from docdepth.geometry.camera import Camera
from docdepth.geometry.lidar_frame import LidarFrame
from docdepth.geometry.trajectory import Trajectory
from docdepth.render.depth_map import compose_depth
from docdepth.render.render_sweep import RenderSweep
from docdepth.render.view import View

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

pages = pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)


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


@pages
def test_a_page_has_one_title(page: Path) -> None:
    titles = re.findall(r"^# .+", _FENCE.sub("", page.read_text(encoding="utf-8")), re.MULTILINE)
    assert len(titles) == 1


def test_readme_is_short() -> None:
    assert len(README.read_text(encoding="utf-8").splitlines()) <= 90


@pytest.mark.parametrize("page", [*PAGES, ROOT / "CHANGELOG.md"], ids=lambda page: page.name)
def test_relative_links_resolve(page: Path) -> None:
    for link in _LINK.findall(_prose(page)):
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


def test_every_picture_is_used() -> None:
    used = {Path(link).name for page in PAGES for link in _LINK.findall(_prose(page))}
    pictures = {p.name for p in (ROOT / "docs").iterdir() if p.suffix in (".png", ".jpg", ".svg")}
    assert pictures <= used


@pages
def test_commands_and_options_exist(page: Path) -> None:
    root = typer.main.get_command(app)
    for program, *words in _command_lines(page):
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


@pages
def test_options_in_the_text_exist(page: Path) -> None:
    def every(command: Any) -> Iterator[str]:
        for parameter in command.params:
            yield from parameter.opts
        for child in getattr(command, "commands", {}).values():
            yield from every(child)

    sources = "".join(f.read_text(encoding="utf-8") for f in (ROOT / "benchmarks").glob("*.py"))
    known = {*every(typer.main.get_command(app)), *re.findall(r'"(--[\w-]+)"', sources)}
    for code in _CODE.findall(_prose(page)):
        if code.startswith("--"):
            assert code.split()[0].partition("=")[0] in known, f"{page.name}: {code}"


@pages
def test_parameters_in_the_text_exist(page: Path) -> None:
    known = {
        f"{stage}.{name}"
        for stage, group in Parameters()
        if hasattr(group, "model_dump")
        for name in group.model_dump()
    }
    stages = "|".join(sorted({name.partition(".")[0] for name in known}))
    text = page.read_text(encoding="utf-8")
    named = re.findall(rf"(?:`|--set |--vary )((?:{stages})\.\w+)(?:`|=)", text)
    assert set(named) <= known


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
    import docdepth

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

    path = next(iter(replaced))
    exec(_with(whole_run, {path: replaced[path]}), space)
    assert len(list((tmp_path / "run" / "depth").glob("*.png"))) == 4


def _recipe_of_far_scenes() -> tuple[dict[str, Any], float]:
    """Settings and scale of the command in the section on far scenes."""
    text = (ROOT / "docs" / "quickstart.md").read_text(encoding="utf-8")
    section = text.split("## Far scenes")[1].split("\n## ")[0]
    words = shlex.split(_FENCE.findall(section)[0][1])
    settings = [words[k + 1] for k, word in enumerate(words) if word == "--set"]
    return parse_settings(settings), float(words[words.index("--scale") + 1])


@pytest.mark.parametrize("primitive", ["splats", "triangles"])
def test_the_recipe_for_far_scenes_draws_far_sweeps(primitive: Any) -> None:
    """Each sweep, one per 50 m, sees a board of its own 40 m ahead; none hides another."""
    settings, scale = _recipe_of_far_scenes()
    spacing, sweeps = 50.0, 14
    poses = np.repeat(np.eye(4)[None], sweeps, axis=0)
    poses[:, 0, 3] = spacing * np.arange(sweeps)
    trajectory = Trajectory(np.arange(sweeps) * 10**9, poses)
    right, up = np.meshgrid(np.linspace(-0.002, 0.002, 30), np.linspace(-0.002, 0.002, 30))
    camera = Camera(np.array([[15000.0, 0, 60], [0, 15000, 50], [0, 0, 1]]), 1500, 101)
    T_camera_lidar = np.array([[0, -1.0, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])

    def drawn(values: dict[str, Any]) -> set[float]:
        p = parameters("default", {"render.primitive": primitive, **values}).render

        def board(index: int) -> RenderSweep:
            distance = 40.0 + spacing * index
            side = -distance * (right + 100 * index / 15000)  # 100 pixels beside the last board
            points = np.stack([np.full(up.shape, 40.0), side, distance * up], -1).reshape(-1, 3)
            rows = np.arange(len(points), dtype=np.uint32)
            classid = np.full(len(points), 50, np.uint16)
            frame = LidarFrame(points.astype(np.float32), rows, "", len(rows), classid=classid)
            return RenderSweep(frame, p)

        depth = compose_depth(View.at(camera, T_camera_lidar, trajectory, 0), trajectory, board, p)
        return set(np.unique(depth[np.isfinite(depth)].round(-1)).tolist())

    far = drawn(settings)
    assert max(far) > 500, "of the farthest sweeps, some are drawn"
    assert len(far) > 5, "and those on the way"
    assert max(far) * scale < 2**16, "and fits into a PNG"
    for name in ("render.ahead", "render.max_depth"):
        less = {key: value for key, value in settings.items() if key != name}
        assert max(drawn(less)) < 300, f"{name} is needed"


def _with(text: str, replaced: dict[str, str]) -> str:
    for old, new in replaced.items():
        assert old in text, f"the snippet no longer holds {old}"
        text = text.replace(old, new)
    return text


def _rows(text: str) -> Iterator[list[str]]:
    """Cells of the rows of all tables of a text."""
    for line in text.splitlines():
        if line.startswith("| ") and not line.startswith("| ---"):
            yield [cell.strip() for cell in line[1:-1].split("|")]


def _measured(name: str) -> dict[str, list[str]]:
    """Rows of the first table of a benchmark by their names."""
    content = json.loads((ROOT / "benchmarks" / "measured" / f"{name}.json").read_text("utf-8"))
    return {row[0]: row for row in content["tables"][0]["rows"]}


def test_the_short_table_of_accuracy_holds_the_means_of_what_was_measured() -> None:
    page = (ROOT / "docs" / "accuracy.md").read_text(encoding="utf-8")
    short = {row[0]: row[1:] for row in _rows(page.split("\n## ")[1])}
    labels, depth = _measured("labels"), _measured("depth")
    for sensor in ("HDL-64", "OS1-128", "XT-32", "VLP-16", "Avia"):
        cells = [[float(value) for value in cell.split("/")] for cell in labels[sensor][1:6]]
        f1, precision = np.mean(cells, axis=0)
        assert float(short[sensor][0]) == pytest.approx(f1, abs=6e-4)
        assert float(short[sensor][1]) == pytest.approx(precision, abs=6e-4)
        assert float(short[sensor][2]) == float(labels[sensor][6].split(",")[2])
        scenes = ("city", "crossing", "residential")
        rows = [depth[name] for scene in scenes if (name := f"{sensor}, {scene}") in depth]
        if rows:
            wrong = np.mean([float(row[4]) + float(row[5]) for row in rows])
            interior = np.mean([float(row[6].split(",")[0]) for row in rows])
            density = np.mean([float(row[1]) for row in rows])
            assert float(short[sensor][3]) == pytest.approx(wrong, abs=0.006)
            assert float(short[sensor][4]) == pytest.approx(interior, abs=6e-4)
            assert float(short[sensor][5]) == pytest.approx(density, abs=0.06)


def test_page_of_results_is_current() -> None:
    results = importlib.import_module("results")
    assert results.PAGE.read_text(encoding="utf-8") == results.page(), (
        "benchmarks/RESULTS.md is out of date: python benchmarks/results.py"
    )
