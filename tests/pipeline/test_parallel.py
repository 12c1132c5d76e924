"""Many workers make what one process makes, wherever the drive is cut."""

from __future__ import annotations

import logging
import multiprocessing
import os
import pickle
import re
import shutil
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from command_line import cli
from docdepth.concurrency import Timer, map_unordered
from docdepth.config import Parameters
from docdepth.errors import ConfigError, DamagedFileError, DatasetError, RunError, SeveralProblems
from docdepth.io.inputs import RunInputs
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline import parallel
from docdepth.pipeline.execution import Execution
from docdepth.pipeline.parallel import ChunkContext, WorkerPool
from docdepth.pipeline.plan import states
from docdepth.pipeline.run import run, run_stages
from docdepth.pipeline.run_all import run_all
from small_drive import results, write_small_drive

SWEEPS = 8


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_small_drive(tmp_path_factory.mktemp("workers") / "drive", SWEEPS)


@pytest.fixture(scope="module")
def whole(drive: Path) -> Path:
    """A run by one process."""
    run(drive, drive.parent / "whole", camera="all", threads=1)
    return drive.parent / "whole"


def cut_into(patch: pytest.MonkeyPatch, metres: float) -> None:
    patch.setattr(parallel, "_LONGEST", metres)
    patch.setattr(parallel, "_SHORTEST", metres / 4)


def test_two_processes_make_what_one_makes(
    drive: Path, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cut_into(monkeypatch, 2.0)
    monkeypatch.chdir(tmp_path)
    steps: list[tuple[str, int, int]] = []
    folder = run(
        drive, "run", camera="all", jobs=2, progress=lambda *step: steps.append(step)
    ).folder
    assert results(tmp_path / "run") == results(whole)
    assert {state.state for state in states(folder, verify=True)} == {"done"}
    assert not (folder.path / ".docdepth" / "staging").exists()
    for stage, total in (("classify", SWEEPS), ("render", 2 * SWEEPS)):
        done = [step[1] for step in steps if step[0] == stage]
        assert done == sorted(done)
        assert (done[0], done[-1]) == (0, total)
        assert len(set(done)) > 3  # chunk by chunk
    profile = folder.stage("classify")
    assert profile.seconds["vote"] > 0  # of the workers
    assert profile.peak_memory_mb > 0


def test_a_worker_that_dies_ends_the_run_and_the_same_command_continues(
    drive: Path, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cut_into(monkeypatch, 2.0)

    def kill(stage: str, done: int, total: int) -> None:
        if stage == "render" and done:
            multiprocessing.active_children()[0].kill()

    with pytest.raises(RunError, match="a worker has died"):
        run(drive, tmp_path / "run", camera="all", jobs=2, progress=kill)
    assert not (tmp_path / "run" / ".docdepth" / "staging").exists()
    again = run(drive, tmp_path / "run", camera="all", jobs=2).folder
    assert again.stage("classify").frames == SWEEPS
    assert results(tmp_path / "run") == results(whole)


@pytest.mark.parametrize("metres", [1.0, pytest.param(3.0, marks=pytest.mark.slow)])
def test_it_does_not_matter_where_a_drive_is_cut(
    drive: Path, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, metres: float
) -> None:
    """Labels and depth at a border equal those inside: each chunk is worked on alone."""
    cut_into(monkeypatch, metres)
    lengths: list[int] = []

    def map_frames(self, run, work, chunks, timer, progress, size=len):  # type: ignore[no-untyped-def]
        task = partial(parallel._work_elsewhere, run, work, 1, parallel.__version__)
        for number, chunk in enumerate(chunks):
            alone, itself = pickle.loads(pickle.dumps((task, chunk)))
            one = alone(itself)
            run.commit(one.files)
            lengths.append(size(chunk))
            yield number, one.result

    monkeypatch.setattr(WorkerPool, "map_frames", map_frames)
    run(drive, tmp_path / "run", camera="all", jobs=2)
    assert len(lengths) > 4
    assert results(tmp_path / "run") == results(whole)


def refuse(context: ChunkContext, chunk: list[int]) -> None:
    raise DamagedFileError(context.run.path / "frames" / "frame_000003.ply", "cut off")


def warn(context: ChunkContext, chunk: list[int]) -> int:
    logging.getLogger("docdepth.test").warning("%d frames look odd", len(chunk))
    return sum(chunk)


def begun(path: Path) -> RunFolder:
    folder = RunFolder.create(path, None, Parameters())
    folder.state_dir.mkdir(parents=True)
    folder.save()
    return folder


def test_errors_and_warnings_of_workers_are_those_of_the_run(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder, done = begun(tmp_path / "run"), list[int]()
    with WorkerPool(1, jobs=2) as two:
        found = dict(two.map_frames(folder, warn, [[0, 1], [2]], Timer(), done.append))
        with pytest.raises(DamagedFileError, match="cut off") as raised:
            list(two.map_frames(folder, refuse, [[0], [1]], Timer(), done.append))
    assert found == {0: 1, 1: 2}
    assert done[-1] == 3
    assert {"2 frames look odd", "1 frames look odd"} <= set(caplog.messages)
    assert raised.value.path.name == "frame_000003.ply"
    both = SeveralProblems([DatasetError("one"), RunError("two", "do it", code="second")])
    several = pickle.loads(pickle.dumps(both))
    assert [error.code for error in several.errors] == ["dataset", "second"]
    assert str(several) == str(both) == "2 problems:\n  one\n  two; do it"


def test_few_tasks_are_handed_over_at_once() -> None:
    """Each holds what its chunk needs: those of a long drive would fill the memory."""

    class Pool(ThreadPoolExecutor):
        most = 0

        def submit(self, *task: Any, **named: Any) -> Any:
            self.most = max(self.most, len(handed) - len(done) + 1)
            handed.append(1)
            return super().submit(*task, **named)

    handed: list[int] = []
    done: list[int] = []
    with Pool(2) as pool:
        for number, result in map_unordered(pool, partial(pow, 2), range(40), 4):
            done.append(number)
            assert result == 2**number
    assert sorted(done) == list(range(40))
    assert 1 < pool.most <= 4


def test_workers_end_with_the_process_that_has_started_them(tmp_path: Path) -> None:
    """Else they would go on to write into a run that another command has taken up."""
    sleep = f"import os, time; open(f'{tmp_path}/{{os.getpid()}}', 'w').close(); time.sleep(300)"
    code = (
        "from docdepth.pipeline.parallel import WorkerPool\n"
        f"with WorkerPool(1, jobs=2) as two: list(two.map(exec, [{sleep!r}] * 2))\n"
    )
    process = subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.DEVNULL)
    wait_until(lambda: len(list(tmp_path.iterdir())) == 2)
    process.kill()
    process.wait()
    for path in tmp_path.iterdir():
        wait_until(partial(is_gone, int(path.name)))


def is_gone(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return True
    return False


def wait_until(true: Callable[[], bool]) -> None:
    for _ in range(6000):
        if true():
            return
        time.sleep(0.01)
    raise AssertionError("it does not happen")


def test_chunks_are_even_and_hold_each_frame_once() -> None:
    rng = np.random.default_rng(3)
    for _ in range(200):
        steps = rng.choice([0, 0.1, 1, 3], int(rng.integers(1, 900)))
        items = list(range(len(steps)))
        workers = WorkerPool(jobs=int(rng.integers(2, 9)))
        chunks = workers.cut(items, np.cumsum(steps))
        assert [i for chunk in chunks for i in chunk] == items
        path = [steps[chunk[1:]].sum() + 0.5 * (len(chunk) - 1) for chunk in chunks]
        assert max(path) <= 200 + 3.5
        assert min(map(len, chunks)) >= 1
        if len(chunks) > 1:
            assert max(path) - min(path) <= 2 * 3.5
    assert WorkerPool().cut([1, 2, 3], np.arange(3.0)) == [[1, 2, 3]]
    assert WorkerPool(jobs=2).cut([], np.zeros(0)) == []


def test_each_job_is_counted_in_the_memory_that_a_run_needs(drive: Path, tmp_path: Path) -> None:
    told = [
        float(re.findall(r"([\d.]+) GB of memory", folder.manifest.estimate)[0])
        for folder in (
            run_stages(
                RunInputs(recording=drive, camera=("all",)),
                tmp_path / f"{jobs}",
                Parameters(),
                Execution(jobs=jobs, dry_run=True),
            )
            for jobs in (1, 4)
        )
    ]
    assert told[1] > 2 * told[0] > 0


def test_jobs_and_a_scheduler_exclude_each_other() -> None:
    with pytest.raises(ConfigError, match="give one of them"):
        Execution(jobs=2, scheduler="tcp://127.0.0.1:1")
    with pytest.raises(ConfigError, match="jobs is 0"):
        Execution(jobs=0)


@pytest.mark.parametrize("jobs", [pytest.param(1, marks=pytest.mark.slow), 2])
def test_all_recordings_of_a_folder(drive: Path, whole: Path, tmp_path: Path, jobs: int) -> None:
    root = tmp_path / "set"
    shutil.copytree(drive, root / "a" / "long")
    write_small_drive(root / "b", 4)
    shutil.copytree(root / "b", root / "broken")
    (root / "broken" / "velodyne" / "000002.bin").write_bytes(b"123")
    ended = cli(
        "run", "--all", root, "-o", tmp_path / "runs", "--camera", "all", "--jobs", jobs, "-q"
    )
    assert ended.exit_code == 2, ended.output
    said = " ".join(ended.output.split())
    assert "2 of 3 recordings are done" in said
    assert f"failed: {root}/broken: " in said
    assert "000002.bin" in said
    assert results(tmp_path / "runs" / "a" / "long") == results(whole)
    again = run_all(root, tmp_path / "runs", camera="all")
    assert [one.folder.name for one in again] == ["long", "b", "broken"]
    assert [one.error is None for one in again] == [True, True, False]


def test_a_dry_run_of_all_recordings_makes_nothing(tmp_path: Path) -> None:
    write_small_drive(tmp_path / "set" / "a", 4)
    runs = tmp_path / "runs"
    ended = cli("run", "--all", tmp_path / "set", "-o", runs, "--dry-run", "-q")
    assert "1 of 1 recordings pass all checks" in " ".join(ended.output.split())
    assert not runs.exists()


@pytest.mark.slow
def test_workers_of_a_dask_cluster_make_what_one_makes(
    drive: Path, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    distributed = pytest.importorskip("distributed")
    cut_into(monkeypatch, 2.0)
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0"
    ) as cluster:
        run(drive, tmp_path / "run", camera="all", scheduler=cluster.scheduler_address)
    assert results(tmp_path / "run") == results(whole)


@pytest.mark.parametrize("greeting", [b"", b"SSH-2.0-OpenSSH_9.6\r\n", bytes(64), b"220 "])
def test_a_program_that_is_no_scheduler(
    drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, greeting: bytes
) -> None:
    """It waits to be spoken to, or greets."""
    pytest.importorskip("distributed")
    monkeypatch.setattr(parallel, "_ANSWERS_WITHIN", 0.2)
    answered: list[socket.socket] = []

    def greet() -> None:
        with suppress(OSError):
            answered.append(other.accept()[0])
            answered[0].sendall(greeting)

    with socket.create_server(("127.0.0.1", 0)) as other:
        threading.Thread(target=greet, daemon=True).start()
        address = f"tcp://127.0.0.1:{other.getsockname()[1]}"
        with pytest.raises(RunError, match=f"no Dask scheduler at {address}"):
            run(drive, tmp_path / "run", camera="all", scheduler=address)
    for one in answered:
        one.close()


def test_a_scheduler_that_is_not_there(drive: Path, tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    dask = pytest.importorskip("dask")
    with (
        dask.config.set({"distributed.comm.timeouts.connect": "1s"}),
        pytest.raises(RunError, match=r"no Dask scheduler at tcp://127\.0\.0\.1:9"),
    ):
        run(drive, tmp_path / "run", camera="all", scheduler="tcp://127.0.0.1:9")


@pytest.mark.slow
def test_the_quick_start_tells_what_slurm_is_asked_for() -> None:
    jobqueue = pytest.importorskip("dask_jobqueue")
    text = (Path(__file__).parents[2] / "docs" / "quickstart.md").read_text(encoding="utf-8")
    called = re.search(r"^cluster = SLURMCluster\((.*)\)$", text, re.MULTILINE)
    assert called
    options = eval(f"dict({called[1]})")
    with jobqueue.SLURMCluster(
        **options, interface="lo", scheduler_options={"dashboard_address": ":0"}
    ) as cluster:
        asked = [line for line in cluster.job_script().splitlines() if line.startswith("#SBATCH")]
        assert "--nthreads 1" in cluster.job_script()
        assert "--nworkers 4" in cluster.job_script()
    assert re.findall(r"^#SBATCH.*$", text, re.MULTILINE) == asked
