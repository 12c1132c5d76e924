"""Formats of other packages are found by their entry points."""

from __future__ import annotations

from importlib.metadata import EntryPoint
from pathlib import Path

import pytest
from writers import WRITERS

from docdepth.datasets import Format, format_names, open_dataset, registry
from docdepth.datasets.kitti_raw import KittiRaw
from docdepth.errors import DatasetError


class Other(KittiRaw):
    name = "other"


OTHER = Format("other", "a file drive.other", lambda p: (p / "drive.other").is_file(), Other)
WRONG = Format("another name", "", lambda p: True, KittiRaw)


@pytest.fixture
def bring(monkeypatch: pytest.MonkeyPatch):
    """Entry points as an installed package has them."""

    def install(name: str, value: str) -> None:
        point = EntryPoint(name, value, "docdepth.datasets")
        monkeypatch.setattr(registry, "entry_points", lambda group: [point])

    return install


def test_a_loader_of_another_package(tmp_path: Path, bring) -> None:
    written = WRITERS["kitti_raw"][1](tmp_path)
    (written.path / "drive.other").touch()
    assert open_dataset(written.path).name == "kitti_raw"
    bring("other", "test_registry:OTHER")
    assert format_names()[-1] == "other"
    assert open_dataset(written.path).name == "other", "it comes before docdepth's own"
    assert open_dataset(written.path.parent.parent, format="other").path == written.path


@pytest.mark.parametrize("value", ["nowhere:FORMAT", "test_registry:WRONG", "test_registry:Path"])
def test_a_loader_that_is_none(tmp_path: Path, bring, caplog, value: str) -> None:
    written = WRITERS["kitti_raw"][1](tmp_path)
    bring("other", value)
    assert open_dataset(written.path).name == "kitti_raw"
    assert "the loader other" in caplog.text
    with pytest.raises(DatasetError, match="the loader other"):
        open_dataset(written.path, format="other")


def test_no_package_takes_a_name_of_ours(tmp_path: Path, bring) -> None:
    written = WRITERS["kitti_raw"][1](tmp_path)
    bring("kitti_raw", "nowhere:FORMAT")
    assert open_dataset(written.path).name == "kitti_raw"
    assert len(format_names()) == len(set(format_names()))
