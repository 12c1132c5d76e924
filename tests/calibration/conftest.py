"""Boards and their calibration, made once."""

import pytest
from boards import BOARD, LENS, pairs

from docdepth.calibration import quality
from docdepth.calibration.calibrate import calibrate


@pytest.fixture(scope="session")
def exact_pairs():
    """Eight boards without noise."""
    return pairs()


@pytest.fixture(scope="session")
def calibrated(exact_pairs):
    """Their calibration with K given."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(quality, "_SPLITS", 3)
        return calibrate(BOARD, exact_pairs, (LENS.width, LENS.height), LENS)
