"""The cells of the notebooks run, one after the other."""

from __future__ import annotations

import json
import os
import re
import tempfile
from pathlib import Path

import numpy as np
import pytest

NOTEBOOKS = Path(__file__).parent.parent / "notebooks"

pytest.importorskip("embreex")
pytest.importorskip("matplotlib").use("Agg")
plt = pytest.importorskip("matplotlib.pyplot")


def cells_of(path: Path) -> list[str]:
    """Sources of the code cells."""
    cells = [c for c in json.loads(path.read_text())["cells"] if c["cell_type"] == "code"]
    assert not any(cell["outputs"] for cell in cells), "commit notebooks without outputs"
    return ["".join(cell["source"]) for cell in cells]


def run_notebook(name: str, folder: Path) -> dict[str, object]:
    """The names that a notebook defines; its drives and runs lie in the folder."""
    space: dict[str, object] = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tempfile, "tempdir", str(folder))
        for source in cells_of(NOTEBOOKS / f"{name}.ipynb"):
            exec(source, space)
            plt.close("all")
    return space


@pytest.mark.slow
def test_labels_and_depth_are_those_of_the_drive(tmp_path: Path) -> None:
    names = run_notebook("from_sweeps_to_depth", tmp_path)
    assert np.isfinite(names["maps"]["default"]).mean() > 0.5
    found, moving = names["labels"][names["k"]].classid >= 100, names["moving"]
    assert found.sum() > 1000
    assert (found & moving).sum() > 0.95 * found.sum()
    # Labels of parked cars have an instance in the high 16 bits, so they are larger than 251.
    parked = (names["truth"] & 0xFFFF == 10) & (names["truth"] >> 16 > 0)
    assert parked.sum() > 500
    assert not (parked & moving).any()
    if "geometries" not in names:
        return  # without Open3D
    assert len(names["geometries"]["points"].points) == len(names["points"])
    dense = names["coloured"]["depth"]
    assert len(dense.points) == np.isfinite(names["maps"]["default"]).sum()
    assert np.asarray(dense.colors).std() > 0.05
    picture = names["folder"] / "view.png"
    if picture.is_file():  # Open3D draws where there is a display or EGL
        assert os.path.getsize(picture) > 10_000


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
def test_a_parameter_is_chosen_and_tried_on_another_drive(tmp_path: Path) -> None:
    names = run_notebook("parameters_by_tune", tmp_path)
    assert names["best"].metric("iou") == max(names["scores"]) > min(names["scores"]) + 0.05
    chosen, default = names["checked"]
    assert chosen.settings == names["best"].settings
    assert 0.5 < default.metric("iou") < 1
    splats, triangles = (outcome.metric("all.mae") for outcome in names["drawn"])
    assert triangles < splats


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
