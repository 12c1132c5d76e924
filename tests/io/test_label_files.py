"""Files of labels."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from docdepth.errors import DatasetError
from docdepth.io.labels import read_classes, read_labels, read_truth


def test_float32_is_not_taken_for_instances_of_no_class(tmp_path: Path) -> None:
    file, classes = tmp_path / "000000.label", np.array([0, 1, 9, 40, 72, 251, 259])
    for right in (classes, classes | 17275 << 16, 0 * classes):
        right.astype("<u4").tofile(file)
        np.testing.assert_array_equal(read_labels(file, 7, 0), right)
    classes.astype("<f4").tofile(file)
    with pytest.raises(DatasetError, match=r"frame 0\) holds float32 numbers"):
        read_labels(file, 7, 0)


@pytest.mark.parametrize(
    ("name", "values", "told"),
    [
        ("a.label", [9, 10, 17], "the class 17, which SemanticKITTI does not have"),  # train ids
        ("a.label", [0, 4, 22], "the class 4,"),  # SemanticPOSS
        ("a.label", [24, 26, 31], "the class 24,"),  # nuScenes lidarseg
        ("a.npy", [40, 10, 252], "classes as SemanticKITTI's .252"),
        ("a.npy", [-1, 50, 100], "the class -1"),
    ],
)
def test_labels_of_another_numbering(
    tmp_path: Path, name: str, values: list[int], told: str
) -> None:
    if name == "a.label":
        np.array(values, "<u4").tofile(tmp_path / name)
    else:
        np.save(tmp_path / name, np.array(values))
    read = read_truth if name == "a.label" else read_classes
    with pytest.raises(DatasetError, match=told):
        read(tmp_path / name, 3, 0)


def test_classes_of_arrays(tmp_path: Path) -> None:
    for values, classes in (
        ([0, 50, 100], [0, 50, 100]),
        ([0, 60, 103], [0, 50, 100]),  # numbers of their own
        ([True, False, True], [100, 50, 100]),
    ):
        np.save(tmp_path / "a.npy", np.array(values))
        assert read_classes(tmp_path / "a.npy", 3, 0)[0].tolist() == classes
