"""Feed changed files to the readers: ``python benchmarks/fuzz.py OUT [READER ...] --seconds 60``.

Atheris (``pip install atheris``) changes small files byte by byte and keeps what reaches new lines
of docdepth. Whatever ends otherwise than in a result or an error of docdepth is a find: another
exception, more than 2 GB of memory, more than two seconds of the processor. Each kind of find is
kept once, with the file, in ``OUT/READER/finds``; ``figures.json`` has the executions and finds of
each reader.
"""

from __future__ import annotations

import json
import os
import re
import resource
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from pathlib import Path
from typing import Any

from results import parser_of, publish

MEMORY = 2 << 30  # bytes more than the readers and their libraries take
SLOWEST = 2.0  # seconds of the processor for one file
LONGEST = 8192  # bytes of a file


def fuzz(name: str, out: Path, seconds: int) -> None:
    """Fuzz one reader in this process, which ends with it."""
    import atheris

    with atheris.instrument_imports(include=["docdepth"]):
        from fuzz_readers import READERS

        from docdepth.errors import DocDepthError
    warnings.simplefilter("ignore")
    reader, finds = READERS[name], out / "finds"
    corpus = out / "corpus"
    for folder in (finds, corpus):
        folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as seeds:
        for k, content in enumerate(reader.contents(Path(seeds))):
            (corpus / f"seed{k}").write_bytes(content)
    place = Path(tempfile.mkdtemp(dir="/dev/shm" if Path("/dev/shm").is_dir() else None))
    file, known = place / reader.file, set[str]()

    def one(data: bytes) -> None:
        file.write_bytes(data)
        begun = time.process_time()
        for read in reader.reads:
            try:
                read(file)
            except DocDepthError:
                pass
            except Exception as error:
                keep(_kind(error), data, traceback.format_exc())
        if (taken := time.process_time() - begun) > SLOWEST:
            keep("slow", data, f"{taken:.1f} s")

    def keep(kind: str, data: bytes, told: str) -> None:
        if kind not in known:
            known.add(kind)
            (finds / f"{kind}.input").write_bytes(data)
            (finds / f"{kind}.txt").write_text(told)

    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, used + MEMORY))
    options = [f"-max_total_time={seconds}", f"-max_len={LONGEST}", "-print_final_stats=1"]
    options += ["-rss_limit_mb=0", "-timeout=60", f"-artifact_prefix={finds}/", "-verbosity=0"]
    atheris.Setup([sys.argv[0], *options, str(corpus)], one)
    atheris.Fuzz()


def _kind(error: BaseException) -> str:
    """Name of an error and where docdepth last had it in hand."""
    place = [f for f in traceback.extract_tb(error.__traceback__) if "docdepth" in f.filename]
    at = f"{Path(place[-1].filename).stem}_{place[-1].lineno}" if place else "here"
    return f"{type(error).__name__}_{at}"


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("readers", nargs="*")
    parser.add_argument("--seconds", type=int, default=60, help="for each reader")
    parser.add_argument("--here", action="store_true", help="one reader, in this process")
    given = parser.parse_args()
    if given.here:
        return fuzz(given.readers[0], given.out, given.seconds)
    from fuzz_readers import READERS

    if unknown := set(given.readers) - READERS.keys():
        parser.error(f"unknown reader {', '.join(unknown)}; there are {', '.join(READERS)}")
    tests = Path(__file__).parents[1] / "tests"  # they write what is changed
    known = os.environ.get("PYTHONPATH")
    env = os.environ | {
        "PYTHONPATH": os.pathsep.join(filter(None, [str(tests), str(tests / "datasets"), known]))
    }
    file = given.out / "figures.json"
    figures: dict[str, dict[str, Any]] = {}
    for name in given.readers or READERS:
        out = given.out / name
        command = [sys.executable, __file__, str(out), name, "--seconds", str(given.seconds)]
        done = subprocess.run([*command, "--here"], capture_output=True, text=True, env=env)
        runs = re.search(r"number_of_executed_units:\s+(\d+)", done.stderr)
        finds = sorted(path.stem for path in (out / "finds").glob("*.txt"))
        figures = json.loads(file.read_text()) if file.is_file() else {}
        before = figures.get(name, {"executions": 0})["executions"]
        figures[name] = {
            "executions": before + (int(runs[1]) if runs else 0), "finds": finds,
            "ended": done.returncode,
        }  # fmt: skip
        if done.returncode:
            (out / "end.txt").write_text(done.stderr[-4000:])
        file.write_text(json.dumps(figures, indent=1))
        print(name, figures[name], file=sys.stderr, flush=True)
        if done.returncode:
            print(done.stderr[-1000:], file=sys.stderr)
    from docdepth.evaluation.tables import Table

    rows = [(name, f"{f['executions']:,}", str(len(f["finds"]))) for name, f in figures.items()]
    publish([Table("Changed files", ("reader", "executions", "finds"), tuple(rows))], given.results)


if __name__ == "__main__":
    main()
