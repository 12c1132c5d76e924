"""How often a run reads and triangulates its sweeps, and how many bytes it moves, per depth map.

    python benchmarks/io_per_map.py DRIVE [--preset default] [--keep RUN]

Runs all stages in this process and counts, for each stage: sweeps read from the recording, frames
read from the run folder, sweeps triangulated, and bytes read and written by system calls
(``/proc/self/io``, so Linux only; files that are mapped into memory are not counted). One thread is
the default, since sweeps that worker processes read cannot be counted here.

Counts by replacing functions by name, so it runs on older versions, too:
``PYTHONPATH=OTHER/python python benchmarks/io_per_map.py DRIVE``.
"""

from __future__ import annotations

import argparse
import functools
import importlib
import pkgutil
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

STAGES = {"run_odometry": "odometry", "run_classify": "classify", "run_render": "render"}
COLUMNS = ("sweeps read", "frames read", "triangulated", "MB read", "MB written")
# Class and method of each event; the class has another name or place in older versions.
EVENTS = {
    ("ScanMesh", "__init__"): "triangulated",
    ("Surface", "__init__"): "triangulated",
    ("RunFolder", "frame"): "frames read",
    ("RunFolder", "points"): "frames read",
}


class Counters:
    """Counts events and bytes by the stage that is running."""

    def __init__(self) -> None:
        self.stage = "other"
        self.counts: dict[str, Counter[str]] = {}

    def add(self, event: str, amount: float = 1) -> None:
        self.counts.setdefault(self.stage, Counter())[event] += amount

    def counting(self, event: str, function: Any) -> Any:
        """``function``, which counts an event at each call."""

        @functools.wraps(function)
        def wrapper(*arguments: Any, **named: Any) -> Any:
            self.add(event)
            return function(*arguments, **named)

        return wrapper

    def in_stage(self, name: str, function: Any) -> Any:
        """``function``, whose events and bytes belong to stage ``name``."""

        @functools.wraps(function)
        def wrapper(*arguments: Any, **named: Any) -> Any:
            outer, self.stage, before = self.stage, name, bytes_moved()
            try:
                return function(*arguments, **named)
            finally:
                for column, start, end in zip(COLUMNS[3:], before, bytes_moved(), strict=True):
                    self.add(column, (end - start) / 1e6)
                self.stage = outer

        return wrapper


def bytes_moved() -> tuple[int, int]:
    """Bytes that this process and its finished children have read and written."""
    lines = Path("/proc/self/io").read_text().splitlines()
    moved = {name: int(value) for name, value in (line.split(": ") for line in lines)}
    return moved["rchar"], moved["wchar"]


def install(counters: Counters) -> None:
    """Replace the functions of docdepth that are counted."""
    import docdepth

    for found in pkgutil.walk_packages(docdepth.__path__, "docdepth."):
        if found.name != "docdepth.__main__":
            importlib.import_module(found.name)
    modules = [module for name, module in sys.modules.items() if name.startswith("docdepth")]
    patched: set[tuple[type, str]] = set()
    for module in modules:
        for name, value in list(vars(module).items()):
            if name in STAGES and callable(value):
                setattr(module, name, counters.in_stage(STAGES[name], value))
            if not isinstance(value, type) or value.__module__ == "docdepth._core":
                continue  # the core has classes of the same names
            if not value.__module__.startswith("docdepth."):
                continue
            events = {method: event for (owner, method), event in EVENTS.items() if owner == name}
            if value.__module__.startswith("docdepth.datasets.") and "sweep" in vars(value):
                events["sweep"] = "sweeps read"
            for method, event in events.items():
                if method in vars(value) and (value, method) not in patched:
                    patched.add((value, method))
                    setattr(value, method, counters.counting(event, vars(value)[method]))


def main(arguments: list[str] | None = None) -> dict[str, Counter[str]]:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("drive", type=Path)
    parser.add_argument("--preset", default="default", choices=["default", "paper"])
    parser.add_argument("--keep", type=Path, help="write the run here instead of a temporary one")
    parser.add_argument("--threads", type=int, default=1)
    options = parser.parse_args(arguments)
    counters = Counters()
    install(counters)
    import docdepth
    from docdepth.cli import app

    with tempfile.TemporaryDirectory() as temporary:
        run = options.keep or Path(temporary) / "run"
        verb = ["run", str(options.drive), "-o", str(run), "--preset", options.preset]
        app([*verb, "--threads", str(options.threads)], standalone_mode=False)
        maps = len(list((run / "depth").rglob("*.png")))
        sweeps = len(list((run / "frames").glob("*.ply")))
    total: Counter[str] = Counter()
    for counts in counters.counts.values():
        total.update(counts)
    print(f"docdepth {docdepth.__version__}, {options.preset}: {sweeps} sweeps, {maps} depth maps")
    print(f"{'per depth map':14}" + "".join(f"{name:>14}" for name in COLUMNS))
    for stage, counts in {**counters.counts, "all": total}.items():
        print(f"{stage:14}" + "".join(f"{counts[name] / maps:14.2f}" for name in COLUMNS))
    return {**counters.counts, "all": total}


if __name__ == "__main__":
    main()
