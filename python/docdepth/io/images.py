"""Images in bytes: what others may have written or damaged, PNG of 16 bits, EXR."""

from __future__ import annotations

import struct
import tempfile
import zlib
from pathlib import Path
from typing import Any

import cv2
import deflate
import numpy as np
from numpy.typing import NDArray

from docdepth.errors import DatasetError, MissingExtraError, RunError
from docdepth.io.untrusted import read_file

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_JPEG, _END = b"\xff\xd8", b"\xff\xd9"
_SCAN = 0xDA  # kind of the segment before the pixels
_FRAMES = {0xC0, 0xC1, 0xC2, 0xC3, 0xC5, 0xC6, 0xC7, 0xC9, 0xCA, 0xCB, 0xCD, 0xCE, 0xCF}
"""Kinds of the segment that tells the size."""
_MOST_PACKED = 1100
"""Pixels for a byte: deflate packs 1032 bytes into one, a JPEG 256 pixels into twelve bits."""
_UP = 2  # filter type: each byte less the one above it
_LEVEL = 1  # of libdeflate; 3 takes half as long again for 4 % less


def decode_image(content: bytes | NDArray[np.uint8], flags: int) -> NDArray[Any] | None:
    """The image in the content of a file; None if it is not one that OpenCV reads."""
    data = np.frombuffer(content, np.uint8)
    if not len(data) or _claims_too_much(data):
        return None
    try:
        image = cv2.imdecode(data, flags)
    except cv2.error:
        return None
    return None if image is None else np.asarray(image)


def decode_photo(content: bytes | NDArray[np.uint8]) -> NDArray[np.uint8] | None:
    """The image in the content of a file as BGR, also of a camera of more bits than eight.

    None if OpenCV does not read it, or if it holds numbers other than brightness.
    """
    image = decode_image(content, cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH)
    if image is not None and image.dtype == np.uint16:
        return upper_bits(image)
    return image if image is not None and image.dtype == np.uint8 else None


def upper_bits(values: NDArray[np.uint16]) -> NDArray[np.uint8]:
    """The upper 8 of the bits that an image uses: many cameras fill 10, 12 or 14 of 16."""
    unused = max(int(values.max()).bit_length() - 8, 0)
    return (values >> unused).astype(np.uint8)


def _claims_too_much(data: NDArray[np.uint8]) -> bool:
    """Whether a PNG or JPEG tells of more pixels, or of longer chunks, than its bytes can hold.

    OpenCV takes memory for both before it reads them, and makes up what is missing of a JPEG.
    """
    content = data.tobytes()
    if content.startswith(_SIGNATURE) and len(content) >= 24:
        width, height = struct.unpack(">II", content[16:24])
        return width * height > _MOST_PACKED * len(content) or _has_long_chunk(content)
    if content.startswith(_JPEG):
        found = _size_of_jpeg(content)
        return found is None or found[0] * found[1] > _MOST_PACKED * len(content)
    return False


def _has_long_chunk(content: bytes) -> bool:
    """Whether a chunk of a PNG goes beyond its end."""
    begin = len(_SIGNATURE)
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


def encode_image(image: NDArray[Any], suffix: str, *how: int) -> bytes:
    """An image (BGR or grey) as the content of a file of this kind; ``how`` is as for OpenCV."""
    return bytes(cv2.imencode(suffix, np.ascontiguousarray(image), how)[1].tobytes())


PICTURE = (cv2.IMWRITE_JPEG_QUALITY, 90)
"""How pictures of a run are encoded as JPEG."""


def encode_png(pixels: NDArray[np.uint16]) -> bytes:
    """A grey image as the content of a PNG.

    OpenCV takes most of its time in zlib, whatever its settings. So the filtered rows are packed by
    libdeflate here, in the format of zlib. ISA-L is twice as fast, but was seen to pack the same
    pixels into other bytes within one process.
    """
    height, width = pixels.shape
    samples = pixels.astype(">u2").view(np.uint8)
    rows = np.empty((height, 1 + 2 * width), np.uint8)
    rows[:, 0] = _UP
    rows[0, 1:] = samples[0]
    np.subtract(samples[1:], samples[:-1], out=rows[1:, 1:])
    # 16 bits, grey, and the only methods of compression, filter and interlacing.
    header = struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0)
    packed = bytes(deflate.zlib_compress(rows, _LEVEL))
    return _SIGNATURE + _chunk(b"IHDR", header) + _chunk(b"IDAT", packed) + _chunk(b"IEND", b"")


def _chunk(kind: bytes, content: bytes) -> bytes:
    checksum = zlib.crc32(content, zlib.crc32(kind))
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", checksum)


def import_exr() -> Any:
    """The module OpenEXR."""
    # OpenCV's wheels read EXR only if a variable is set before the import, or not at all.
    try:
        import OpenEXR
    except ImportError:
        raise MissingExtraError('EXR needs a package: pip install "docdepth[exr]"') from None
    return OpenEXR


def encode_exr(depth: NDArray[np.float32], dtype: np.dtype[Any]) -> bytes:
    """A depth map, (h, w) metres, as an EXR file with a channel Y of this type."""
    OpenEXR = import_exr()
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    # OpenCV writes one channel Y and reads no other.
    try:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "depth.exr"
            OpenEXR.File(header, {"Y": depth.astype(dtype)}).write(str(path))
            return read_file(path)
    except (OSError, RuntimeError) as error:  # OpenEXR writes to files only
        raise RunError(
            f"cannot write an EXR to {tempfile.gettempdir()}: {error}; make room there or set "
            "TMPDIR"
        ) from None


def read_exr(path: Path) -> NDArray[Any]:
    """The channel Y or Z of an EXR file, or its only one."""
    OpenEXR = import_exr()
    try:
        with OpenEXR.File(str(path)) as image:
            channels = {name: c.pixels.copy() for name, c in image.channels().items()}
    except (RuntimeError, ValueError) as error:
        raise DatasetError(f"{path} is damaged: {error}; delete it and render again") from None
    for name in ("Y", "Z", *(channels if len(channels) == 1 else ())):
        if name in channels:
            return np.asarray(channels[name])
    raise DatasetError(f"{path} has the channels {', '.join(channels)}; depth is one, Y or Z")
