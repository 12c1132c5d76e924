"""PLY files as others write them, in every layout, and damaged in every way."""

from __future__ import annotations

import struct
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from docdepth.errors import RunError
from docdepth.io.frames import read_frame, read_points, read_trajectory, write_frame
from docdepth.io.ply import read_comments, read_vertices, write_vertices

LAYOUTS = ["ascii", "binary_little_endian", "binary_big_endian"]
CODES = {  # struct's letter of each type
    **{"char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I"},
    **{"float": "f", "double": "d", "int8": "b", "uint8": "B", "int16": "h", "uint16": "H"},
    **{"int32": "i", "uint32": "I", "float32": "f", "float64": "d"},
}
VERTICES = (
    "vertex",
    [
        ("float", "x"),
        ("float32", "y"),
        ("double", "z"),
        ("uchar", "intensity"),
        ("short", "classid"),
    ],
    [(1.5, -2.25, 3e10, 200, 7), (0.1, 0.2, 0.3, 0, 300), (float("nan"), 1e30, -4, 255, 0)],
)
FACES = (
    "face",
    [("list uchar int", "vertex_indices"), ("uint", "flags"), ("list ushort double", "weights")],
    [([0, 1, 2], 5, [0.5]), ([], 6, []), ([2, 1], 2**32 - 1, [1, 2, 3])],
)
CAMERAS = ("camera", [("double", "focal"), ("int", "id")], [(1.0, 2), (3.0, 4)])


def ply(layout: str, *elements: tuple) -> bytes:
    """A file as the description of the format has it, written without docdepth."""
    lines = ["ply", f"format {layout} 1.0", "comment made by another", "obj_info of no use"]
    for name, properties, rows in elements:
        lines += [f"element {name} {len(rows)}", *(f"property {t} {n}" for t, n in properties)]
    body = b""
    order = ">" if "big" in layout else "<"
    for _, properties, rows in elements:
        for row in rows:
            words = []
            for (kind, _), value in zip(properties, row, strict=True):
                *counted, scalar = kind.removeprefix("list ").split()
                values = value if counted else [value]
                if layout == "ascii":
                    words += [str(len(values))] * len(counted) + [repr(v) for v in values]
                else:
                    if counted:
                        body += struct.pack(order + CODES[counted[0]], len(values))
                    body += struct.pack(order + CODES[scalar] * len(values), *values)
            body += (" ".join(words) + "\n").encode() if layout == "ascii" else b""
    return "\n".join([*lines, "end_header\n"]).encode() + body


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize(
    "elements",
    [
        [VERTICES, FACES],
        [FACES, VERTICES],
        [CAMERAS, VERTICES],
    ],
    ids=lambda elements: "-".join(name for name, _, _ in elements),
)
def test_every_layout(tmp_path: Path, layout: str, elements: list) -> None:
    path = tmp_path / "frame_000007.ply"
    path.write_bytes(ply(layout, *elements))
    rows, comments = read_vertices(path)
    assert comments == read_comments(path) == ["made by another"]
    assert rows.dtype.names == ("x", "y", "z", "intensity", "classid")
    assert [rows.dtype[k].str[1:] for k in range(5)] == ["f4", "f4", "f8", "u1", "i2"]
    for column, name in enumerate(rows.dtype.names):
        expected = np.array([row[column] for row in VERTICES[2]], rows.dtype[name])
        np.testing.assert_array_equal(rows[name], expected)
    frame = read_frame(path)
    np.testing.assert_array_equal(frame.points[1], np.float32([0.1, 0.2, 0.3]))
    np.testing.assert_array_equal(frame.classid, np.uint16([7, 300, 0]))
    assert frame.name == "frame_000007"
    assert (frame.points.dtype, frame.classid.dtype) == (np.float32, np.uint16)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_type_to_its_limits(tmp_path: Path, layout: str) -> None:
    path = tmp_path / "a.ply"
    for scalar in CODES:
        code = np.dtype(CODES[scalar])
        limits = np.finfo(code) if code.kind == "f" else np.iinfo(code)
        values = [code.type(limits.min).item(), 0, 1, code.type(limits.max).item()]
        path.write_bytes(ply(layout, ("vertex", [(scalar, "v")], [(v,) for v in values])))
        rows, _ = read_vertices(path)
        np.testing.assert_array_equal(rows["v"], np.array(values, code))
        write_vertices(path, rows, [])
        np.testing.assert_array_equal(read_vertices(path)[0], rows)


def test_as_trimesh_writes_and_reads_it(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    box, path = trimesh.creation.box((1, 2, 3)), tmp_path / "a.ply"
    for encoding in ("binary", "ascii"):
        path.write_bytes(trimesh.exchange.ply.export_ply(box, encoding=encoding))
        np.testing.assert_allclose(read_frame(path).points, box.vertices)
    rows = np.zeros(4, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("classid", "<u2")])
    rows["x"], rows["classid"] = range(4), [0, 50, 100, 65535]
    write_vertices(path, rows, ["name one two"])
    np.testing.assert_array_equal(trimesh.load(path).vertices[:, 0], range(4))


def test_other_line_ends(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    header, _, body = ply("binary_little_endian", VERTICES).partition(b"end_header\n")
    path.write_bytes(header.replace(b"\n", b"\r\n") + b"end_header\r\n" + body)
    assert read_vertices(path)[0]["z"][0] == 3e10
    path.write_bytes(ply("ascii", VERTICES).replace(b"\n", b"\r\n"))
    assert read_vertices(path)[0]["z"][0] == 3e10


# ---- damaged


def replaced(old: bytes, new: bytes, layout: str = "binary_little_endian") -> bytes:
    content = ply(layout, FACES, VERTICES)
    assert old in content
    return content.replace(old, new)


@pytest.mark.parametrize(
    ("content", "match"),
    [
        (b"", "its header has no end"),
        (b"P5 3 3 255\n", "does not begin with 'ply'"),
        (b"ply\n" + bytes(1000), "its header has no end"),
        (b"ply\n" + b"x" * 100 + b"\n", "no line of a header"),
        (replaced(b"format binary", b"format binarz"), "its format 'binarz_little_endian 1.0'"),
        (replaced(b"format binary_little_endian 1.0\n", b""), "names no format"),
        (replaced(b"element vertex 3", b"element vertex -3"), "tells no number of rows"),
        (replaced(b"element vertex 3", b"element vertex 4"), "3 of 4 rows are there"),
        (replaced(b"element vertex 3", b"element vertex " + b"9" * 5000), "nothing has 999"),
        (replaced(b"element vertex 3", b"element points 3"), "it has no element 'vertex'"),
        (replaced(b"element face 3", b"element face 9"), "it ends within|rows|entries|too short"),
        (replaced(b"property float x", b"property floet x"), "has a type that PLY lacks"),
        (replaced(b"property float x", b"property list float int x"), "has a type that PLY lacks"),
        (replaced(b"property float x", b"property list uchar int x"), "x of its vertex is a list"),
        (replaced(b"property float x", b"property float z"), "'z' occurs more than once"),
        (b"ply\nformat ascii 1.0\nelement vertex 2\nend_header\n1\n2\n", "has no properties"),
        (replaced(b"200 7", b"200", "ascii"), "row 0 has 4 numbers, not 5"),
        (replaced(b"200 7", b"200 seven", "ascii"), "what is no number"),
        (replaced(b"200 7", b"300 7", "ascii"), "a value of intensity is no uchar"),
        (replaced(b"200 7", b"200 7.5", "ascii"), "a value of classid is no short"),
        (replaced(b"element face 3", b"element face 99", "ascii"), "6 of 99 rows of its face"),
    ],
)  # fmt: skip
def test_damage_is_described(tmp_path: Path, content: bytes, match: str) -> None:
    path = tmp_path / "frame_000003.ply"
    path.write_bytes(content)
    with pytest.raises(RunError, match=rf"frame_000003\.ply is damaged \(.*({match}).*\)"):
        read_vertices(path)


def test_files_that_cannot_be_opened(tmp_path: Path) -> None:
    with pytest.raises(RunError, match=r"none\.ply is missing"):
        read_vertices(tmp_path / "none.ply")
    with pytest.raises(RunError, match="cannot be read: Is a directory"):
        read_vertices(tmp_path)
    assert read_comments(tmp_path) == read_comments(tmp_path / "none.ply") == []


def test_absurd_counts_take_no_memory(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    for layout in LAYOUTS:
        for name in (b"face", b"vertex"):
            for count in (10**9, 10**17):
                content = ply(layout, FACES, VERTICES)
                old = b"element " + name + b" 3"
                path.write_bytes(content.replace(old, old[:-1] + str(count).encode()))
                tracemalloc.start()
                with pytest.raises(RunError, match="is damaged"):
                    read_vertices(path)
                assert tracemalloc.get_traced_memory()[1] < 5_000_000
                tracemalloc.stop()


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_truncation_is_an_error(tmp_path: Path, layout: str) -> None:
    content = ply(layout, FACES, VERTICES)
    path = tmp_path / "a.ply"
    # A number of text that is cut is a number still, and so is one without its line end.
    for length in range(len(content) - (3 if layout == "ascii" else 0)):
        path.write_bytes(content[:length])
        with pytest.raises(RunError, match="is damaged"):
            read_vertices(path)


def test_random_bytes_are_read_or_refused(tmp_path: Path) -> None:
    """A file with changed bytes is read or refused; nothing crashes."""
    rng = np.random.default_rng(8)
    path = tmp_path / "a.ply"
    poses = ("vertex", [("double", n) for n in ("x", "y", "z", "q_w", "q_x", "q_y", "q_z",
             "timestamp")] + [("int", "indices")], [(1, 2, 3, 1, 0, 0, 0, 5.5, 0)])  # fmt: skip
    refused = unnamed = 0
    for trial in range(900):
        elements = [[FACES, VERTICES], [poses]][trial % 2]
        content = bytearray(ply(LAYOUTS[trial % 3], *elements))
        for _ in range(rng.integers(1, 6)):
            content[rng.integers(len(content))] = rng.integers(256)
        path.write_bytes(content if trial % 10 else rng.bytes(rng.integers(300)))
        for read in (read_vertices, read_trajectory, read_frame):
            try:
                with np.errstate(all="ignore"):  # values may be anything
                    read(path)
            except RunError as error:
                refused += "a.ply" in str(error)
                unnamed += "a.ply" not in str(error)
    assert unnamed == 0
    assert refused > 500


def test_a_count_that_is_no_number(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    path.write_bytes(ply("ascii", VERTICES).replace(b"comment made", b"comment input_points made"))
    with pytest.raises(RunError, match="input_points is 'made by another'"):
        read_frame(path)


def test_the_header_of_a_written_frame(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    path.write_bytes(ply("binary_big_endian", VERTICES))
    assert read_vertices(path)[0].dtype == read_vertices(path)[0].dtype.newbyteorder("<")
    write_frame(path, read_frame(path))
    head = path.read_bytes().partition(b"end_header\n")[0].decode().splitlines()
    assert head == [
        "ply", "format binary_little_endian 1.0", "comment name a", "comment input_points 3",
        "element vertex 3", "property float x", "property float y", "property float z",
        "property uint index", "property ushort classid",
    ]  # fmt: skip


@pytest.mark.parametrize("names", ["x y z other", "y x z other", "x y other z", "other x y z"])
def test_points_of_any_order_of_columns(tmp_path: Path, names: str) -> None:
    kinds = [(name, "<u2" if name == "other" else "<f4") for name in names.split()]
    for count in (0, 5):
        rows = np.zeros(count, kinds)
        places = np.random.default_rng(0).normal(size=(count, 3)).astype(np.float32)
        rows["x"], rows["y"], rows["z"] = places.T
        write_vertices(tmp_path / "a.ply", rows, [])
        points = read_points(tmp_path / "a.ply")
        np.testing.assert_array_equal(points, places)
        assert points.flags.c_contiguous
        assert points.flags.writeable
