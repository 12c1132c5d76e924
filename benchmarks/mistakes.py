"""Tries ways to be wrong on the real command line, and prints what each is answered with.

``python benchmarks/mistakes.py [--only WORD]`` makes a tiny synthetic drive and runs of it in a
temporary folder. A case damages a copy and gives a command. It is well if the command

- refuses: exit code 2 and a sentence,
- repairs (where the case allows it): exit code 0, and depth and labels are those of a fresh run, or
- warns (the same): exit code 0 and a warning.

A traceback, a bug (exit code 1), a signal, a silent wrong result or more than 60 s is a failure;
the exit code of the script is 1 then.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from mistakes_of_inputs import INPUTS
from mistakes_of_settings import SETTINGS
from mistakes_of_state import STATES
from mistakes_of_strangers import STRANGERS

LIMIT = 60.0
"""Seconds that a command may take."""


# What was done, the command, how a copy is spoilt (or the whole call), what may come of it.
Case = tuple[str, list[str], Callable[[Path], object] | None, str]


@dataclass(frozen=True)
class Outcome:
    """What a mistake was answered with."""

    what: str
    code: int
    sentence: str
    seconds: float
    verdict: str


class Place:
    """A folder of its own for each case: a drive in ``d``, a run of it in ``r``."""

    def __init__(self, root: Path, number: int) -> None:
        self.path = root / f"case{number:03d}"
        self.path.mkdir()
        shutil.copytree(root / "drive", self.path / "d")
        shutil.copytree(root / "run", self.path / "r")
        # A run knows its recording by an absolute path.
        manifest = self.path / "r" / "run.yaml"
        text = manifest.read_text()
        manifest.write_text(text.replace(str(root / "drive"), str(self.path / "d")))


def products(run: Path) -> dict[str, bytes]:
    """Depth maps and labels of a run."""
    files = [*run.glob("depth/*.png"), *run.glob("labels/*.label")]
    return {str(f.relative_to(run)): f.read_bytes() for f in files if f.is_file()}


def call(words: list[str], folder: Path, **more: str) -> subprocess.CompletedProcess[bytes]:
    """Run docdepth; its exit code is 124 where it takes too long."""
    command = [sys.executable, "-m", "docdepth", *words]
    try:
        return subprocess.run(
            command, cwd=folder, capture_output=True, timeout=LIMIT, env={**os.environ, **more}
        )
    except subprocess.TimeoutExpired as error:
        return subprocess.CompletedProcess(command, 124, error.stdout or b"", error.stderr or b"")


def attempt(root: Path, number: int, case: Case, fresh: dict[str, bytes]) -> Outcome:
    """Make a mistake and judge the answer."""
    what, words, spoil, expected = case
    place = Place(root, number)
    start = time.monotonic()
    spoilt = spoil(place.path) if spoil else None
    called = isinstance(spoilt, subprocess.CompletedProcess)
    ended = spoilt if called else call(words, place.path)
    seconds = time.monotonic() - start
    messages = ended.stderr.decode(errors="replace")
    lines = [line for line in messages.splitlines() if line.startswith(("error:", "warning:"))]
    sentence = (lines or messages.splitlines() or [""])[-1].replace(f"{place.path}/", "")
    output = place.path / ("n" if (place.path / "n").exists() else "r")
    made = products(output)
    verdict = judge(ended.returncode, messages, expected, made == fresh)
    shutil.rmtree(place.path, ignore_errors=True)
    return Outcome(what, ended.returncode, sentence, seconds, verdict)


def judge(code: int, messages: str, expected: str, same: bool) -> str:
    """``refused``, ``repaired``, ``warned``, or what is wrong."""
    if "Traceback" in messages:
        return "TRACEBACK"
    if code < 0 or code > 128:
        return "SIGNAL"
    if code == 124:
        return "TOO SLOW"
    if code == 2:
        said = any(line.startswith("error: ") for line in messages.splitlines())
        return "refused" if said else "NO SENTENCE"
    if code != 0:
        return "BUG"
    if "repaired" in expected and same:
        return "repaired"
    if "warned" in expected and "warning:" in messages:
        return "warned"
    return "WRONG RESULT"


def prepare(root: Path) -> dict[str, bytes]:
    """A drive of four sweeps, a run of it, and the products of that run."""
    made = call(["synth", "made", "--sensor", "VLP-16", "--frames", "4", "--seed", "1", "-q"], root)
    assert made.returncode == 0, made.stderr
    shutil.move(root / "made" / "sequences" / "00", root / "drive")
    ended = call(["run", "drive", "-o", "run", "-q"], root)
    assert ended.returncode == 0, ended.stderr
    return products(root / "run")


def table(outcomes: list[Outcome]) -> str:
    """All outcomes as Markdown."""
    lines = ["| | what was done | code | answer | |", "| ---: | --- | ---: | --- | --- |"]
    for number, outcome in enumerate(outcomes, 1):
        sentence = outcome.sentence.replace("|", "\\|")
        lines.append(
            f"| {number} | {outcome.what} | {outcome.code} | {sentence} | {outcome.verdict} |"
        )
    return "\n".join(lines)


def main(progress: Callable[[str], None]) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", help="cases whose text holds this word")
    wanted = parser.parse_args().only or ""
    cases = [case for case in (*INPUTS, *SETTINGS, *STATES, *STRANGERS) if wanted in case[0]]
    outcomes = []
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder).resolve()
        fresh = prepare(root)
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            tried = [pool.submit(attempt, root, k, case, fresh) for k, case in enumerate(cases)]
            for number, future in enumerate(tried, 1):
                outcomes.append(future.result())
                progress(f"{number}/{len(cases)} {outcomes[-1].verdict}: {outcomes[-1].what}")
    print(table(outcomes))
    bad = [o for o in outcomes if o.verdict.isupper()]
    slow = max((o.seconds for o in outcomes), default=0.0)
    print(f"\n{len(outcomes)} ways to be wrong, {len(bad)} answered badly; slowest {slow:.1f} s")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main(lambda line: print(line, file=sys.stderr)))
