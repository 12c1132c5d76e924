"""Odometry as users have it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from docdepth.odometry import first_motion


@pytest.fixture(scope="module", autouse=True)
def all_directions() -> Iterator[None]:
    """Seek first motions in all directions, as no other tests do."""
    with pytest.MonkeyPatch.context() as patch:
        directions = np.radians(np.arange(-180, 180, 10)).tolist()
        patch.setattr(first_motion, "_DIRECTIONS", directions)
        yield
