"""Odometry as users have it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from docdepth.odometry import first_motion


@pytest.fixture(scope="module", autouse=True)
def whole_search() -> Iterator[None]:
    """Seek first motions in all directions and steps, as no other tests do."""
    with pytest.MonkeyPatch.context() as patch:
        directions = np.radians(np.arange(-180, 180, 10)).tolist()
        patch.setattr(first_motion, "_DIRECTIONS", directions)
        patch.setattr(first_motion, "_SPEEDS", np.arange(0, 5.1, 0.25).tolist())
        yield
