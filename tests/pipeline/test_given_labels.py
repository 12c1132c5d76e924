"""``--labels DIR``: classes of another method, or of another run, in place of our own."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml

from command_line import cli
from docdepth.errors import DamagedFileError, DatasetError
from docdepth.geometry.track import Track
from docdepth.io.labels import read_classes
from docdepth.io.poses import write_kitti
from docdepth.io.run_folder import RunFolder
from docdepth.io.tracks import cut_tracks, read_tracks, write_tracks
from docdepth.pipeline import classify
from docdepth.pipeline.label_folder import LabelFolder
from docdepth.pipeline.plan import states
from motion import straight
from small_drive import SWEEPS, write_small_drive


@pytest.fixture(scope="module")
def root(tmp_path_factory) -> Path:
    """A drive, its poses, and a run of it."""
    folder = tmp_path_factory.mktemp("labels")
    write_kitti(folder / "poses.txt", straight(SWEEPS, 0.5).poses)
    write_small_drive(folder / "drive")
    assert run(folder, folder / "own").exit_code == 0
    return folder


@pytest.fixture
def other(root: Path, tmp_path: Path) -> Path:
    """Labels of another method: a third of the points move, half of them with an instance."""
    (tmp_path / "other").mkdir()
    for k in range(SWEEPS):
        write_labels(tmp_path / "other", k, labels_of(root, k))
    return tmp_path / "other"


def run(root: Path, output: Path, *more: object):
    return cli("run", root / "drive", "-o", output, "--poses", root / "poses.txt", *more)


def points(root: Path, k: int) -> int:
    return (root / "drive" / "velodyne" / f"{k:06d}.bin").stat().st_size // 16


def labels_of(root: Path, k: int) -> np.ndarray:
    rows = np.arange(points(root, k), dtype=np.uint32)
    kinds = np.array([252, 40, 50], np.uint32)[rows % 3]  # a moving car, road, building
    return kinds | (7 << 16) * (rows % 2)


def write_labels(folder: Path, k: int, labels: np.ndarray) -> None:
    (folder / f"{k:06d}.label").write_bytes(labels.astype("<u4").tobytes())


def maps(run: Path) -> list[bytes]:
    return [file.read_bytes() for file in sorted((run / "depth").glob("*.png"))]


def classes(run: Path) -> list[tuple[np.ndarray, np.ndarray | None]]:
    frames = [RunFolder.open(run).frame(k) for k in range(SWEEPS)]
    return [(frame.classid, frame.instance) for frame in frames]


def test_labels_of_a_run_give_its_maps(root, tmp_path):
    """Its box moves, so that tracks matter."""
    assert any((classid >= 100).any() for classid, _ in classes(root / "own"))
    for given in (root / "own", root / "own" / "labels"):
        output = tmp_path / given.name
        assert run(root, output, "--labels", given).exit_code == 0
        assert maps(output) == maps(root / "own")
        assert len(maps(output)) == SWEEPS
        assert (output / "tracks.csv").read_bytes() == (root / "own" / "tracks.csv").read_bytes()
        for k in range(SWEEPS):
            name = f"labels/{k:06d}.label"
            assert (output / name).read_bytes() == (root / "own" / name).read_bytes()


def test_the_stage_says_so_and_goes_on(root, other, tmp_path):
    output = tmp_path / "run"
    assert run(root, output, "--labels", other).exit_code == 0
    manifest = yaml.safe_load((output / "run.yaml").read_text())
    assert manifest["inputs"]["labels"] == str(other)
    assert manifest["stages"]["classify"]["labels"] == str(other)
    assert manifest["stages"]["classify"]["tracks"] is False
    kept = {file: file.stat().st_mtime_ns for file in (output / "depth").iterdir()}
    assert run(root, output, "--labels", other).exit_code == 0
    assert cli("run", output).exit_code == 0
    assert cli("run", "--config", output / "run.yaml", "-o", output).exit_code == 0
    assert {file: file.stat().st_mtime_ns for file in (output / "depth").iterdir()} == kept
    assert {state.state for state in states(RunFolder.open(output))} == {"done"}
    assert run(root, output).exit_code == 2, "without the labels it is another run"
    # Labels that are away are taken to be as they were; other ones make maps out of date.
    other.rename(tmp_path / "away")
    assert {state.state for state in states(RunFolder.open(output))} == {"done"}
    (tmp_path / "away").rename(other)
    write_labels(other, 1, labels_of(root, 1) * 0 + 9)
    found = {state.name: (state.state, state.why) for state in states(RunFolder.open(output))}
    assert found["classify"] == ("out of date", "other labels are given")
    assert found["render image_2"][0] == "out of date"
    assert cli("run", output).exit_code == 0
    assert (classes(output)[1][0] == 50).all()


def test_an_interrupted_stage_goes_on(root, tmp_path, monkeypatch):
    """It keeps what is written, and the whole is as without the interruption."""
    write, output = classify.write_classified, tmp_path / "run"

    def stop_at_the_third(run, index, *more):
        if index == 2:
            raise KeyboardInterrupt
        write(run, index, *more)

    with monkeypatch.context() as patch:
        patch.setattr(classify, "write_classified", stop_at_the_third)
        assert run(root, output, "--labels", root / "own").exit_code != 0
    kept = {file: file.stat().st_mtime_ns for file in (output / "labels").glob("*.label")}
    assert len(kept) == 2
    assert cli("run", output).exit_code == 0
    assert {file: file.stat().st_mtime_ns for file in kept} == kept
    assert maps(output) == maps(root / "own")


def test_a_lost_file_is_taken_again(root, tmp_path):
    output = tmp_path / "run"
    assert run(root, output, "--labels", root / "own").exit_code == 0
    for lost in ("tracks.csv", "labels/000001.label", "frames/frame_000002.ply"):
        before = (output / lost).read_bytes()
        (output / lost).unlink()
        assert cli("run", output).exit_code == 0
        assert (output / lost).read_bytes() == before
        assert {state.state for state in states(RunFolder.open(output))} == {"done"}


def test_classes_and_instances_are_those_of_the_files(root, other, tmp_path):
    assert run(root, tmp_path / "run", "--labels", other).exit_code == 0
    folder = RunFolder.open(tmp_path / "run")
    for k in range(SWEEPS):
        frame = folder.frame(k)
        given = labels_of(root, k)[frame.index]
        expected = np.array([100, 0, 50])[[{252: 0, 40: 1, 50: 2}[n] for n in given & 0xFFFF]]
        np.testing.assert_array_equal(frame.classid, expected)
        np.testing.assert_array_equal(frame.instance, given >> 16)
        assert frame.votes_static is None
    written = np.fromfile(tmp_path / "run" / "labels" / "000000.label", "<u4")
    usable = folder.frame(0).index
    np.testing.assert_array_equal(written[usable] >> 16, labels_of(root, 0)[usable] >> 16)
    np.testing.assert_array_equal(
        (written[usable] & 0xFFFF) == 251, (labels_of(root, 0)[usable] & 0xFFFF) == 252
    )


def test_render_takes_labels_and_run_takes_them_back(root, other, tmp_path):
    output = tmp_path / "run"
    shutil.copytree(root / "own", output)
    assert cli("render", output, "--labels", other).exit_code == 0
    assert maps(output) != maps(root / "own")
    assert not (output / "tracks.csv").exists()
    assert {state.state for state in states(RunFolder.open(output))} == {"done"}
    assert cli("render", output, "--labels", root / "own").exit_code == 0
    assert maps(output) == maps(root / "own")
    assert (output / "tracks.csv").exists()
    assert cli("render", output, "--labels", other).exit_code == 0
    assert run(root, output, "--force").exit_code == 0
    assert RunFolder.open(output).inputs.labels is None
    assert maps(output) == maps(root / "own")
    for ours, theirs in zip(classes(output), classes(root / "own"), strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_npy_of_classes_and_of_what_moves(root, tmp_path):
    for kind in ("classid", "moves"):
        (tmp_path / kind).mkdir()
    for k in range(SWEEPS):
        rows = np.arange(points(root, k))
        np.save(tmp_path / "classid" / f"{k:06d}.npy", np.array([100, 0, 50], np.uint8)[rows % 3])
        np.save(tmp_path / "moves" / f"{k:06d}.npy", rows % 3 == 0)
    for kind, ground in (("classid", 0), ("moves", 50)):
        assert run(root, tmp_path / "run", "--force", "--labels", tmp_path / kind).exit_code == 0
        frame = RunFolder.open(tmp_path / "run").frame(0)
        expected = np.array([100, ground, 50])[frame.index % 3]
        np.testing.assert_array_equal(frame.classid, expected)
        assert frame.instance is None


@pytest.mark.parametrize("to", ["label", "classid", "pcd"])
def test_what_convert_writes_is_read_again(root, tmp_path, to):
    """The PCD files of a run hold its usable returns only."""
    ended = cli("convert", root / "own", tmp_path / "labels", "--to", to)
    assert ended.exit_code == 0
    assert run(root, tmp_path / "run", "--labels", tmp_path / "labels").exit_code == 0
    own = RunFolder.open(root / "own")
    for k in range(SWEEPS):
        frame, again = own.frame(k), RunFolder.open(tmp_path / "run").frame(k)
        assert (frame.classid == 100).any()
        np.testing.assert_array_equal(again.classid == 100, frame.classid == 100)


def write_pcd_of(file: Path, **columns: np.ndarray) -> None:
    """PCD by hand: ASCII, with whatever fields."""
    count = len(next(iter(columns.values())))
    rows = np.column_stack([np.zeros((count, 3)), *columns.values()])
    n = rows.shape[1]
    file.write_text(
        f"VERSION 0.7\nFIELDS x y z {' '.join(columns)}\nSIZE{' 4' * n}\nTYPE{' F' * n}\n"
        f"COUNT{' 1' * n}\nWIDTH {count}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {count}\n"
        "DATA ascii\n" + "\n".join(" ".join(f"{v:g}" for v in row) for row in rows) + "\n"
    )


def test_pcd_files_of_the_sweeps(root, tmp_path):
    """Every row of the sweep, and classes of SemanticKITTI in a field of their own."""
    for k in range(SWEEPS):
        rows = np.arange(points(root, k))
        kinds = np.array([252, 40, 50])[rows % 3]
        write_pcd_of(tmp_path / f"{k:06d}.pcd", intensity=rows % 7, label=kinds)
    assert run(root, tmp_path / "run", "--labels", tmp_path).exit_code == 0
    frame = RunFolder.open(tmp_path / "run").frame(1)
    np.testing.assert_array_equal(frame.classid, np.array([100, 0, 50])[frame.index % 3])


def test_pcd_files_that_are_counted(tmp_path):
    """Names of sweeps are stamps, files are counted; but six digits are a name."""
    moves = np.array([1, 0, 1])
    for k in range(2):
        write_pcd_of(tmp_path / f"{k:06d}.pcd", intensity=np.roll(moves, k))
    labels = LabelFolder(tmp_path)
    labels.check(["1700000000", "1700000001"])
    with pytest.raises(DatasetError, match=r"has 2 PCD files, which are counted .* for 1 sweeps"):
        labels.check(["1700000000"])
    with pytest.raises(DatasetError, match=r"no labels of sweep 000007 \(frame 1\)"):
        labels.check(["000000", "000007"])
    labels.check(["000001", "000000"])
    classid, instance = read_classes(tmp_path / "000001.pcd", 5, 1, lambda: np.array([0, 2, 3]))
    assert classid.tolist() == [100, 50, 100, 50, 50]
    assert instance is None


def test_labels_without_anything_dynamic_are_named(root, tmp_path, caplog):
    """0 and 1 for static and moving are no classes."""
    for k in range(SWEEPS):
        np.save(tmp_path / f"{k:06d}.npy", np.arange(points(root, k)) % 2)
    assert run(root, tmp_path / "run", "--labels", tmp_path).exit_code == 0
    assert f"no point of {tmp_path} is dynamic" in caplog.text
    assert "is dynamic" in RunFolder.open(tmp_path / "run").stage("classify").warnings[0]


def test_tracks_of_other_poses_are_not_used(root, tmp_path, caplog):
    shutil.copytree(root / "own", tmp_path / "theirs")
    poses = straight(SWEEPS, 0.5).poses.copy()
    poses[:, 0, 3] += 0.1
    write_kitti(tmp_path / "moved.txt", poses)
    moved = cli("run", root / "drive", "-o", tmp_path / "run", "--poses", tmp_path / "moved.txt",
                "--labels", tmp_path / "theirs")  # fmt: skip
    assert moved.exit_code == 0
    assert "are of other poses than this run has" in caplog.text
    entry = RunFolder.open(tmp_path / "run").stage("classify")
    assert "are of other poses" in entry.warnings[0]
    assert not (tmp_path / "run" / "tracks.csv").exists()
    # With its poses, as the message says, they are.
    again = cli("run", root / "drive", "-o", tmp_path / "again", "--labels", tmp_path / "theirs",
                "--poses", tmp_path / "theirs" / "traj_odometry.ply")  # fmt: skip
    assert again.exit_code == 0
    assert maps(tmp_path / "again") == maps(root / "own")


def test_labels_of_a_longer_drive(root, tmp_path):
    assert run(root, tmp_path / "run", "--frames", "1:", "--labels", root / "own").exit_code == 0
    folder = RunFolder.open(tmp_path / "run")
    np.testing.assert_array_equal(
        folder.frame(0).classid >= 100, classes(root / "own")[1][0] >= 100
    )
    assert folder.stage("classify").tracks is True


def test_parameters_of_classes_cannot_be_tuned(root, other, tmp_path):
    assert run(root, tmp_path / "run", "--labels", other).exit_code == 0
    ended = cli("tune", tmp_path / "run", "-o", tmp_path / "out",
                "--vary", "dynamics.tolerance=0.1,0.2")  # fmt: skip
    assert ended.exit_code == 2
    assert "are given, not found" in str(ended.exception)


def test_rows_of_tracks_are_cut_to_the_letter(tmp_path):
    times = np.arange(4) * 10**8
    poses = np.repeat(np.eye(4)[None], 4, axis=0)
    one = np.ones(4)
    track = Track(3, "person", times, poses, np.zeros((4, 3)), one[:3], one.astype(int), one, one)
    write_tracks(tmp_path / "all.csv", [track], times)
    rows = (tmp_path / "all.csv").read_text().splitlines()
    assert cut_tracks(tmp_path / "all.csv", times) == (tmp_path / "all.csv").read_bytes()
    later = cut_tracks(tmp_path / "all.csv", times[2:]).decode().splitlines()
    assert later == [rows[0], "0" + rows[3][1:], "1" + rows[4][1:]]
    (tmp_path / "later.csv").write_text("\n".join(later))
    np.testing.assert_array_equal(read_tracks(tmp_path / "later.csv")[0].times, times[2:])
    with pytest.raises(DamagedFileError):
        cut_tracks(tmp_path / "none.csv", times)


@pytest.mark.parametrize("command", ["run", "render"])
def test_labels_that_do_not_fit(root, other, tmp_path, command):
    output = tmp_path / "run"
    if command == "render":
        shutil.copytree(root / "own", output)
        before = (output / "run.yaml").read_bytes()

    def refused(labels: Path) -> str:
        if command == "render":
            ended = cli("render", output, "--labels", labels)
            assert (output / "run.yaml").read_bytes() == before
        else:
            ended = run(root, output, "--labels", labels)
            assert not output.exists()
        assert ended.exit_code == 2
        return f"{ended.exception} {ended.stderr}"

    count = points(root, 3)
    write_labels(other, 3, labels_of(root, 3)[:-2])
    told = refused(other)
    assert f"000003.label (frame 3) has {count - 2} labels for a sweep of {count} points" in told
    (other / "000003.label").unlink()
    assert "no labels of sweep 000003 (frame 3)" in refused(other)
    np.save(other / "000003.npy", np.zeros(count + 1, np.uint8))
    assert f"000003.npy (frame 3) has {count + 1} labels" in refused(other)
    np.save(other / "000003.npy", np.zeros(count, np.float32))
    assert "must be integers or bool" in refused(other)
    (tmp_path / "empty").mkdir()
    assert "holds no .label, .npy or .pcd file" in refused(tmp_path / "empty")
    assert "is not there" in refused(tmp_path / "none")
    if command == "render":
        assert "lies in the run" in refused(output)


def test_files_that_are_no_labels(tmp_path):
    (tmp_path / "odd.label").write_bytes(b"12345")
    (tmp_path / "text.npy").write_bytes(b"no numpy")
    np.save(tmp_path / "negative.npy", np.array([-1, 0]))
    np.save(tmp_path / "flat.npy", np.zeros((2, 2), int))
    two, three = np.zeros(2), np.zeros(3)
    write_pcd_of(tmp_path / "measured.pcd", intensity=two + 0.3)
    write_pcd_of(tmp_path / "none.pcd", ring=two)
    write_pcd_of(tmp_path / "half.pcd", label=two + 9.5)
    write_pcd_of(tmp_path / "more.pcd", intensity=three)
    (tmp_path / "text.pcd").write_text("no PCD")
    for name, message in (
        ("measured.pcd", r"measured.pcd \(frame 4\): intensity is no class"),
        ("none.pcd", "neither a field label nor intensity"),
        ("half.pcd", "label must be whole numbers"),
        ("more.pcd", "has 3 points for a sweep of 2 points, of which 1 are usable returns"),
        ("text.pcd", r"text.pcd \(frame 4\): .*write it again"),
        ("odd.label", r"odd.label \(frame 4\) has 5 bytes; labels are one uint32"),
        ("text.npy", r"text.npy \(frame 4\) cannot be read as NPY"),
        ("negative.npy", "has the class -1"),
        ("flat.npy", "must be integers or bool"),
    ):
        with pytest.raises(DatasetError, match=message):
            read_classes(tmp_path / name, 2, 4, lambda: np.array([1]))


def test_semantic_kitti_classes(tmp_path):
    """By hand from the list of SemanticKITTI: what moves, and what is ground."""
    kinds = np.array([0, 1, 9, 10, 40, 44, 48, 49, 50, 60, 70, 72, 99, 251, 252, 259, 260], "<u4")
    (tmp_path / "0.label").write_bytes((kinds | 5 << 16).tobytes())
    classid, instance = read_classes(tmp_path / "0.label", len(kinds), 0)
    static, ground, dynamic = 50, 0, 100
    assert classid.tolist() == [
        static, static, static, static, ground, ground, ground, ground, static, ground, static,
        ground, static, dynamic, dynamic, dynamic, static,
    ]  # fmt: skip
    assert instance is not None
    assert (instance == 5).all()
