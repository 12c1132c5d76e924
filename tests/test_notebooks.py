"""The cells of the notebooks run, one after the other, and their pictures are kept."""

from __future__ import annotations

import json
import re
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import docdepth

NOTEBOOKS = Path(__file__).parent.parent / "notebooks"

pytest.importorskip("embreex")
pytest.importorskip("matplotlib").use("Agg")
plt = pytest.importorskip("matplotlib.pyplot")


def cells_of(path: Path) -> list[dict[str, Any]]:
    """The code cells."""
    return [c for c in json.loads(path.read_text())["cells"] if c["cell_type"] == "code"]


def run_notebook(name: str, folder: Path) -> dict[str, object]:
    """The names that a notebook defines; its drives and runs lie in the folder."""
    space: dict[str, object] = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tempfile, "tempdir", str(folder))
        for cell in cells_of(NOTEBOOKS / f"{name}.ipynb"):
            exec("".join(cell["source"]), space)
            plt.close("all")
    return space


@pytest.mark.slow
def test_depth_of_a_drive_is_right(tmp_path: Path) -> None:
    names = run_notebook("your_drive_to_depth", tmp_path)
    errors = names["errors"]
    assert errors.abs_rel < 1
    assert errors.delta1 > 99
    assert names["result"].density_on_surfaces > 60
    assert names["moving"].sum() > 1000
    assert names["points"].shape[1] == 3


@pytest.mark.nightly
def test_labels_of_a_network_are_drawn_and_judged(tmp_path: Path) -> None:
    names = run_notebook("labels_of_your_network", tmp_path)
    theirs, ours = names["found"].values()
    assert theirs.precision == 1
    assert 0.65 < theirs.iou < 0.75  # as many as it misses
    assert ours.iou > 0.95
    assert (np.abs(names["ratio"]) > 0.05).sum() > 1000


@pytest.mark.nightly
def test_occupancy_of_a_drive(tmp_path: Path) -> None:
    names = run_notebook("occupancy", tmp_path)
    grid, occupied = names["grid"], names["occupied"]
    assert 0.01 < occupied.mean() < grid.mask_lidar.mean() < 1
    assert len(np.unique(grid.instance)) > 2


@pytest.mark.nightly
def test_a_network_learns_the_depth_of_a_run(tmp_path: Path) -> None:
    pytest.importorskip("torch")
    names = run_notebook("train_on_it", tmp_path)
    assert names["abs_rel"] < min(0.3, 0.8 * names["guess"])
    losses = names["losses"]
    assert np.mean(losses[-10:]) < 0.2 * np.mean(losses[:5])


@pytest.mark.nightly
def test_votes_find_the_object_and_need_time(tmp_path: Path) -> None:
    names = run_notebook("votes_of_one_object", tmp_path)
    mine, votes = names["mine"], names["votes"]
    assert mine.sum() > 1000
    assert votes.dynamic[mine].mean() > votes.static[mine].mean()
    others = names["near"] & ~mine
    assert votes.dynamic[others].mean() < 0.1 * votes.static[others].mean()
    found, shares = names["found"], list(names["shares"].values())
    assert found["points"] < found["tracks"] > 0.95
    assert shares[0] < shares[-1]


@pytest.mark.nightly
def test_held_out_sweeps_tell_that_poses_are_damaged(tmp_path: Path) -> None:
    names = run_notebook("held_out", tmp_path)
    before, after = names["before"].all, names["after"].all
    assert before.mae < 0.5
    assert after.mae > 1.5 * before.mae


def test_every_notebook_is_run_and_listed() -> None:
    here = {path.stem for path in NOTEBOOKS.glob("*.ipynb")}
    page = (NOTEBOOKS / "README.md").read_text(encoding="utf-8")
    source = Path(__file__).read_text(encoding="utf-8")
    assert here == set(re.findall(r"\((\w+)\.ipynb\)", page))
    assert here == set(re.findall(r'run_notebook\("(\w+)",', source))


@pytest.mark.parametrize("path", sorted(NOTEBOOKS.glob("*.ipynb")), ids=lambda path: path.stem)
def test_a_notebook_keeps_what_it_shows(path: Path) -> None:
    """Its pictures are in the file, none is of an error, and no place of one machine is named."""
    outputs = [output for cell in cells_of(path) for output in cell["outputs"]]
    pictures = [output for output in outputs if "image/jpeg" in output.get("data", {})]
    assert pictures
    kinds = {output["output_type"] for output in outputs}
    assert kinds <= {"display_data", "execute_result", "stream"}
    assert not re.search(r"/tmp/|/home/|stderr", json.dumps(outputs))
    assert path.stat().st_size < 1_000_000


@pytest.mark.parametrize("path", sorted(NOTEBOOKS.glob("*.ipynb")), ids=lambda path: path.stem)
def test_a_notebook_uses_names_of_the_page_of_python(path: Path) -> None:
    page = (NOTEBOOKS.parent / "docs" / "python.md").read_text(encoding="utf-8")
    source = "\n".join("".join(cell["source"]) for cell in cells_of(path))
    for module, names in re.findall(r"^from (docdepth[.\w]*) import (.+)$", source, re.M):
        for name in names.split(", "):
            assert f"{module}.{name}(" in page or (f"`{module}`" in page), f"{module}.{name}"
    for name in re.findall(r"\bdocdepth\.(\w+)", source):
        assert hasattr(docdepth, name) or f"docdepth.{name}" in page, name
