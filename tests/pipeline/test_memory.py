"""Memory by the formula, a budget that is kept, and a run that is measured."""

from __future__ import annotations

import gc
import json
import os
import subprocess
import sys
import tracemalloc
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from docdepth.concurrency import Timer
from docdepth.config import GroundParameters, Parameters, parameters
from docdepth.datasets import open_dataset
from docdepth.dynamics.voting import KeyFrames
from docdepth.errors import ConfigError
from docdepth.geometry.trajectory import Trajectory
from docdepth.ground.growing import Chunk, chunks
from docdepth.io.file_records import FileRecords
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline import classify
from docdepth.pipeline.execution import bytes_of, memory_of_run, within_memory
from docdepth.pipeline.plan import states
from docdepth.pipeline.run import run


def test_memory_grows_with_the_sensor_and_the_chunk_and_hardly_with_the_drive() -> None:
    short = parameters("default", {"ground.chunk_length": 50})
    long = [memory_of_run(100_000, sweeps, [], parameters()) for sweeps in (1000, 4000, 100_000)]
    assert long[1] < 1.01 * long[0]
    assert long[2] < long[0] + 1.1e8
    assert memory_of_run(100_000, 1000, [], short) < 0.7 * long[0]
    assert memory_of_run(10_000, 1000, [], parameters()) < 0.5 * long[0]
    assert memory_of_run(100_000, 1000, [], parameters(), jobs=3) > 2.9 * long[0]


def test_a_sweep_leaves_less_than_a_kilobyte(tmp_path: Path) -> None:
    sweeps = 1000
    for folder in ("frames", "labels"):
        names = (f"{folder}_{k:06d}" for k in range(sweeps))
        key = {"odometry": "a" * 16, "classify": "b" * 16}
        lines = [{"name": n, "size": 10**6, "time": 10**18, "checksum": 1, "key": key}
                 for n in names]  # fmt: skip
        (tmp_path / folder).write_text("".join(json.dumps(line) + "\n" for line in lines))
    poses = np.tile(np.eye(4), (sweeps, 1, 1))
    poses[:, 0, 3] = 0.9 * np.arange(sweeps)

    def kept() -> object:
        both = [FileRecords(tmp_path, tmp_path / folder) for folder in ("frames", "labels")]
        for records in both:
            for name in records.names():
                records.state(name)
        key_frames = KeyFrames(Trajectory(10**8 * np.arange(sweeps), poses))
        assert all(k not in key_frames[k] for k in range(sweeps))
        return both, key_frames

    kept()  # what is imported on the way counts for no sweep
    gc.collect()
    tracemalloc.start(25)
    held = kept()
    gc.collect()
    # Of this function alone: threads of other tests may still be at work.
    here = tracemalloc.Filter(True, __file__, all_frames=True)
    traces = tracemalloc.take_snapshot().filter_traces([here]).traces
    tracemalloc.stop()
    left = sum(trace.size for trace in traces)
    assert held
    assert 100 < left / sweeps < 1000


def test_a_budget_shortens_chunks_of_ground_or_says_what_is_needed(drive: Path) -> None:
    recording, values = open_dataset(drive), parameters()
    assert within_memory("2G", recording, [], values) == values  # five sweeps are no chunk
    points = SimpleNamespace(points=np.ones((120_000, 3), np.float32))
    long: Any = type("Long", (), {"__len__": lambda _: 5000, "sweep": lambda _, k: points})()
    assert within_memory("4G", long, [], values) == values
    fits = within_memory("2G", long, [], values)
    assert 50 <= fits.ground.chunk_length < values.ground.chunk_length
    assert memory_of_run(120_000, 5000, [], fits) <= 2e9
    longest: Any = type("Long", (), {"__len__": lambda _: 500_000, "sweep": lambda _, k: points})()
    fits = within_memory("2.5G", longest, [], values)  # half a gigabyte is of what a sweep leaves
    assert 2.3e9 < memory_of_run(120_000, 500_000, [], fits) <= 2.5e9
    with pytest.raises(ConfigError, match=r"`memory='1G'`: the run needs 1\.\d\d GB by estimate"):
        within_memory("1G", long, [], values)
    with pytest.raises(ConfigError, match="or fewer `jobs`"):
        within_memory("2G", long, [], values, jobs=3)


def test_sizes() -> None:
    assert [bytes_of(text) for text in ("4G", "1.5 GB", "800M", "12")] == [
        4 * 10**9, 15 * 10**8, 8 * 10**8, 12,
    ]  # fmt: skip
    for text in ("4 gigs", "", "-1G", "G"):
        with pytest.raises(ConfigError, match="for example 4G"):
            bytes_of(text)


def test_a_run_that_would_need_more_does_not_begin(drive: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="`memory='100M'`: the run needs 0"):
        run(drive, tmp_path / "run", memory="100M")
    assert not (tmp_path / "run").exists()


def test_a_budget_makes_no_other_run(
    drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Chunks of ground change no label: with and without ``--memory`` it is the same run."""
    grown: list[float] = []

    def spy(trajectory: Trajectory, ground: GroundParameters) -> list[Chunk]:
        grown.append(ground.chunk_length)
        return chunks(trajectory, ground)

    def short(*arguments: Any) -> Parameters:
        return parameters("default", {"ground.chunk_length": 50})

    monkeypatch.setattr(classify, "chunks", spy)
    monkeypatch.setattr("docdepth.pipeline.run.within_memory", short)
    folder = run(drive, tmp_path / "run", memory="1G").folder
    assert set(grown) == {50}
    assert folder.parameters == parameters()
    before = sorted((file, file.stat().st_mtime_ns) for file in folder.path.rglob("*.ply"))
    for again in (run(drive, folder.path).folder, run(drive, folder.path, memory="2G").folder):
        assert {state.state for state in states(again)} == {"done"}
    assert before == sorted((file, file.stat().st_mtime_ns) for file in folder.path.rglob("*.ply"))
    other = run(drive, tmp_path / "other")  # began without a budget
    grown.clear()
    assert {state.state for state in states(run(drive, other.path, memory="1G").folder)} == {"done"}
    assert not grown
    for file in (folder.path / "labels").iterdir():
        assert file.read_bytes() == (other.path / "labels" / file.name).read_bytes()


def test_what_the_caller_held_does_not_count() -> None:
    held = np.ones(50 << 20)  # 400 MB
    code = "from docdepth.concurrency import Timer as S; print(S().peak_memory_mb())"
    printed = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)
    assert held.nbytes > 4e8
    assert int(printed.stdout) < 300


def test_a_system_that_does_not_tell_the_peak(monkeypatch: pytest.MonkeyPatch) -> None:
    told = Timer().peak_memory_mb()
    monkeypatch.setattr(Path, "read_text", lambda _: "VmRSS: 5 kB")  # as in some sandboxes
    assert Timer().peak_memory_mb() >= told - 1


@pytest.mark.nightly
def test_the_formula_tells_what_a_run_takes(drive_0005: Path, tmp_path: Path) -> None:
    sweeps, out = 40, tmp_path / "run"
    command = [sys.executable, "-m", "docdepth", "run", str(drive_0005), "-o", str(out)]
    subprocess.run([*command, "-q", "--frames", f"0:{sweeps}"], check=True, env=os.environ)
    manifest = RunFolder.open(out).manifest.stages
    taken = 1e6 * max(stage.peak_memory_mb for stage in manifest.values())
    recording = open_dataset(drive_0005)
    points = len(recording.sweep(0).points)
    cameras = [recording.cameras["image_02"]]
    assert taken == pytest.approx(memory_of_run(points, sweeps, cameras, parameters()), rel=0.3)
