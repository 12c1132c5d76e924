"""The table of classes and tracks, from benchmarks/."""

from __future__ import annotations

import pytest

pytest.importorskip("embreex")
pytest.importorskip("motrics")


def test_a_tiny_cell_has_figures_of_labels_and_tracks(tmp_path, capsys):
    import tracks

    arguments = [str(tmp_path / "drives"), "-o", str(tmp_path / "out"), "--scenes", "overtaking"]
    cells = tracks.main([*arguments, "--sensors", "VLP-16", "--frames", "6", "--threads", "1"])
    found = cells["overtaking_VLP-16"]
    assert found["labels"]["da"] > 0
    assert found["tracks"]["kinds"]["all"]["objects"] > 3
    printed = capsys.readouterr().out
    assert "HOTA" in printed
    assert printed.count("overtaking_VLP-16") == 1
    assert (tmp_path / "out" / "seed0" / "overtaking_VLP-16.json").is_file()
