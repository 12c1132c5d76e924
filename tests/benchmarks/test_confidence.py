"""Calibration of confidence, from benchmarks/confidence.py."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture(autouse=True)
def _benchmarks():
    sys.path.insert(0, str(BENCHMARKS))
    yield
    sys.path.remove(str(BENCHMARKS))


def test_bins_and_fitted_constants_of_made_up_pixels():
    """Pixels that are right as often as their confidence says: the fit finds the constants."""
    pytest.importorskip("embreex")  # the benchmark imports it
    from confidence import fit, joined, reliability

    rng = np.random.default_rng(4)
    n = 200_000
    log_odds, edge = rng.normal(1, 1.5, n), rng.uniform(0, 1, n)
    unseen = (rng.uniform(size=n) < 0.2).astype(np.float32)
    confidence = 1 / (1 + np.exp(-(1.5 + 0.7 * log_odds - 2.0 * edge - 1.2 * unseen)))
    right = rng.uniform(size=n) < confidence
    columns = {"log_odds": log_odds, "edge": edge, "confidence": confidence, "unseen": unseen}
    columns |= {"right": right, "error": 1 - confidence}
    np.testing.assert_allclose(fit([columns, columns]), (1.5, 0.7, 2.0, 1.2), atol=0.05)
    rows = reliability(joined({"a": columns, "b": columns}))
    assert sum(share for share, *_ in rows) == pytest.approx(1)
    for _, promised, kept, error in rows:
        assert abs(promised - kept) < 0.02
        assert error == pytest.approx(1 - promised, abs=0.05)


@pytest.mark.slow
def test_the_benchmark_runs(tmp_path, capsys):
    pytest.importorskip("embreex")
    pytest.importorskip("matplotlib")
    from confidence import main

    arguments = [
        "--scenes",
        "city",
        "--sensors",
        "VLP-16",
        "--frames",
        "12",
        "--images",
        "1",
        "--fit",
    ]
    cells = main([str(tmp_path), "-o", str(tmp_path / "plot.png"), *arguments])
    assert list(cells) == ["city_VLP-16"]
    assert (tmp_path / "plot.png").is_file()
    output = capsys.readouterr().out
    assert "within 5 % of the truth %" in output
    assert "a, b, c, d = " in output
