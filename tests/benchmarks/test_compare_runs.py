"""Runs are compared bit for bit, from benchmarks/."""

import shutil

import numpy as np
import pytest
from compare_runs import main


def test_every_result_is_compared(finished, tmp_path, capsys: pytest.CaptureFixture[str]) -> None:
    run, other = finished[0], tmp_path / "other"
    shutil.copytree(run, other)
    assert main([str(run), str(other)]) == 0
    assert "0 differ" in capsys.readouterr().out
    classes = other / "classes" / "frame_000001.npy"
    rows = np.load(classes)
    rows["classid"][0] += 1
    np.save(classes, rows)
    label = sorted((other / "labels").iterdir())[0]
    label.write_bytes(label.read_bytes()[:-4] + b"\0\0\0\0")
    depth = sorted((other / "depth").glob("*.png"))[0]
    depth.unlink()
    assert main([str(run), str(other)]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].endswith("3 differ")
    assert f"depth/{depth.name}" in lines
    assert "classes/frame_000001.npy" in lines
    assert f"labels/{label.name}" in lines
