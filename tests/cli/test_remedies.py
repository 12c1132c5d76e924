"""The library says what to do in Python; the command line says it by its options and verbs."""

import pytest

from docdepth.cli.failures import explain
from docdepth.cli.terminal import as_commands
from docdepth.errors import DatasetError


@pytest.mark.parametrize(
    ("python", "command"),
    [
        ("`on_error='skip'`", "--on-error skip"),
        ("`camera_times` or `force=True`", "--camera-times or --force"),
        ("`poses='CAMERA:FILE'`", "--poses CAMERA:FILE"),
        ("`poses=FILE`", "--poses FILE"),
        ("`docdepth.run(recording, '/a b')`", "docdepth run RECORDING -o '/a b'"),
        ("`docdepth.run(..., RUN, keep='frames')`", "docdepth run RUN --keep frames"),
        ("`docdepth.calibration.calibrate()`", "docdepth calibrate"),
        ("`what nobody knows`", "what nobody knows"),
        ("`docdepth.Scene(run)`", "docdepth.Scene(run)"),
    ],
)
def test_python_becomes_commands(python: str, command: str) -> None:
    assert as_commands(f"do this: {python}!") == f"do this: {command}!"


def test_an_error_says_its_remedy_to_each_in_his_language() -> None:
    error = DatasetError("a.bin is empty", "leave it out by `on_error='skip'`", code="empty")
    assert (error.code, error.text) == ("empty", "a.bin is empty")
    assert str(error) == "a.bin is empty; leave it out by `on_error='skip'`"
    told = explain(error)
    assert told == "a.bin is empty; leave it out by --on-error skip"
    assert DatasetError("a.bin is empty").code == "dataset"
