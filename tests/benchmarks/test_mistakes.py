"""Every mistake of the table is answered well by the real command line."""

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "mistakes.py"


@pytest.mark.slow
def test_every_mistake_is_answered_well():
    pytest.importorskip("embreex")
    ended = subprocess.run([sys.executable, SCRIPT], capture_output=True, text=True)
    assert ended.returncode == 0, ended.stdout[-3000:]
    assert ended.stdout.count("\n| ") >= 100
