"""A run that is killed again and again ends like one that is not; from benchmarks/."""

from pathlib import Path

import pytest
from kills import torture

THREADS = 2


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.nightly)])
def test_a_killed_run_ends_the_same_and_computes_little_twice(
    drive: Path, tmp_path: Path, seed: int
) -> None:
    figures = torture(drive, tmp_path, kills=4, seed=seed, threads=THREADS)
    assert figures["files that differ"] == figures["files that are not whole"] == []
    kills = figures["kills"]
    assert kills > 1
    twice = figures["done more often"]
    # What was under way: a sweep of each pass; a map and the one that is written; of votes and
    # labels one a thread and those that wait for the disk. Ground and tracks are of many sweeps.
    allowed = {
        "registered": 2, "deskewed": 1, "drawn": 2, "voted": THREADS + 2, "labelled": 5,
        "ground of a chunk": 1, "tracked": 1,
    }  # fmt: skip
    for step, most in allowed.items():
        assert 0 <= twice[step] <= most * kills, step
