"""Feed changed files to the readers: ``python benchmarks/fuzz.py OUT [READER ...] --seconds 60``.

``python benchmarks/fuzz.py OUT --runs 1000`` changes a finished run folder in so many random ways,
as a stranger might: links to elsewhere, other types, sizes and names, values and tags of run.yaml,
records, arrays and images. A verb works on each. Whatever ends otherwise than in a result or one
error, or touches a file outside of the folder, is a find.

Atheris (``pip install atheris``) changes small files byte by byte and keeps what reaches new lines
of docdepth. Whatever ends otherwise than in a result or an error of docdepth is a find: another
exception, more than 2 GB of memory, more than two seconds of the processor. Each kind of find is
kept once, with the file, in ``OUT/READER/finds``; ``figures.json`` has the executions and finds of
each reader.
"""

from __future__ import annotations

import json
import os
import pkgutil
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

import yaml
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


VERBS = (
    "run RUN", "run RUN --set dynamics.tolerance=0.3", "run RUN --layers normal",
    "run RUN --dry-run", "run RUN --set render.behind=30", "run DRIVE -o RUN --force",
    "run RUN --keep results", "render RUN --format exr", "status RUN", "map RUN", "inspect RUN",
    "video RUN",
    "evaluate labels RUN --labels TRUE/labels", "evaluate depth RUN --depth TRUE/depth",
    "evaluate tracks RUN --labels TRUE/labels", "evaluate held-out RUN --every 2",
    "evaluate trajectories RUN --poses TRUE/traj_odometry.ply", "convert RUN OUT --to label",
    "convert RUN OUT --to proj_depth", "convert RUN OUT --to tum", "convert RUN OUT --to mcap",
    "convert RUN OUT --to nerfstudio", "convert RUN OUT --to occupancy",
)  # fmt: skip
EVIL: tuple[Any, ...] = (
    "../outside", "../../outside/kept.txt", "/etc/passwd", ".", "..", "", "a/b", "x" * 5000, "\0",
    "\x1b[31mred", "\udcff", -1, 0, 1e308, 10**30, float("nan"), True, None, [], {}, [[]], "nan",
)  # fmt: skip
TAGS = (
    '!!float ""', '!!int "x"', "!!binary '*'", "!!timestamp 9999-99-99", "!!python/name:os.system",
    "!!python/object/apply:os.system [touch ../outside/tag]", "!!set {a, b}", "!!omap [a: 1]",
    "!unknown 1", "&a [*a, *a]", "*nowhere", "!!null x", "!!bool 3", "0x" + "f" * 5000, "[" * 5000,
    "<<: 3", "1:" * 2000 + "1", ".inf", "2001-01-01", "? ? 1", "%TAG ! x", "\u2028", "---\n3",
)  # fmt: skip
"""What stands for a value in YAML and is none."""


def changed(run: Path, outside: Path, rng: random.Random) -> str:
    """Change one thing of a run folder; what was changed."""
    entries = sorted(run.rglob("*"))
    # Few files decide more than many frames.
    deciding = [f for f in entries if f.suffix in (".yaml", ".json") or "records" in f.parts]
    path = rng.choice(deciding if deciding and rng.random() < 0.5 else entries)
    ways = ["link", "type", "size", "bytes", "other", "name", "value", "value", "value"]
    way = rng.choice([*ways, "tag", "tag"] if path.suffix == ".yaml" else ways)
    told = f"{way} {path.relative_to(run)}"
    if way == "link":
        target = rng.choice([outside, outside / "kept.txt", run.parent, path, Path("/dev/zero")])
        _remove(path)
        path.symlink_to(target)
        return f"{told} -> {target}"
    if way == "type":
        _remove(path)
        makers: list[Callable[[], Any]] = [path.mkdir, path.touch, lambda: os.mkfifo(path), dict]
        rng.choice(makers)()
        return told
    if way == "name":
        name = rng.choice([path.name + ".old", "\x1b[31mred", "x" * 200, "ä \udcff", "-"])
        to = path.with_name(name)
        path.rename(to) if not os.path.lexists(to) else None
        return f"{told} -> {to.name!r}"
    if not path.is_file() or path.is_symlink():
        return told
    if way == "size" and rng.random() < 0.3:
        path.unlink()
        os.link(outside / "kept.txt", path)
        return f"{told}, a hard link"
    content = path.read_bytes()
    if way == "size":
        kept = rng.randrange(len(content) + 1)
        path.write_bytes(rng.choice([content[:kept], content * 3, content + bytes(1 << 16), b""]))
    elif way == "other":
        path.write_bytes(rng.choice([e for e in entries if e.is_file()]).read_bytes())
    elif way == "tag":
        scalars = list(re.finditer(rb"(?<=: ).+", content))
        at, tag = rng.choice(scalars).span() if scalars else (0, 0), rng.choice(TAGS)
        path.write_bytes(content[: at[0]] + tag.encode() + content[at[1] :])
        told += f" {tag[:40]}"
    elif way == "value" and path.suffix in (".yaml", ".json"):
        try:
            values = yaml.safe_load(content)
        except (yaml.YAMLError, ValueError):  # it was changed before
            return told
        told += f" {_change_value(values, rng)}"
        path.write_text(yaml.safe_dump(values) if path.suffix == ".yaml" else json.dumps(values))
    elif way == "value" and b"\n" in content[:500]:
        words = re.split(rb"([\s,/:\"]+)", content)
        k = 2 * rng.randrange((len(words) + 1) // 2)
        words[k] = str(rng.choice(EVIL)).encode(errors="surrogateescape")
        path.write_bytes(b"".join(words))
        told += f" {words[k][:40]!r}"
    else:
        flipped = bytearray(content)
        for _ in range(rng.choice([1, 3, 30])) if content else ():
            flipped[rng.randrange(min(len(content), rng.choice([200, 10**9])))] = rng.randrange(256)
        path.write_bytes(flipped)
    return told


def _change_value(values: Any, rng: random.Random) -> str:
    """Change a value, or a name, anywhere in what YAML or JSON holds."""
    where: list[tuple[Any, Any]] = []

    def collect(inside: Any) -> None:
        keys = inside if isinstance(inside, dict) else range(len(inside))
        for key in keys if isinstance(inside, dict | list) else ():
            where.append((inside, key))
            if isinstance(inside[key], dict | list):
                collect(inside[key])

    collect(values if isinstance(values, dict | list) else {})
    if not where:
        return ""
    inside, key = rng.choice(where)
    evil = rng.choice(EVIL)
    if isinstance(inside, dict) and rng.random() < 0.25:
        inside[str(evil)] = inside.pop(key)
    else:
        inside[key] = evil
    return f"{key} = {str(evil)[:40]!r}"


def _remove(path: Path) -> None:
    shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink()


def _seen(folder: Path, but: Path) -> dict[str, tuple[object, ...]]:
    """What a watch knows of all files of a folder that do not lie in another."""
    return {
        str(f): (f.lstat().st_mode, f.lstat().st_mtime_ns, f.lstat().st_size, f.lstat().st_ino)
        for f in sorted(folder.rglob("*"))
        if f != but and but not in f.parents
    }


def fuzz_runs(out: Path, count: int, first: int) -> None:
    """Work on changed run folders; each find is written to ``OUT/finds.txt``."""
    import docdepth
    from docdepth.cli import main as docdepth_main

    for module in pkgutil.walk_packages(docdepth.__path__, "docdepth."):  # once, not in each child
        with suppress(ImportError):
            import_module(module.name) if not module.name.endswith("__main__") else None
    from small_drive import write_small_drive

    place, finished = out / "place", out / "finished"
    place.mkdir(parents=True)
    run, outside, result = place / "run", place / "outside", place / "result"
    (here := out / "here").mkdir()  # for what has no name
    drive = write_small_drive(place / "drive")
    for folder in ("frames", "labels", "depth", "records"):
        (outside / folder).mkdir(parents=True)
        (outside / folder / "kept.txt").write_text("of somebody else")
    (outside / "kept.txt").write_text("of somebody else")

    def work(arguments: list[str]) -> tuple[int, str]:
        """Exit status and standard error of a verb, in a child."""
        told, child = out / "stderr.txt", os.fork()
        if not child:
            os.chdir(here)
            signal.alarm(120)
            resource.setrlimit(resource.RLIMIT_AS, (3 * MEMORY, 3 * MEMORY))
            with told.open("w") as stream:
                os.dup2(stream.fileno(), 2)
            os.dup2(os.open(os.devnull, os.O_RDWR), 1)
            sys.argv = ["docdepth", *arguments]
            try:
                docdepth_main()
            except SystemExit as end:
                sys.stderr.flush()
                os._exit(int(end.code or 0))
            os._exit(70)
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), told.read_text(errors="replace")

    places = {"DRIVE": drive, "RUN": run, "OUT": result, "TRUE": finished}

    def words(verb: str) -> list[str]:
        for name, path in places.items():
            verb = re.sub(rf"\b{name}\b", str(path), verb)
        return verb.split()

    assert work(words("run DRIVE -o RUN -q"))[0] == 0
    run.rename(finished)
    for verb in VERBS:  # each does something here
        shutil.copytree(finished, run)
        code, said = work(words(verb))
        if code not in (0, 1):
            raise SystemExit(f"{verb}: {said}")
        for path in (run, result):
            _remove(path) if os.path.lexists(path) else None
    for number in range(first, first + count):
        rng = random.Random(number)
        shutil.copytree(finished, run, symlinks=True)
        told = [changed(run, outside, rng) for _ in range(rng.choice([1, 1, 2]))]
        verb = rng.choice(VERBS)
        before = _seen(place, run)
        begun = time.time()
        code, said = work(words(verb))
        _remove(result) if os.path.lexists(result) else None
        errors = len(re.findall("^error", said, re.M))
        wrong = [
            what
            for what, is_so in {
                "ended": code not in (0, 1, 2),
                "bug": "has a bug" in said or "Traceback" in said,
                "sentences": errors != (code == 2),
                "outside": _seen(place, run) != before,
                "slow": time.time() - begun > 60,
            }.items()
            if is_so
        ]
        if wrong:
            tail = said.strip().splitlines()[-3:]
            with (out / "finds.txt").open("a") as stream:
                print(number, wrong, code, verb, told, *tail, sep="\n  ", file=stream)
        _remove(run) if os.path.lexists(run) else None
        if number % 50 == 49:
            print(f"{number + 1 - first} of {count}", file=sys.stderr, flush=True)
        if "outside" in wrong:
            raise SystemExit(f"{number}: {verb} {told} touched a file outside")


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("readers", nargs="*")
    parser.add_argument("--seconds", type=int, default=60, help="for each reader")
    parser.add_argument("--here", action="store_true", help="one reader, in this process")
    parser.add_argument("--runs", type=int, help="change a run folder in so many ways")
    parser.add_argument("--first", type=int, default=0, help="number of the first of these ways")
    given = parser.parse_args()
    if given.runs:
        sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
        return fuzz_runs(given.out.absolute(), given.runs, given.first)
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
