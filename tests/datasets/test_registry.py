"""Formats of other packages are found by their entry points."""

from __future__ import annotations

from importlib.metadata import EntryPoint
from pathlib import Path

import pytest
import yaml
from formats import WRITERS

from docdepth.datasets import Format, format_names, open_dataset, registry
from docdepth.datasets.formats.kitti_raw import KittiRaw
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
    assert open_dataset(written.path.parent.parent, dataset="other").path == written.path


@pytest.mark.parametrize("value", ["nowhere:FORMAT", "test_registry:WRONG", "test_registry:Path"])
def test_a_loader_that_is_none(tmp_path: Path, bring, caplog, value: str) -> None:
    written = WRITERS["kitti_raw"][1](tmp_path)
    bring("other", value)
    assert open_dataset(written.path).name == "kitti_raw"
    assert "the loader other" in caplog.text
    with pytest.raises(DatasetError, match="the loader other"):
        open_dataset(written.path, dataset="other")


def test_no_package_takes_a_name_of_ours(tmp_path: Path, bring) -> None:
    written = WRITERS["kitti_raw"][1](tmp_path)
    bring("kitti_raw", "nowhere:FORMAT")
    assert open_dataset(written.path).name == "kitti_raw"
    assert len(format_names()) == len(set(format_names()))


def test_what_is_packed_is_to_be_unpacked(tmp_path: Path) -> None:
    (tmp_path / "drive.mcap.zstd").touch()
    for path in (tmp_path, tmp_path / "drive.mcap.zstd"):
        with pytest.raises(DatasetError, match=r"drive.mcap.zstd is packed; unpack it"):
            open_dataset(path)


def test_clouds_without_a_description_are_named(tmp_path: Path) -> None:
    (tmp_path / "images").mkdir()
    (tmp_path / "lidar").mkdir()
    (tmp_path / "lidar" / "000000.pcd").touch()
    with pytest.raises(DatasetError, match=r"lidar holds point clouds.*with sweeps: lidar$"):
        open_dataset(tmp_path)


def test_a_folder_named_velodyne_may_be_described(tmp_path: Path) -> None:
    """Many recordings have one that are no sequence of KITTI."""
    written = WRITERS["folder of ply"][1](tmp_path).path
    sweeps = written / "velodyne"
    sweeps.mkdir()
    for file in written.glob("*.ply"):
        file.rename(sweeps / file.name)
    assert open_dataset_fails(written).endswith("with sweeps: velodyne")
    about = yaml.safe_load((written / "docdepth.yaml").read_text())
    (written / "docdepth.yaml").write_text(yaml.safe_dump(about | {"sweeps": "velodyne"}))
    assert open_dataset(written).name == "folder"


def open_dataset_fails(path: Path) -> str:
    with pytest.raises(DatasetError) as caught:
        open_dataset(path)
    return str(caught.value)


def test_a_capture_in_capitals(tmp_path: Path) -> None:
    (tmp_path / "DRIVE.PCAP").touch()
    assert "is no recording that docdepth reads" not in open_dataset_fails(tmp_path / "DRIVE.PCAP")


@pytest.mark.parametrize(("name", "tool"), [("a.osf", "ouster-cli"), ("a.PCAPNG", "editcap")])
def test_captures_of_other_kinds_are_to_be_converted(tmp_path: Path, name: str, tool: str) -> None:
    (tmp_path / name).touch()
    assert f"write one by {tool}" in open_dataset_fails(tmp_path / name)


@pytest.mark.parametrize(
    ("what", "part", "whole"),
    [
        ("nuScenes", "v1.0-mini", ""),
        ("Argoverse 2", "*/sensors/lidar", "adcf7d18*"),
        ("folder of las", "clouds/000000.las", "clouds"),
        ("Waymo", "lidar/*.parquet", ""),
    ],
)
def test_a_part_of_a_recording_tells_which(
    tmp_path: Path, what: str, part: str, whole: str
) -> None:
    WRITERS[what][1](tmp_path)
    (named,) = tmp_path.glob(part)
    above = next(tmp_path.glob(whole)) if whole else tmp_path
    assert open_dataset_fails(named).endswith(f"; name {above}")


def test_waymo_s_first_version(tmp_path: Path) -> None:
    (tmp_path / "a.tfrecord").write_bytes(b"")
    assert "Waymo's version 2" in open_dataset_fails(tmp_path / "a.tfrecord")
