"""Calibrations are spoilt and said to be, from benchmarks/extrinsics.py."""

from pathlib import Path

import extrinsics
import numpy as np
import pytest


@pytest.mark.parametrize(
    ("way", "text"),
    [
        ("right", "nothing"),
        ("first number is 5", "holds no rotation"),
        ("millimetres", "m apart"),
        ("inverse", "inverse"),
        ("5 m to the side", "m apart"),
    ],
)
def test_what_is_said(drive: Path, way: str, text: str) -> None:
    assert text in extrinsics.said(drive, extrinsics.WAYS[way])
    assert (drive / "calib.txt").is_file()


def test_images_that_lag(drive: Path, tmp_path: Path) -> None:
    copy = extrinsics.spoilt(drive, tmp_path, extrinsics.WAYS["right"], late=2)
    assert len(list((copy / "image_2").glob("*.png"))) == 2
    first = (copy / "image_2" / "000000.png").read_bytes()
    assert first == (drive / "image_2" / "000002.png").read_bytes()


def test_a_raw_calibration() -> None:
    text = "calib_time: x\nR: 1 0 0 0 1 0 0 0 1\nT: 1 2 3\n"
    changed = extrinsics.with_transform(text, extrinsics.moved(x=0.5))
    offset = next(line for line in changed.splitlines() if line.startswith("T:"))
    np.testing.assert_allclose(np.array(offset[2:].split(), float), [1.5, 2, 3])
    assert "calib_time: x" in changed
