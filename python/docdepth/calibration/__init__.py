"""Calibration of a camera and a LiDAR from still checkerboards (paper III-A)."""

from __future__ import annotations

from importlib.util import find_spec

from docdepth.errors import MissingExtraError

if find_spec("scipy") is None:
    raise MissingExtraError("calibration needs scipy: pip install 'docdepth[calibrate]'")
