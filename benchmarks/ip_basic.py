"""IP-Basic: depth completion by image filters on one sweep, a baseline for the renderer.

Written from the description in Ku, Harakeh and Waslander, "In Defense of Classical Image
Processing: Fast Depth Completion on the CPU" (CRV 2018), with the filters that they found best: a
diamond for the first dilation, 7 x 7 pixels for small holes, 31 x 31 for large ones, and median and
Gaussian blur at the end.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

_DIAMOND = np.array(
    [
        (0, 0, 1, 0, 0),
        (0, 1, 1, 1, 0),
        (1, 1, 1, 1, 1),
        (0, 1, 1, 1, 0),
        (0, 0, 1, 0, 0),
    ],
    np.uint8,
)
# Gap between the inverted depth of the farthest pixel and that of empty pixels, 0 [m].
_BUFFER = 20.0


def ip_basic(sparse: NDArray[np.float32], max_depth: float = 80.0) -> NDArray[np.float32]:
    """Complete a depth map.

    Parameters
    ----------
    sparse : ndarray of float32, shape (h, w)
        Metres; NaN = none.
    max_depth : float
        Farther pixels count as empty [m]; KITTI's 80 m in their paper.

    Returns
    -------
    ndarray of float32, shape (h, w)
        Metres; NaN only where no filter reaches.
    """
    # Inverted, so that dilation keeps the smaller depth; 0 is empty.
    with np.errstate(invalid="ignore"):
        known = sparse <= max_depth
    depth = np.where(known, max_depth + _BUFFER - sparse, 0).astype(np.float32)
    depth = cv2.dilate(depth, _DIAMOND)
    depth = cv2.morphologyEx(depth, cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))
    depth = _fill(depth, 7)
    _extend_to_top(depth)
    depth = _fill(depth, 31)
    depth = cv2.medianBlur(depth, 5)
    blurred = cv2.GaussianBlur(depth, (5, 5), 0)
    depth = np.where(depth > 0, blurred, 0)
    return np.where(depth > 0, max_depth + _BUFFER - depth, np.nan).astype(np.float32)


def _fill(depth: NDArray[np.float32], size: int) -> NDArray[np.float32]:
    """Fill empty pixels with the smallest depth of a square window."""
    dilated = cv2.dilate(depth, np.ones((size, size), np.uint8))
    return np.where(depth > 0, depth, dilated)


def _extend_to_top(depth: NDArray[np.float32]) -> None:
    """Extend the topmost depth of each column to the top of the image: trees, poles, houses."""
    known = depth > 0
    top = np.where(known.any(axis=0), known.argmax(axis=0), 0)
    above = np.arange(len(depth))[:, None] < top
    depth[above] = np.broadcast_to(depth[top, np.arange(depth.shape[1])], depth.shape)[above]
