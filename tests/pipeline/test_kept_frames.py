"""`--keep results`: the frames of a run that is done go, and all else stays as it is."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from command_line import cli
from docdepth.cli.terminal import as_commands
from docdepth.errors import ConfigError, RunError
from docdepth.io.poses import write_kitti
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline.plan import states
from docdepth.pipeline.render_again import render_again
from docdepth.pipeline.run import continue_run, run
from docdepth.pipeline.run_all import run_all
from motion import straight
from small_drive import SWEEPS, results, write_small_drive


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a drive and two runs of it: one kept all, the other only its results."""
    folder = tmp_path_factory.mktemp("made")
    write_small_drive(folder / "drive")
    write_kitti(folder / "poses.txt", straight(SWEEPS, 0.5).poses)
    for name, keep in (("all", None), ("results", "results")):
        make(folder, name, keep)
    return folder


@pytest.fixture
def root(made: Path, tmp_path: Path) -> Path:
    """A copy of the runs, beside the same drive."""
    for name in ("drive", "poses.txt"):
        (tmp_path / name).symlink_to(made / name)
    for name in ("all", "results"):
        shutil.copytree(made / name, tmp_path / name)
    return tmp_path


def make(root: Path, name: str, keep: str | None = None) -> RunFolder:
    made = run(root / "drive", root / name, poses=root / "poses.txt", keep=keep, threads=1)
    return made.folder


def is_frame(name: str) -> bool:
    return name.startswith(("frames/", "classes/"))


def state_names(folder: Path) -> set[str]:
    return {state.state for state in states(RunFolder.open(folder), verify=True)}


def test_all_but_the_frames_stays(root: Path) -> None:
    whole, alone = results(root / "all"), results(root / "results")
    assert sum(map(is_frame, whole)) == 2 * SWEEPS
    assert alone == {name: content for name, content in whole.items() if not is_frame(name)}
    assert not (root / "results" / "frames").exists()
    assert state_names(root / "results") == {"done"}


def test_a_run_without_frames_is_done(root: Path) -> None:
    times = {p: p.stat().st_mtime_ns for p in (root / "results").rglob("*") if p.name != "lock"}
    make(root, "results")
    continue_run(root / "results", threads=1)
    assert {p: p.stat().st_mtime_ns for p in times} == times


def test_frames_are_deleted_from_a_run_that_is_done(root: Path) -> None:
    make(root, "all", "results")
    assert results(root / "all") == results(root / "results")


def test_frames_are_made_again_bit_for_bit(root: Path) -> None:
    continue_run(root / "results", keep="frames", threads=1)
    assert results(root / "results") == results(root / "all")
    assert "keep" not in str(states(RunFolder.open(root / "results")))
    make(root, "results")  # and they stay from now on
    assert results(root / "results") == results(root / "all")


def test_another_camera_makes_them_again_for_as_long_as_it_takes(root: Path) -> None:
    for name in ("all", "results"):
        run(root / "drive", root / name, poses=root / "poses.txt", camera="image_3", threads=1)
    whole = results(root / "all")
    assert any("image_3" in name for name in whole)
    expected = {name: content for name, content in whole.items() if not is_frame(name)}
    assert results(root / "results") == expected


@pytest.mark.parametrize("deleted", [0, 1, 3])
@pytest.mark.parametrize("keep", [None, "frames"])
def test_a_command_that_ends_while_it_deletes(
    root: Path, monkeypatch: pytest.MonkeyPatch, deleted: int, keep: str | None
) -> None:
    removed, remove = [], RunFolder.remove

    def dying(folder: RunFolder, path: Path) -> None:
        if len(removed) == deleted:
            raise KeyboardInterrupt
        removed.append(path)
        remove(folder, path)

    with monkeypatch.context() as patch:
        patch.setattr(RunFolder, "remove", dying)
        with pytest.raises(KeyboardInterrupt):
            make(root, "all", "results")
    assert state_names(root / "all") == {"done"}
    make(root, "all", keep)
    left = sum(map(is_frame, results(root / "all")))
    assert left == (2 * SWEEPS if keep else 0)


def test_what_needs_frames_says_how_to_have_them(root: Path) -> None:
    place = root / "results"
    before = results(place) | {"run.yaml": (place / "run.yaml").read_bytes()}
    for command in (
        ("render", place, "--set", "render.ahead=5"),
        ("map", place),
        ("video", place, "--above"),
        ("inspect", place),
        ("convert", place, root / "pcd", "--to", "pcd"),
        ("evaluate", "labels", place, "--labels", root),
    ):
        result = cli(*command)
        assert result.exit_code == 2, command
        assert f"docdepth run {place} --keep frames" in as_commands(str(result.exception)), command
    with pytest.raises(RunError, match="keep='frames'"):
        render_again(place, camera="image_3", threads=1)
    assert results(place) | {"run.yaml": (place / "run.yaml").read_bytes()} == before


def test_what_needs_none_works(root: Path) -> None:
    place = root / "results"
    for command in (("video", place), ("status", place)):
        assert cli(*command).exit_code == 0, command
    for to in ("tum", "proj_depth"):
        assert cli("convert", place, root / to, "--to", to).exit_code == 0, to
    scored = cli("evaluate", "trajectories", place, "--poses", root / "poses.txt")
    assert scored.exit_code == 0, scored.output


def test_a_command_says_what_stays(root: Path) -> None:
    assert cli("run", root / "all", "--keep", "results").exit_code == 0
    assert results(root / "all") == results(root / "results")
    status = " ".join(cli("status", root / "all").output.split())
    assert "its frames were deleted" in status


def test_every_recording_keeps_only_its_results(root: Path) -> None:
    shutil.copytree(root / "drive", root / "drives" / "one")
    options = {"poses": root / "poses.txt", "keep": "results", "threads": 1}
    (ended,) = run_all(root / "drives", root / "runs", **options)
    assert ended.error is None
    assert results(ended.folder) == results(root / "results")


def test_another_word_is_refused(root: Path) -> None:
    with pytest.raises(ConfigError, match="keep is 'depth'; it must be frames or results"):
        make(root, "other", "depth")
    assert not (root / "other").exists()


def test_a_damaged_note_of_deleted_frames_is_not_believed(root: Path) -> None:
    file = root / "results" / "run.yaml"
    lines = file.read_text().split("frames_deleted:")[0]
    file.write_text(lines + "frames_deleted: yes\n")
    make(root, "results")  # by the copy of run.yaml
    assert results(root / "results").keys() == {
        name for name in results(root / "all") if not is_frame(name)
    }
