"""Images out of bytes that others may have written or damaged."""

from __future__ import annotations

import struct
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from docdepth.io.png import SIGNATURE

_JPEG, _END = b"\xff\xd8", b"\xff\xd9"
_SCAN = 0xDA  # kind of the segment before the pixels
_FRAMES = {0xC0, 0xC1, 0xC2, 0xC3, 0xC5, 0xC6, 0xC7, 0xC9, 0xCA, 0xCB, 0xCD, 0xCE, 0xCF}
"""Kinds of the segment that tells the size."""
_MOST_PACKED = 1100
"""Pixels for a byte: deflate packs 1032 bytes into one, a JPEG 256 pixels into twelve bits."""


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
    """Whether a PNG or JPEG tells of more pixels, or of longer chunks, than its bytes can hold.

    OpenCV takes memory for both before it reads them, and makes up what is missing of a JPEG.
    """
    content = data.tobytes()
    if content.startswith(SIGNATURE) and len(content) >= 24:
        width, height = struct.unpack(">II", content[16:24])
        return width * height > _MOST_PACKED * len(content) or _has_long_chunk(content)
    if content.startswith(_JPEG):
        found = _size_of_jpeg(content)
        return found is None or found[0] * found[1] > _MOST_PACKED * len(content)
    return False


def _has_long_chunk(content: bytes) -> bool:
    """Whether a chunk of a PNG goes beyond its end."""
    begin = len(SIGNATURE)
    while begin + 8 <= len(content):
        length, kind = struct.unpack(">I4s", content[begin : begin + 8])
        begin += length + 12  # with length, kind and checksum
        if begin > len(content):
            return True
        if kind == b"IEND":
            break
    return False


def _size_of_jpeg(content: bytes) -> tuple[int, int] | None:
    """Width and height that a JPEG tells; None if its segments or its end are missing."""
    begin, size = 2, None
    while begin + 4 <= len(content) and content[begin] == 0xFF:
        kind, length = struct.unpack(">xBH", content[begin : begin + 4])
        if kind == 0xFF:  # fills
            begin += 1
            continue
        if kind in _FRAMES and begin + 9 <= len(content):
            height, width = struct.unpack(">HH", content[begin + 5 : begin + 9])
            size = width, height
        begin += 2 + length
        if kind == _SCAN:
            return size if content.find(_END, begin) >= 0 else None
    return None
