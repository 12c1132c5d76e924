"""Records of files that another process adds to, against records that are read anew."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from docdepth.config import Parameters
from docdepth.errors import RunError
from docdepth.geometry.trajectory import Trajectory
from docdepth.io import file_records
from docdepth.io.atomic import Written
from docdepth.io.file_records import FileRecords, shared_records
from docdepth.io.frames import write_trajectory
from docdepth.io.run_folder import RunFolder


def known(records: FileRecords) -> dict[str, tuple[dict[str, str], int]]:
    return {name: (records.recorded_key(name), records.size(name)) for name in records.names()}


@pytest.mark.parametrize("seed", range(5))
def test_what_is_added_is_read_on(tmp_path: Path, seed: int) -> None:
    rng, path = np.random.default_rng(seed), tmp_path / "records" / "frames.jsonl"
    writer = FileRecords(tmp_path, path)
    for _ in range(300):  # so many that records are written anew on the way
        name = f"{rng.integers(20)}.ply"
        if rng.random() < 0.2:
            writer.drop(name)
        else:
            writer.add(
                name, Written(*rng.integers(1, 99, 3).tolist()), {"of": str(rng.integers(3))}
            )
        if rng.random() < 0.05:
            writer.compact()
        if rng.random() < 0.5:
            found = shared_records(tmp_path, path, "a")
            assert known(found) == known(FileRecords(tmp_path, path)) == known(writer)


def test_only_what_is_new_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, lines = tmp_path / "frames.jsonl", []
    parse = FileRecords._parse
    monkeypatch.setattr(FileRecords, "_parse", lambda self, line: lines.append(parse(self, line)))
    writer = FileRecords(tmp_path, path)
    for k in range(100):
        writer.add(f"{k}.ply", Written(k, k, k), {})
    first = shared_records(tmp_path, path, "a")
    writer.add("100.ply", Written(1, 1, 1), {})
    assert shared_records(tmp_path, path, "a") is first
    assert len(lines) == 101
    assert len(known(first)) == 101


def test_a_line_that_is_half_written_is_read_when_it_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "frames.jsonl"
    writer = FileRecords(tmp_path, path)
    writer.add("0.ply", Written(1, 2, 3), {"of": "a"})
    line = path.read_bytes()
    half = len(line) // 2
    path.write_bytes(line + line[:half].replace(b"0.ply", b"1.ply"))
    records = shared_records(tmp_path, path, "a")
    assert records.names() == ["0.ply"]
    with path.open("ab") as stream:
        stream.write(line[half:])
    assert shared_records(tmp_path, path, "a").names() == ["0.ply", "1.ply"]
    path.unlink()
    assert shared_records(tmp_path, path, "a").names() == []


def test_a_new_file_under_an_old_name_is_not_taken_for_the_old_one(tmp_path: Path) -> None:
    path = tmp_path / "frames.jsonl"
    FileRecords(tmp_path, path).add("0.ply", Written(1, 2, 3), {"of": "a"})
    line, inode = path.read_bytes(), path.stat().st_ino
    shared_records(tmp_path, path, "a")
    path.write_bytes(line.replace(b"0.ply", b"1.ply") + line.replace(b"0.ply", b"2.ply"))
    assert path.stat().st_ino == inode
    assert shared_records(tmp_path, path, "b").names() == ["1.ply", "2.ply"]


def test_records_of_earlier_runs_are_let_go(tmp_path: Path) -> None:
    for k in range(2 * file_records._MOST_SHARED):
        shared_records(tmp_path, tmp_path / f"{k}.jsonl", "a")
    assert len(file_records._shared) <= file_records._MOST_SHARED


def test_a_trajectory_is_read_once_and_anew_when_it_is_written_anew(tmp_path: Path) -> None:
    run = RunFolder.create(tmp_path / "run", None, Parameters())
    for count in (3, 5, 5):
        poses = np.repeat(np.eye(4)[None], count, 0)
        poses[:, 0, 3] = np.random.default_rng(count).random(count)
        times = np.arange(count) * 100_000_000
        write_trajectory(run.trajectory_path, Trajectory(times, poses), np.arange(count))
        found = run.trajectory()
        np.testing.assert_array_equal(found.poses[:, :3, 3], poses[:, :3, 3])
        assert RunFolder(run.path).trajectory() is found
    write_trajectory(run.trajectory_path, found, np.arange(5) + 1)
    with pytest.raises(RunError, match="not numbered"):
        run.trajectory()
    run.trajectory_path.unlink()
    with pytest.raises(RunError):
        run.trajectory()
