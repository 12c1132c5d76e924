"""Arrays in the notes of a run, and tracks that are read sweep by sweep."""

import numpy as np
import pytest

from docdepth.config import Parameters
from docdepth.dynamics.tracking import TrackedSweep
from docdepth.errors import DamagedFileError
from docdepth.geometry.track import Track
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline.stored_arrays import (
    are_stored,
    array_offsets,
    read_arrays,
    store_tracks,
    stored_sweeps,
    stored_tracks,
    write_arrays,
)

KEY = {"classify": "1"}


@pytest.fixture
def run(tmp_path):
    return RunFolder.create(tmp_path / "run", None, Parameters())


def arrays_of(rng):
    """Of all kinds, some of them empty."""
    kinds = [(np.uint8, (0,)), (np.float32, (3, 15)), (np.uint64, (7,)), (np.uint32, (0, 3)),
             (np.float64, ()), (np.int64, (2, 1))]  # fmt: skip
    return [rng.integers(0, 99, shape).astype(kind) for kind, shape in kinds]


def track_of(number, length):
    times, poses = np.arange(length) * 100, np.repeat(np.eye(4)[None], length, 0)
    poses[:, 0, 3] = np.arange(length)
    points = number * np.arange(length)
    about = np.full(3, number), points, 0.1 * points, 0.2 * points
    return Track(number, "person", times, poses, poses[:, 0, :3], *about)


def test_any_array_of_a_file_is_read_alone(run):
    arrays = arrays_of(np.random.default_rng(0))
    path = run.state_dir / "some.npy"
    write_arrays(run, path, KEY, iter(arrays))
    offsets = array_offsets(path)
    for k, array in enumerate(arrays):
        for read in (read_arrays(path, 1, skipped=k), read_arrays(path, 1, offset=offsets[k])):
            np.testing.assert_array_equal(read[0], array)
            assert read[0].dtype == array.dtype
    with path.open("rb") as stream:  # as np.save writes them
        for array in arrays:
            np.testing.assert_array_equal(np.load(stream), array)
    path.write_bytes(path.read_bytes()[:-3])
    with pytest.raises(DamagedFileError, match="cut off"):
        array_offsets(path)
    with pytest.raises(DamagedFileError):
        read_arrays(path, len(arrays))
    np.save(path, np.zeros((2, 70)))
    path.write_bytes(path.read_bytes().replace(b"(2, 70)", b"(-1,70)"))
    with pytest.raises(DamagedFileError, match=r"its shape is \(-1, 70\)"):
        array_offsets(path)


def test_tracks_are_read_as_they_were_kept(run):
    rng = np.random.default_rng(1)
    sweeps = [
        TrackedSweep(
            rng.integers(0, 9, 3 * k, np.uint32).view(TrackedSweep().members.dtype),
            rng.integers(0, 9, 34, np.uint32).view(TrackedSweep().boxes.dtype),
            np.arange(k, dtype=np.uint64),
        )
        for k in range(6)
    ]
    tracks = [track_of(7, 3), track_of(9, 1), track_of(2, 5)]

    def find(take):
        for sweep in sweeps:
            take(sweep)
        return tracks

    folder = run.state_dir / "tracks"
    assert not are_stored(run, folder, KEY)
    store_tracks(run, folder, KEY, find)
    assert are_stored(run, folder, KEY)
    assert not are_stored(run, folder, {"classify": "2"})
    read = stored_sweeps(folder, 6)
    assert len(read) == 6
    for sweep, right in zip(read, sweeps, strict=True):
        for left, array in zip(sweep, right, strict=True):
            np.testing.assert_array_equal(left, array)
    np.testing.assert_array_equal(read[3:5][1].voxels, np.arange(4))
    for found, right in zip(stored_tracks(folder), tracks, strict=True):
        for name in Track.__dataclass_fields__:
            np.testing.assert_array_equal(getattr(found, name), getattr(right, name))
    with pytest.raises(DamagedFileError, match="it tells of 6 sweeps, the drive has 5"):
        stored_sweeps(folder, 5)


def test_a_drive_without_moving_things_keeps_no_tracks(run):
    def find(take):
        take(TrackedSweep())
        return []

    store_tracks(run, run.state_dir / "tracks", KEY, find)
    assert stored_tracks(run.state_dir / "tracks") == []
    assert not stored_sweeps(run.state_dir / "tracks", 1)[0]


def test_damaged_tracks_are_refused(run):
    folder = run.state_dir / "tracks"
    store_tracks(run, folder, KEY, lambda take: [track_of(7, 3)])
    (paths,) = (file for file in folder.iterdir() if file.name.startswith("paths"))
    whole = paths.read_bytes()
    paths.write_bytes(whole[:-3])
    with pytest.raises(DamagedFileError, match="bytes are there"):
        stored_tracks(folder)
    paths.write_bytes(whole.replace(np.int64(7).tobytes(), np.int64(0).tobytes(), 1))
    with pytest.raises(DamagedFileError, match="track 0"):
        stored_tracks(folder)
