"""Arrays in the notes of a run, and tracks that are read sweep by sweep."""

import io
import zipfile

import numpy as np
import pytest

from docdepth.config import Parameters
from docdepth.dynamics.tracking import TrackedSweep
from docdepth.errors import DamagedFileError
from docdepth.geometry.track import Track, Tracks
from docdepth.io.run_folder import RunFolder
from docdepth.io.untrusted import read_kept_arrays
from docdepth.pipeline.sweep_store import TRACKING, TrackStore, sweep_file, write_arrays

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


def test_a_track_is_shown_in_one_line():
    track = track_of(3, 5)
    assert repr(track) == "Track(id=3, person, 3.0 x 3.0 x 3.0 m, 5 sweeps, 0.0 s)"
    assert repr(Tracks([track])) == "Tracks(1; person: 1)"
    assert repr(Tracks()) == "Tracks(0)"


def test_any_array_of_a_file_is_read_alone(run):
    arrays = {f"a{k}": array for k, array in enumerate(arrays_of(np.random.default_rng(0)))}
    path = sweep_file(run, "some", 12)
    write_arrays(run, path, KEY, arrays)
    for name, array in arrays.items():
        (read,) = read_kept_arrays(path, name)
        np.testing.assert_array_equal(read, array)
        assert read.dtype == array.dtype
    with np.load(path) as found:  # as np.savez writes them
        assert list(found) == list(arrays)
        for name, array in arrays.items():
            np.testing.assert_array_equal(found[name], array)
    first, _, last = (a.tobytes() for a in read_kept_arrays(path, "a1", "a0", "a2"))
    assert (first, last) == (arrays["a1"].tobytes(), arrays["a2"].tobytes())
    with pytest.raises(DamagedFileError, match="no_such"):
        read_kept_arrays(path, "a0", "no_such")
    whole = path.read_bytes()
    path.write_bytes(whole[:-3])
    with pytest.raises(DamagedFileError, match="zip"):
        read_kept_arrays(path, "a0")
    path.write_bytes(whole.replace(arrays["a2"].tobytes(), bytes(arrays["a2"].nbytes)))
    with pytest.raises(DamagedFileError, match="CRC"):
        read_kept_arrays(path, "a2")
    content = io.BytesIO()
    np.save(content, np.zeros((2, 70)))
    with zipfile.ZipFile(path, "w") as made:
        made.writestr("a.npy", content.getvalue().replace(b"(2, 70)", b"(-1,70)"))
    with pytest.raises(DamagedFileError, match=r"its shape is \(-1, 70\)"):
        read_kept_arrays(path, "a")
    path.unlink()
    with pytest.raises(DamagedFileError, match="is missing"):
        read_kept_arrays(path, "a")


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

    store = TrackStore(run, KEY, 6)
    assert not store.is_whole()
    for sweep in sweeps:
        store.take(sweep)
    store.write(tracks)
    assert store.is_whole()
    assert not TrackStore(run, {"classify": "2"}, 6).is_whole()
    assert not TrackStore(run, KEY, 7).is_whole()
    read = TrackStore(run, KEY, 6)
    assert len(read) == 6
    for sweep, right in zip(read, sweeps, strict=True):
        for left, array in zip(sweep, right, strict=True):
            np.testing.assert_array_equal(left, array)
            assert left.dtype == array.dtype
    np.testing.assert_array_equal(read[3:5][1].voxels, np.arange(4))
    for found, right in zip(read.tracks(), tracks, strict=True):
        for name in Track.__dataclass_fields__:
            np.testing.assert_array_equal(getattr(found, name), getattr(right, name))
    sweep_file(run, TRACKING, 4).unlink()
    assert not TrackStore(RunFolder(run.path), KEY, 6).is_whole()
    with pytest.raises(DamagedFileError, match=r"000004.npz is missing"):
        read[4]


def test_a_drive_without_moving_things_keeps_no_tracks(run):
    store = TrackStore(run, KEY, 1)
    store.take(TrackedSweep())
    store.write([])
    assert store.is_whole()
    assert store.tracks() == []
    assert not store[0]


def test_damaged_tracks_are_refused(run):
    store = TrackStore(run, KEY, 0)
    store.write([track_of(7, 3)])
    (paths,) = (run.state_dir / TRACKING).iterdir()
    whole = paths.read_bytes()
    paths.write_bytes(whole[:-3])
    with pytest.raises(DamagedFileError, match="zip"):
        store.tracks()
    paths.write_bytes(whole)
    with np.load(paths) as loaded:
        arrays = dict(loaded)
    np.savez(paths, **arrays | {"id": np.zeros(1, np.int64)})
    with pytest.raises(DamagedFileError, match="track 0"):
        store.tracks()
    np.savez(paths, **arrays | {"length": np.array([2, 1])})
    with pytest.raises(DamagedFileError):
        store.tracks()
