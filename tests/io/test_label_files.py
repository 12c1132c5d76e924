"""Files of labels."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from docdepth.errors import DatasetError
from docdepth.io.labels import read_labels


def test_float32_is_not_taken_for_instances_of_no_class(tmp_path: Path) -> None:
    file, classes = tmp_path / "000000.label", np.array([0, 1, 9, 40, 72, 251, 259])
    for right in (classes, classes | 17275 << 16, 0 * classes):
        right.astype("<u4").tofile(file)
        np.testing.assert_array_equal(read_labels(file, 7, 0), right)
    classes.astype("<f4").tofile(file)
    with pytest.raises(DatasetError, match=r"frame 0\) holds float32 numbers"):
        read_labels(file, 7, 0)
