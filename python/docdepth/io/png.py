"""PNG of 16 bits, written four times as fast as by OpenCV and smaller."""

from __future__ import annotations

import struct
import zlib

import numpy as np
from isal import isal_zlib
from numpy.typing import NDArray

SIGNATURE = b"\x89PNG\r\n\x1a\n"
_UP = 2  # filter type: each byte less the one above it
_LEVEL = 1  # of ISA-L: 0 is as fast and 13 % larger, 3 takes half as long again for no less


def encode_png(pixels: NDArray[np.uint16]) -> bytes:
    """A grey image as the content of a PNG.

    OpenCV takes most of its time in zlib, whatever its settings. So the filtered rows are packed by
    ISA-L here, in the format of zlib. The bytes may differ from processor to processor, the pixels
    do not.

    Parameters
    ----------
    pixels : ndarray of uint16, shape (h, w)
    """
    height, width = pixels.shape
    samples = pixels.astype(">u2").view(np.uint8)
    rows = np.empty((height, 1 + 2 * width), np.uint8)
    rows[:, 0] = _UP
    rows[0, 1:] = samples[0]
    np.subtract(samples[1:], samples[:-1], out=rows[1:, 1:])
    # 16 bits, grey, and the only methods of compression, filter and interlacing.
    header = struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0)
    packed = isal_zlib.compress(rows, _LEVEL)
    return SIGNATURE + _chunk(b"IHDR", header) + _chunk(b"IDAT", packed) + _chunk(b"IEND", b"")


def _chunk(kind: bytes, content: bytes) -> bytes:
    checksum = zlib.crc32(content, zlib.crc32(kind))
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", checksum)
