"""Images out of bytes that others may have written or damaged."""

from __future__ import annotations

import struct
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from docdepth.io.png import SIGNATURE

_MOST_PACKED = 1100  # pixels for a byte of a PNG; deflate packs 1032 bytes into one


def decode_image(content: bytes | NDArray[np.uint8], flags: int) -> NDArray[Any] | None:
    """The image in the content of a file; None if it is not one that OpenCV reads.

    Parameters
    ----------
    content : bytes or ndarray of uint8
    flags : int
        As for ``cv2.imdecode``.
    """
    data = np.frombuffer(content, np.uint8)
    if not len(data) or _claims_too_much(data):
        return None
    try:
        image = cv2.imdecode(data, flags)
    except cv2.error:
        return None
    return None if image is None else np.asarray(image)


def _claims_too_much(data: NDArray[np.uint8]) -> bool:
    """Whether a PNG tells of more pixels, or of longer chunks, than its bytes can hold.

    OpenCV takes memory for both before it reads them.
    """
    if data[:8].tobytes() != SIGNATURE or len(data) < 24:
        return False
    width, height = struct.unpack(">II", data[16:24].tobytes())
    if width * height > _MOST_PACKED * len(data):
        return True
    begin = len(SIGNATURE)
    while begin + 8 <= len(data):
        length, kind = struct.unpack(">I4s", data[begin : begin + 8].tobytes())
        begin += length + 12  # with length, kind and checksum
        if begin > len(data):
            return True
        if kind == b"IEND":
            break
    return False
