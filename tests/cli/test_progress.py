"""Progress in a log file: few lines, with the time and what is left."""

from __future__ import annotations

import logging
import re

import pytest

from docdepth.cli import progress, terminal
from docdepth.cli.progress import duration, progress_lines


@pytest.fixture
def lines(monkeypatch):
    told = []
    monkeypatch.setattr(terminal.err, "print", lambda line, **options: told.append(line))
    return told


def test_a_warning_is_printed_once_by_a_command(monkeypatch):
    told = []
    monkeypatch.setattr(terminal.err, "print", lambda text, **options: told.append(text))
    log = logging.getLogger("docdepth.a_test")
    for _ in range(2):
        terminal.set_volume(quiet=False, verbose=False)
        for frame in (1, 1, 2, 1):
            log.warning("frame %d is odd", frame)
    assert [text for text in told if "odd" in text] == ["frame 1 is odd", "frame 2 is odd"] * 2


def feed(steps, seconds, total, start=0):
    clock = iter([seconds * k for k in range(steps)])
    tell = progress_lines(lambda: next(clock))
    for k in range(steps):
        tell("video", start + k, total)


def test_a_line_for_each_tenth(lines):
    feed(1001, 0.01, 1000)
    assert len(lines) == 11
    assert lines[0] == "video 0/1000"
    assert lines[5] == "video 500/1000, 0:05, about 0:05 left"
    assert lines[-1] == "video 1000/1000, 0:10"


def test_a_line_each_half_minute_where_a_tenth_takes_long(lines):
    feed(100, 10, 10000)
    assert len(lines) == 34
    assert lines[1] == "video 3/10000, 0:30, about 27:46:10 left"


def test_what_was_done_before_does_not_count_into_the_estimate(lines):
    feed(101, 0.1, 200, start=100)
    assert lines[0] == "video 100/200"
    assert "video 160/200, 0:06, about 0:04 left" in lines


@pytest.mark.parametrize(
    ("seconds", "text"), [(0, "0:00"), (7.4, "0:07"), (59.6, "1:00"), (3723, "1:02:03")]
)
def test_durations(seconds, text):
    assert duration(seconds) == text


def test_the_time_left_is_that_of_the_whole_run(lines):
    """Each second a hundredth of the cost of all steps is done, whatever the step."""
    now = [0.0]
    tell = progress_lines(lambda: now[0])
    every = sum(progress._COST.values())
    for step, cost in progress._COST.items():
        for done in range(0, 101):
            tell(step, done, 100)
            now[0] += cost / every
    assert lines[0] == "register 0/100"
    found = [re.search(r", (.+), about (.+) left", line) for line in lines]
    told = [sum(map(seconds_of, one.groups())) for one in found if one]
    assert len(told) >= 10
    assert all(99 <= seconds <= 101 for seconds in told)


def test_a_run_that_goes_on_and_the_next_recording(lines):
    now = [0.0]
    tell = progress_lines(lambda: now[0])
    for done in (50, 90):
        tell("render", done, 100)
        now[0] += 40
    cost = progress._COST
    left = round(40 * (10 * cost["render"] + 100 * cost["camera"]) / (40 * cost["render"]))
    assert lines[-1] == f"render 90/100, 0:40, about 0:{left} left"
    tell("register", 0, 100)
    assert lines[-1] == "register 0/100"


def seconds_of(text):
    minutes, seconds = text.split(":")
    return 60 * int(minutes) + int(seconds)


@pytest.mark.parametrize(
    ("options", "last"),
    [
        (["labels", "--labels"], "labels 5/5"),
        (["depth", "--depth"], "depth 4/4"),
        (["held-out", "--every", "2"], "held out 2/2"),
    ],
)
def test_evaluations_tell_their_progress(docdepth, drive, finished, options, last):
    verb, *options = options
    ended = docdepth("evaluate", verb, finished[0], *options, *[drive] * (verb != "held-out"))
    assert ended.code == 0
    assert any(line.startswith(last) for line in ended.err.splitlines())
