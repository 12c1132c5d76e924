"""Cost of a whole run by stage and by what is done, beside KISS-ICP and DUFOMap on the same sweeps.

    python benchmarks/cost.py DRIVE [--frames 0:60] [--repeat 5] [--threads 1] [--code OTHER/python]

``docdepth run`` (default and paper), KISS-ICP and DUFOMap take turns, each in a process of its own,
so that a slow moment of the machine hits all of them. Processor time is user and system time of all
threads and children. KISS-ICP reads the sweeps through docdepth, deskews them and has its own
settings. DUFOMap (pip install dufomap; left out without it) classifies sweeps that are deskewed, in
memory and have poses: what that takes is part of ``all``, not of ``classify``. Ratios are medians
of those of each turn.

The second table says what docdepth spends its processor time on, in that of KISS-ICP. Each step
counts the thread that does it, so with ``--threads 1`` nothing is missing: the rest of the run is
its start, its end and the work between the steps.

``--code`` measures another version of docdepth, too, and ``--set render.behind=0`` (repeat it for
more) the default with other parameters.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from results import parser_of, publish

STAGES = {"run_odometry": "odometry", "run_classify": "classify", "run_render": "render"}
STEPS = {
    "registration": ("poses",),
    "deskewing, checks": ("deskew", "check"),
    "ground": ("ground: insert", "ground: grow", "ground: label"),
    "meshes": ("meshes",),
    "votes": ("key frames", "vote"),
    "objects of a sweep": ("objects", "detections"),
    "tracks": ("tracks",),
    "sweeps made ready to draw": ("frames",),
    "drawing": ("draw", "layers"),
    "files": ("read", "write"),
}
"""What is done, and the names by which a run takes its times."""

Times = dict[str, tuple[float, float]]
"""Processor and wall seconds by stage; ``all`` includes start and end of the process."""


def clocks() -> tuple[float, float]:
    """Processor time of this process and its children, and wall time [s]."""
    return sum(os.times()[:4]), time.perf_counter()


def measured(work: Callable[[], object]) -> tuple[float, float]:
    before = clocks()
    work()
    after = clocks()
    return after[0] - before[0], after[1] - before[1]


@contextmanager
def steps_timed() -> Iterator[dict[str, float]]:
    """Processor seconds of threads by the names of :class:`docdepth.concurrency.Timer`."""
    from docdepth.concurrency import Timer

    spent: dict[str, float] = defaultdict(float)
    plain = Timer.__call__

    @contextmanager
    def timed(self: Timer, name: str) -> Iterator[None]:
        before = time.thread_time()
        with plain(self, name):
            yield
        with self._lock:
            spent[name] += time.thread_time() - before

    Timer.__call__ = timed  # type: ignore[method-assign]
    try:
        yield spent
    finally:
        Timer.__call__ = plain  # type: ignore[method-assign]


def run_docdepth(
    drive: str, frames: str, preset: str, settings: list[str], threads: int
) -> tuple[Times, int]:
    """Times of the stages and steps of a run, and its sweeps."""
    import docdepth.pipeline.run as pipeline
    from docdepth import cli
    from docdepth.cli.terminal import app

    times: Times = {}
    for name, stage in STAGES.items():
        function = getattr(pipeline, name)

        def timed(*args: Any, of: Any = function, stage: str = stage, **named: Any) -> None:
            times[stage] = measured(lambda: of(*args, **named))

        setattr(pipeline, name, timed)
    for prepare in ("keep_memory", "take_one_blas_thread", "have_threads_sleep"):
        getattr(cli, prepare, lambda: None)()  # as main() does; each version lacks some
    with tempfile.TemporaryDirectory() as folder, steps_timed() as spent:
        run = Path(folder) / "run"
        command = ["run", drive, "-o", str(run), "--preset", preset, "--frames", frames, "-q"]
        command += ["--threads", str(threads)]
        command += [word for setting in settings for word in ("--set", setting)]
        app(command, standalone_mode=False)
        for step, names in STEPS.items():
            times[f"step {step}"] = (sum(spent[name] for name in names), 0.0)
        return times, len(list((run / "frames").glob("*.ply")))


def run_kiss_icp(drive: str, frames: str) -> tuple[Times, int]:
    """KISS-ICP with its own settings: points up to 100 m, as docdepth, in voxels of 1 m."""
    import numpy as np
    from kiss_icp.config import load_config
    from kiss_icp.kiss_icp import KissICP

    from docdepth.datasets import open_dataset

    dataset = open_dataset(Path(drive), frames=frames)
    odometry = KissICP(load_config(None))

    def register() -> None:
        for k in range(len(dataset)):
            sweep = dataset.sweep(k)
            usable = np.isfinite(sweep.points).all(axis=1) & sweep.points.any(axis=1)
            times = sweep.relative_time
            none = np.empty(0)
            odometry.register_frame(
                sweep.points[usable].astype(np.float64),
                none if times is None else times[usable].astype(np.float64),
            )

    return {"odometry": measured(register)}, len(dataset)


def run_dufomap(drive: str, frames: str) -> tuple[Times, int]:
    """DUFOMap with the settings of benchmarks/peers.py."""
    import numpy as np
    from peers import Drive, dufomap

    from docdepth.datasets import open_dataset, usable_points
    from docdepth.odometry.odometry import register_drive

    dataset = open_dataset(Path(drive), frames=frames)
    odometry = register_drive(dataset, poses=dataset.poses)
    points = [sweep.points[usable_points(sweep.points)] for sweep in odometry.sweeps]
    given = Drive(odometry.trajectory.poses, "", points.__getitem__, lambda _: np.empty(0))
    return {"classify": measured(lambda: dufomap(given, 2, 0.2, 0.1, 0))}, len(points)


PEERS = {"KISS-ICP": run_kiss_icp, "DUFOMap": run_dufomap}


def run_child(
    job: str, options: argparse.Namespace, code: str | None, settings: list[str]
) -> tuple[Times, int]:
    """One job in a process of its own."""
    environment = dict(os.environ)
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # an installed package is compiled once
    if code:
        environment["PYTHONPATH"] = code
    command = [sys.executable, __file__, options.drive, "--frames", options.frames, "--job", job]
    command += ["--threads", str(options.threads)]
    command += [word for setting in settings for word in ("--set", setting)]
    before = clocks()
    result = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    after = clocks()
    told = json.loads(result.stdout.splitlines()[-1])
    times = {stage: (cpu, wall) for stage, (cpu, wall) in told["times"].items()}
    times["all"] = (after[0] - before[0], after[1] - before[1])
    return times, told["sweeps"]


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("drive")
    parser.add_argument("--frames", default="0:60", help="sweeps A to B-1")
    parser.add_argument("--repeat", type=int, default=5, help="turns")
    parser.add_argument("--threads", type=int, default=0, help="of docdepth; 0 for all cores")
    parser.add_argument("--code", help="python folder of another version, measured too")
    parser.add_argument(
        "--set", action="append", default=[], metavar="NAME=VALUE", help="measured as default, set"
    )
    parser.add_argument("--job", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.job:
        if options.job in PEERS:
            times, sweeps = PEERS[options.job](options.drive, options.frames)
        else:
            times, sweeps = run_docdepth(
                options.drive, options.frames, options.job, options.set, options.threads
            )
        print(json.dumps({"times": times, "sweeps": sweeps}))
        return
    jobs: dict[str, tuple[str, str | None, list[str]]] = {
        name: (name, None, []) for name in ("KISS-ICP", "default", "paper")
    }
    if find_spec("dufomap"):
        jobs["DUFOMap"] = ("DUFOMap", None, [])
    if options.code:
        jobs["other default"] = ("default", options.code, [])
    if options.set:
        jobs["default, set"] = ("default", None, options.set)
    turns: list[dict[str, Times]] = []
    sweeps = 1
    for turn in range(options.repeat):
        turns.append({})
        for name, (job, code, settings) in jobs.items():
            turns[-1][name], sweeps = run_child(job, options, code, settings)
            print(f"turn {turn + 1}: {name}", file=sys.stderr)
    publish([table(turns, sweeps), step_table(turns, sweeps)], options.results)


HEADER = ("", "stage", "processor ms a sweep", "wall", "processor, KISS-ICP = 1", "wall")


def table(turns: list[dict[str, Times]], sweeps: int) -> Any:
    """Medians per sweep [ms], and of the ratios to KISS-ICP's registration in the same turn."""
    from docdepth.evaluation.tables import Table

    rows = []
    for name in turns[0]:
        for stage in turns[0][name]:
            if stage.startswith("step "):
                continue
            spent = [turn[name][stage] for turn in turns]
            peer = [turn["KISS-ICP"]["odometry"] for turn in turns]
            ms = [f"{1e3 * statistics.median(s[k] for s in spent) / sweeps:.0f}" for k in (0, 1)]
            ratios = [[s[k] / p[k] for s, p in zip(spent, peer, strict=True)] for k in (0, 1)]
            rows.append((name, stage, *ms, *(f"{statistics.median(r):.2f}" for r in ratios)))
    title = f"Cost of a run: {sweeps} sweeps, medians of {len(turns)} turns"
    return Table(title, HEADER, tuple(rows))


def step_table(turns: list[dict[str, Times]], sweeps: int) -> Any:
    """Medians of the processor time of each step over that of KISS-ICP in the same turn."""
    from docdepth.evaluation.tables import Table

    def spent(times: Times, what: str) -> float:
        if what == "the rest":
            return spent(times, "all") - sum(spent(times, f"step {step}") for step in STEPS)
        return times[what][0]

    def ratio(name: str, what: str) -> str:
        ratios = [spent(turn[name], what) / spent(turn["KISS-ICP"], "odometry") for turn in turns]
        return f"{statistics.median(ratios):.2f}"

    names = [name for name in turns[0] if name not in PEERS]
    rows = [
        (what.removeprefix("step "), *(ratio(name, what) for name in names))
        for what in (*(f"step {step}" for step in STEPS), "the rest", "all")
    ]
    kiss = statistics.median(turn["KISS-ICP"]["odometry"][0] for turn in turns)
    title = f"What is done, processor time; KISS-ICP = 1, {1e3 * kiss / sweeps:.0f} ms a sweep"
    return Table(title, ("what", *names), tuple(rows))


if __name__ == "__main__":
    main()
