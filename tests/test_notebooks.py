"""The cells of the notebooks run, one after the other."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

NOTEBOOKS = sorted((Path(__file__).parent.parent / "notebooks").glob("*.ipynb"))

pytest.importorskip("embreex")
pytest.importorskip("matplotlib").use("Agg")


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook(path: Path) -> None:
    cells = json.loads(path.read_text())["cells"]
    space: dict[str, object] = {}
    for cell in cells:
        if cell["cell_type"] == "code":
            assert not cell["outputs"], "commit notebooks without outputs"
            exec("".join(cell["source"]), space)
    assert np.isfinite(space["maps"]["default"]).mean() > 0.5
    found = space["labels"][space["k"]].classid >= 100
    assert found.sum() > 1000
    assert (found & space["moving"]).sum() > 0.95 * found.sum()
