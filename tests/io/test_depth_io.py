"""Depth maps on disk."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from docdepth.errors import DatasetError, InputError, RunError
from docdepth.io.depth import (
    FORMATS,
    as_stored,
    check_format,
    described_maps,
    encode_depth,
    maps_in,
    png_range,
    read_depth,
    write_depth,
)


def depth_map() -> np.ndarray:
    depth = np.random.default_rng(1).uniform(0.5, 200, (37, 53)).astype(np.float32)
    depth[::3, ::2] = np.nan
    return depth


@pytest.mark.parametrize("suffix", [".npy", ".npz", ".tiff", ".tif", ".exr"])
def test_floats_keep_every_bit(tmp_path: Path, suffix: str) -> None:
    if suffix == ".exr":
        pytest.importorskip("OpenEXR")
    path = tmp_path / f"depth{suffix}"
    write_depth(path, depth_map())
    np.testing.assert_array_equal(read_depth(path), depth_map())
    assert read_depth(path).dtype == np.float32


@pytest.mark.parametrize("suffix", [".npy", ".npz", ".tiff", ".exr", ".png"])
def test_arrays_in_any_order_of_memory(tmp_path: Path, suffix: str) -> None:
    if suffix == ".exr":
        pytest.importorskip("OpenEXR")
    depth, path = np.rint(256 * depth_map()) / 256, tmp_path / f"depth{suffix}"
    masked = np.ma.masked_array(depth, depth > 50)
    for other in (np.asfortranarray(depth), np.repeat(depth, 2, axis=1)[:, ::2], depth[::-1, ::-1],
                  depth.astype(np.float64), depth.astype(">f4")):  # fmt: skip
        write_depth(path, other)
        np.testing.assert_array_equal(read_depth(path), other)
    write_depth(path, masked)
    np.testing.assert_array_equal(read_depth(path), np.where(depth > 50, np.nan, depth))


def test_png_is_metres_times_256_with_0_for_none(tmp_path: Path) -> None:
    path = tmp_path / "depth.png"
    depth = depth_map()
    write_depth(path, depth)
    pixels = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert pixels.dtype == np.uint16
    np.testing.assert_array_equal(pixels == 0, np.isnan(depth))
    back = read_depth(path)
    np.testing.assert_array_equal(np.isnan(back), np.isnan(depth))
    assert np.nanmax(np.abs(back - depth)) <= 0.5 / 256 + 1e-5
    assert [f.name for f in tmp_path.iterdir()] == ["depth.png"]


def test_png_holds_its_whole_range_and_refuses_more(tmp_path: Path) -> None:
    edge = np.array([[1e-4, png_range()]], np.float32)
    write_depth(tmp_path / "edge.png", edge)
    np.testing.assert_allclose(read_depth(tmp_path / "edge.png"), [[1 / 256, png_range()]])
    edge[0, 1] = 256.0
    with pytest.raises(InputError, match=r"256\.00 m in row 0, column 1; take another format"):
        write_depth(tmp_path / "deep.png", edge)
    assert not (tmp_path / "deep.png").exists()


def test_values_shapes_and_names_are_checked(tmp_path: Path) -> None:
    for value in (0.0, -1.0, np.inf):
        with pytest.raises(InputError, match="row 1, column 0"):
            encode_depth(np.array([[5, 5], [value, 5]], np.float32))
    with pytest.raises(InputError, match="float32"):
        encode_depth(np.ones((2, 2), np.uint16))  # type: ignore[arg-type]  # of which unit?
    with pytest.raises(InputError, match=r"\.npz, .*, not '\.bmp'"):
        write_depth(tmp_path / "depth.bmp", np.ones((2, 2), np.float32))


def test_damaged_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="is missing"):
        read_depth(tmp_path / "none.png")
    for name in ("a.png", "a.npy", "a.npz", "a.tiff", "a.exr"):
        if name == "a.exr":
            pytest.importorskip("OpenEXR")
        path = tmp_path / name
        write_depth(path, depth_map())
        path.write_bytes(path.read_bytes()[:60])
        with pytest.raises(DatasetError, match=name):
            read_depth(path)
        path.write_bytes(b"")
        with pytest.raises(DatasetError, match=name):
            read_depth(path)
    cv2.imwrite(str(tmp_path / "color.png"), np.zeros((2, 2, 3), np.uint8))
    with pytest.raises(DatasetError, match="one channel of uint16"):
        read_depth(tmp_path / "color.png")
    np.save(tmp_path / "integers.npy", np.ones((2, 2), np.int32))
    with pytest.raises(DatasetError, match="float metres"):
        read_depth(tmp_path / "integers.npy")
    np.savez(tmp_path / "other.npz", range=np.ones((2, 2), np.float32))
    with pytest.raises(DatasetError, match="no array named 'depth'"):
        read_depth(tmp_path / "other.npz")


def test_half_floats_are_the_nearest_of_numpy(tmp_path: Path) -> None:
    pytest.importorskip("OpenEXR")
    path = tmp_path / "depth.exr"
    write_depth(path, depth_map(), "exr-half")
    np.testing.assert_array_equal(read_depth(path), depth_map().astype(np.float16))
    # As the format has it: a list of channels, in it one Y of half floats (1).
    assert b"channels\0chlist\0" in path.read_bytes()
    assert b"Y\0\1\0\0\0" in path.read_bytes()


def test_a_full_disk_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    OpenEXR = pytest.importorskip("OpenEXR")

    def full(*_: object) -> None:
        raise RuntimeError("No space left on device")

    monkeypatch.setattr(OpenEXR.File, "write", full)
    with pytest.raises(RunError, match="No space left on device; make room there"):
        write_depth(tmp_path / "a.exr", depth_map())
    assert not list(tmp_path.iterdir())


def test_deep_scenes_fit_a_png_of_another_scale(tmp_path: Path) -> None:
    depth = np.array([[699.9, 0.5]], np.float32)
    write_depth(tmp_path / "a.png", depth, scale=64)
    np.testing.assert_allclose(read_depth(tmp_path / "a.png", 64), depth, atol=0.5 / 64)
    (tmp_path / "depth.json").write_text('{"scale": {"png": 64.0}}')
    np.testing.assert_allclose(read_depth(tmp_path / "a.png"), depth, atol=0.5 / 64)
    (tmp_path / "depth.json").write_text("{")
    with pytest.raises(DatasetError, match=r"depth\.json does not tell the scale of a\.png"):
        read_depth(tmp_path / "a.png")
    check_format("png", 64, 700)
    check_format("npy", 256, 700)
    with pytest.raises(InputError, match=r"700 m, .* 256\.00 m; take `scale=64`,"):
        check_format("png", 256, 700)


def test_the_most_exact_of_several_formats_is_taken(tmp_path: Path) -> None:
    for name in ("b.png", "b.npy", "a.tiff", "a.png", "c.png", "depth.json"):
        (tmp_path / name).touch()
    assert [p.name for p in maps_in(tmp_path).values()] == ["a.tiff", "b.npy", "c.png"]


@pytest.mark.parametrize("text", ["{", "[]", '{"maps": []}', '{"maps": {"a": {"time_ns": 1}}}'])
def test_a_damaged_description_is_named(tmp_path: Path, text: str) -> None:
    assert described_maps(tmp_path) == {}
    (tmp_path / "depth.json").write_text(text)
    with pytest.raises(RunError, match=r"depth\.json is damaged"):
        described_maps(tmp_path)


@pytest.mark.parametrize("format", FORMATS)
def test_as_stored_is_what_is_read_again(tmp_path: Path, format: str) -> None:
    if format.startswith("exr"):
        pytest.importorskip("OpenEXR")
    rng = np.random.default_rng(4)
    depth = rng.uniform(0.001, 200, (40, 50)).astype(np.float32)
    depth[3] = np.nan
    file = tmp_path / f"a{FORMATS[format]}"
    file.write_bytes(encode_depth(depth, format, 300.0))
    np.testing.assert_array_equal(as_stored(depth, format, 300.0), read_depth(file, 300.0))
