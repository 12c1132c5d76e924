"""Progress in a log file: few lines, with the time and what is left."""

from __future__ import annotations

import logging

import pytest

from docdepth.cli import terminal
from docdepth.cli.terminal import _duration, progress_lines


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
        tell("render", start + k, total)


def test_a_line_for_each_tenth(lines):
    feed(1001, 0.01, 1000)
    assert len(lines) == 11
    assert lines[0] == "render 0/1000"
    assert lines[5] == "render 500/1000, 0:05, about 0:05 left"
    assert lines[-1] == "render 1000/1000, 0:10"


def test_a_line_each_half_minute_where_a_tenth_takes_long(lines):
    feed(100, 10, 10000)
    assert len(lines) == 34
    assert lines[1] == "render 3/10000, 0:30, about 27:46:10 left"


def test_what_was_done_before_does_not_count_into_the_estimate(lines):
    feed(101, 0.1, 200, start=100)
    assert lines[0] == "render 100/200"
    assert "render 160/200, 0:06, about 0:04 left" in lines


@pytest.mark.parametrize(
    ("seconds", "text"), [(0, "0:00"), (7.4, "0:07"), (59.6, "1:00"), (3723, "1:02:03")]
)
def test_durations(seconds, text):
    assert _duration(seconds) == text


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
