"""Shared fixtures: real recordings where there are any."""

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def kitti() -> Path:
    """Folder 2011_09_26 of the real recordings, or skip."""
    root = os.environ.get("DOCDEPTH_KITTI_RAW")
    if not root:
        pytest.skip("DOCDEPTH_KITTI_RAW is not set: no real recordings")
    return Path(root) / "2011_09_26"


@pytest.fixture(scope="session")
def drive_0005(kitti: Path) -> Path:
    """City drive with labelled moving points."""
    return kitti / "2011_09_26_drive_0005_sync"


@pytest.fixture(scope="session")
def drive_9001(kitti: Path) -> Path:
    """Drive up to a red light, with images."""
    return kitti / "2011_09_26_drive_9001_sync"
