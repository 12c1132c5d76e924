"""The table of mistakes: how an answer is judged, and what is tried."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from mistakes import INPUTS, SETTINGS, STATES, STRANGERS, Outcome, judge, table

CASES = [*INPUTS, *SETTINGS, *STATES, *STRANGERS]


def test_there_are_many_mistakes_and_none_twice():
    names = [case[0] for case in CASES]
    assert len(set(names)) == len(names) >= 60


@pytest.mark.parametrize(
    ("code", "messages", "expected", "same", "verdict"),
    [
        (2, "error: no\n", "refused", False, "refused"),
        (2, "usage\n", "refused", False, "NO SENTENCE"),
        (2, "Traceback (most recent\nerror: no\n", "refused", False, "TRACEBACK"),
        (1, "error: docdepth has a bug\n", "refused", False, "BUG"),
        (0, "", "refused or repaired", True, "repaired"),
        (0, "", "refused or repaired", False, "WRONG RESULT"),
        (0, "", "refused", True, "WRONG RESULT"),
        (0, "warning: odd\n", "refused or warned", False, "warned"),
        (-11, "", "refused", False, "SIGNAL"),
        (139, "", "refused", False, "SIGNAL"),
        (124, "", "refused", False, "TOO SLOW"),
    ],
)
def test_answers_are_judged(code, messages, expected, same, verdict):
    assert judge(code, messages, expected, same) == verdict


def test_the_table_is_markdown():
    text = table([Outcome("a | b", 2, "no | way", 0.1, "refused")])
    assert text.splitlines()[-1].endswith(r"| 2 | no \| way | refused |")


@pytest.mark.slow
def test_every_mistake_is_answered_well():
    pytest.importorskip("embreex")
    script = Path(__file__).parents[2] / "benchmarks" / "mistakes.py"
    ended = subprocess.run([sys.executable, script], capture_output=True, text=True)
    assert ended.returncode == 0, ended.stdout[-3000:]
    assert ended.stdout.count("\n| ") > len(CASES)
