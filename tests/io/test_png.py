"""PNG of depth maps, against the standard and other decoders."""

import struct
import zlib

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from docdepth.io.images import encode_png


def decoded(content: bytes) -> np.ndarray:
    """The pixels as the standard says, for what the encoder makes of it."""
    assert content[:8] == bytes([137, 80, 78, 71, 13, 10, 26, 10])
    chunks, begin = {}, 8
    while begin < len(content):
        length, kind = struct.unpack(">I4s", content[begin : begin + 8])
        data = content[begin + 8 : begin + 8 + length]
        (checksum,) = struct.unpack(">I", content[begin + 8 + length : begin + 12 + length])
        assert checksum == zlib.crc32(kind + data)
        chunks[kind] = data
        begin += 12 + length
    assert list(chunks) == [b"IHDR", b"IDAT", b"IEND"]
    width, height, *form = struct.unpack(">IIBBBBB", chunks[b"IHDR"])
    assert form == [16, 0, 0, 0, 0]
    rows = np.frombuffer(zlib.decompress(chunks[b"IDAT"]), np.uint8).reshape(height, -1)
    assert (rows[:, 0] == 2).all()
    samples = np.cumsum(rows[:, 1:], axis=0, dtype=np.uint8)
    return samples.reshape(height, width, 2).astype(np.uint16) @ np.array([256, 1], np.uint16)


@settings(max_examples=50, deadline=None)
@given(arrays.arrays(np.uint16, st.tuples(st.integers(1, 20), st.integers(1, 20))))
def test_pixels_come_back(pixels: np.ndarray) -> None:
    content = encode_png(pixels)
    np.testing.assert_array_equal(decoded(content), pixels)
    by_opencv = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    assert by_opencv.dtype == np.uint16
    np.testing.assert_array_equal(by_opencv, pixels)


@pytest.mark.parametrize("step", [1, -1])
def test_a_view_of_an_image_is_written_as_it_looks(step: int) -> None:
    pixels = np.arange(600, dtype=np.uint16).reshape(20, 30)[::2, 5::step]
    np.testing.assert_array_equal(decoded(encode_png(pixels)), pixels)


def test_a_depth_map_is_no_larger_than_by_opencv() -> None:
    v, u = np.mgrid[:375, :1242]
    depth = np.minimum(1.7 * 720 / np.maximum(v - 170, 9), 60 + 5 * np.sin(u / 90))
    noise = np.random.default_rng(0).normal(0, 0.004, depth.shape)
    pixels = np.where(v < 120, 0, 256 * depth * (1 + noise * (u % 7 == 0))).astype(np.uint16)
    assert len(encode_png(pixels)) < 1.05 * len(cv2.imencode(".png", pixels)[1])
