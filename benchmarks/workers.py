"""Two workers of a Dask cluster on this machine, and one of two killed on the way.

    python benchmarks/workers.py DRIVE OUT [--frames 0:60]

A scheduler on 127.0.0.1 and its workers, of one thread each, are processes of their own. The same
drive is run by this process alone, by one worker, by two, and by two of which one is killed while
it votes. Products of all are compared byte by byte with those of the first. Odometry stays in this
process. Processor time is that of all processes together, wall time that which each stage records.
"""

from __future__ import annotations

import argparse
import json
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from cost import clocks

import docdepth
from docdepth.io.run_folder import RunFolder

KILLED_AFTER = 5.0
"""So many seconds after votes have begun a worker is killed."""

NOTES = (".docdepth", "run.yaml", "report/index.html")


@contextmanager
def started(*command: str) -> Iterator[subprocess.Popen[bytes]]:
    """A process of Dask, for as long as it is needed."""
    process = subprocess.Popen(["dask", *command], stderr=subprocess.DEVNULL)
    try:
        yield process
    finally:
        process.terminate()
        process.wait()


def products(run: Path) -> dict[str, bytes]:
    """All files but notes, times and the page that shows them."""
    names = (p.relative_to(run).as_posix() for p in run.rglob("*") if p.is_file())
    return {name: (run / name).read_bytes() for name in names if not name.startswith(NOTES)}


def make(options: argparse.Namespace, run: Path, workers: int, is_killed: bool) -> dict[str, Any]:
    """Times of a run by so many workers; 0 for this process alone."""
    before = clocks()
    address = f"tcp://127.0.0.1:{options.port}"
    with ExitStack() as stack:
        hosts = [
            stack.enter_context(started(*command))
            for command in [
                ["scheduler", "--host", "127.0.0.1", "--port", str(options.port), "--no-dashboard"],
                *[["worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard"]] * workers,
            ]
            if workers
        ]

        killer = threading.Timer(KILLED_AFTER, lambda: hosts[-1].send_signal(signal.SIGKILL))

        def progress(stage: str, done: int, total: int) -> None:
            if stage == "classify" and is_killed and killer.ident is None:
                killer.start()

        where = {"threads": 1, "scheduler": address if workers else None}
        docdepth.run(options.drive, run, frames=options.frames, progress=progress, **where)
    after, stages = clocks(), RunFolder(run).manifest["stages"]
    return {
        "workers": workers,
        "killed": is_killed and hosts[-1].returncode == -signal.SIGKILL,
        "processor_s": round(after[0] - before[0], 1),
        "wall_s": {stage: round(state["wall_seconds"], 1) for stage, state in stages.items()},
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("drive", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--frames", default="0:60")
    parser.add_argument("--port", type=int, default=18786)
    options = parser.parse_args()
    first, failed = options.out / "alone", False
    for name, workers, killed in (
        ("alone", 0, False), ("one", 1, False), ("two", 2, False), ("one_of_two", 2, True)
    ):  # fmt: skip
        row = make(options, options.out / name, workers, killed)
        a, b = products(first), products(options.out / name)
        row["files"] = len(b)
        row["differ"] = sorted(n for n in a.keys() | b.keys() if a.get(n) != b.get(n))
        failed |= bool(row["differ"])
        print(json.dumps({name: row}))
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
