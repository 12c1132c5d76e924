"""Kill a run at random moments until it is whole: ``python benchmarks/kills.py DRIVE OUT``.

An undisturbed run comes first. Then a second one is killed so many times, each time when a random
number of steps more is done and some milliseconds have passed, and continued by the same command.
Its results are compared with those of the first, byte by byte. Every step of both is counted: what
the second did more often was computed twice.
"""

from __future__ import annotations

import functools
import json
import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

from compare_runs import differences
from results import parser_of, publish

PARTS = ("traj_odometry.ply", "tracks.csv", "calib.json", "traj_camera.ply", "tracks_kitti.txt")
"""Results beside frames, labels and depth maps."""


AGAIN = "inserted into the map"
"""Step that a continued pass does again for each sweep that its map still shows."""


def count_steps(log: Path) -> None:
    """Have this process add a line to a file for each step that it begins."""
    from docdepth.dynamics import sweep_classifier
    from docdepth.odometry import registration, sweeps
    from docdepth.pipeline import classify, render, sweep_store

    descriptor = os.open(log, os.O_WRONLY | os.O_APPEND | os.O_CREAT)

    def counted(owner: Any, name: str, step: str) -> None:
        function: Callable[..., Any] = getattr(owner, name)

        @functools.wraps(function)
        def call(*arguments: Any, **named: Any) -> Any:
            os.write(descriptor, f"{step}\n".encode())
            return function(*arguments, **named)

        setattr(owner, name, call)

    counted(registration.Registration, "align", "registered")
    counted(registration.Registration, "insert", AGAIN)
    counted(sweeps.DeskewedSweeps, "deskewed", "deskewed")
    counted(classify, "label_chunk", "ground of a chunk")
    counted(sweep_classifier.SweepClassifier, "_classify", "voted")
    counted(classify, "track_objects", "tracked")
    counted(sweep_store.FrameStore, "evidence", "labelled")
    counted(render, "compose_depth", "drawn")


def steps_of(log: Path) -> Counter[str]:
    """How often each step was begun."""
    return Counter(log.read_text().splitlines() if log.is_file() else [])


def make(drive: Path, run: Path, log: Path, threads: int) -> subprocess.Popen[bytes]:
    """Start or continue a run in a process of its own."""
    command = [sys.executable, __file__, str(drive), str(run), "--log", str(log)]
    return subprocess.Popen([*command, "--threads", str(threads)], stderr=subprocess.PIPE)


def finish(process: subprocess.Popen[bytes]) -> None:
    """Wait for a run that has to end well."""
    _, said = process.communicate()
    if process.returncode:
        raise SystemExit(f"a run ended with {process.returncode}:\n{said.decode()}")


def progress(log: Path, once: Counter[str]) -> int:
    """Steps of a run that are begun, each counted as often as an undisturbed run has it."""
    steps = steps_of(log)
    return sum(min(steps[step], count) for step, count in once.items() if step != AGAIN)


def kill(
    process: subprocess.Popen[bytes], log: Path, once: Counter[str], steps: int, later: float
) -> bool:
    """Kill a run when it has begun so many steps more, and seconds after; whether it still ran."""
    wanted = progress(log, once) + steps
    while process.poll() is None and progress(log, once) < wanted:
        time.sleep(0.002)
    time.sleep(later)
    if process.poll() is not None:
        return False
    process.send_signal(signal.SIGKILL)
    process.communicate()
    return True


def torture(drive: Path, out: Path, kills: int, seed: int, threads: int = 2) -> dict[str, Any]:
    """Figures of a run that was killed, compared with one that was not."""
    rng, whole, killed = random.Random(seed), out / "whole", out / "killed"
    logs = {run: out / f"{run.name}.log" for run in (whole, killed)}
    finish(make(drive, whole, logs[whole], threads))
    once, moments = steps_of(logs[whole]), []
    total = progress(logs[whole], once)
    for number in range(kills):
        left = total - progress(logs[killed], once)
        steps = 1 + rng.randrange(max(2 * left // (kills - number + 1), 1))
        process = make(drive, killed, logs[killed], threads)
        if not kill(process, logs[killed], once, steps, rng.uniform(0, 0.1)):
            finish(process)
            break
        moments.append(dict(steps_of(logs[killed])))
    finish(make(drive, killed, logs[killed], threads))
    often = steps_of(logs[killed])
    differ = [*differences(whole, killed), *_other_differences(whole, killed)]
    return {
        "kills": len(moments),
        "steps at each kill": moments,
        "steps": dict(once),
        "done more often": {step: often[step] - once[step] for step in once},
        "files that differ": differ,
        "files that are not whole": [p.name for p in killed.rglob("*.part")],
    }


def _other_differences(run: Path, other: Path) -> list[str]:
    pairs = ((name, run / name, other / name) for name in PARTS)
    return [
        name
        for name, a, b in pairs
        if a.is_file() != b.is_file() or (a.is_file() and a.read_bytes() != b.read_bytes())
    ]


def main() -> int:
    parser = parser_of(__doc__)
    parser.add_argument("drive", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--log", type=Path, help="make the run itself, and count its steps here")
    given = parser.parse_args()
    if given.log:
        from docdepth.pipeline.run import run

        count_steps(given.log)
        run(given.drive, given.out, threads=given.threads)
        return 0
    given.out.mkdir(parents=True)
    figures = torture(given.drive, given.out, given.kills, given.seed, given.threads)
    from docdepth.evaluation.tables import Table

    (given.out / "figures.json").write_text(json.dumps(figures, indent=1))
    once, more = figures["steps"], figures["done more often"]
    rows = [
        ("undisturbed", *map(str, once.values())),
        ("done more often", *map(str, more.values())),
    ]
    note = f"{len(figures['files that differ'])} files differ, "
    note += f"{len(figures['files that are not whole'])} are not whole."
    title = f"A run that was killed {figures['kills']} times"
    publish([Table(title, ("", *once), tuple(rows), note)], given.results)
    return bool(figures["files that differ"])


if __name__ == "__main__":
    sys.exit(main())
