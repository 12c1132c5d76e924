"""Dense, metric depth ground truth for camera images from LiDAR recordings (DOC-Depth)."""

import logging

from docdepth._core import __version__

logging.getLogger(__name__).addHandler(logging.NullHandler())

__all__ = ["__version__"]
