"""What is out of date is not used, what is damaged is made again, what is the user's stays."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from command_line import cli
from docdepth.cli.terminal import as_commands
from docdepth.config import replaced
from docdepth.errors import RunError
from docdepth.io.depth import read_depth
from docdepth.io.poses import write_kitti
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline.odometry import run_odometry
from docdepth.pipeline.plan import states
from docdepth.pipeline.run import continue_run
from docdepth.pipeline.run_inputs import known_poses, open_recording
from motion import straight
from small_drive import SPARSE, SWEEPS, write_image, write_small_drive, write_sweep
from walled_yard import scan

POSES = straight(SWEEPS, 0.5).poses

KEPT_TRACKS = [".docdepth/tracks/000002.npz", ".docdepth/tracks/paths.npz"]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a small drive and a finished run of it; beside it lies a copy."""
    root = tmp_path_factory.mktemp("repair") / "root"
    write_small_drive(root / "drive")
    write_kitti(root / "poses.txt", POSES)
    assert again(root).exit_code == 0
    shutil.copytree(root, root.with_name("copy"))
    return root


@pytest.fixture
def root(made: Path) -> Path:
    """The folder as it was made, under the name that run.yaml holds."""
    shutil.rmtree(made)
    return Path(shutil.copytree(made.with_name("copy"), made))


def again(root: Path, *more: object):
    """The first command."""
    return cli("run", root / "drive", "-o", root / "run", "--poses", root / "poses.txt", *more)


def files(folder: Path) -> dict[str, bytes]:
    """Results in a run folder, by name."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for kind in ("frames", "classes", "labels", "depth", "report")
        for path in sorted((folder / kind).rglob("*"))
        if path.is_file() and path.name != "index.html"
    }


def times(folder: Path) -> dict[str, int]:
    return {name: (folder / name).stat().st_mtime_ns for name in files(folder)}


def state_of(root: Path) -> dict[str, tuple[str, str]]:
    return {s.name: (s.state, s.why) for s in states(RunFolder.open(root / "run"))}


def refused(*arguments: object) -> str:
    result = cli(*arguments)
    assert result.exit_code == 2, result.output
    return as_commands(str(result.exception))


def test_results_of_a_changed_stage_are_not_used(root):
    """Finding 27."""
    folder = RunFolder.open(root / "run")  # as an interrupted command leaves it
    folder.manifest.parameters = replaced(folder.parameters, {"odometry.min_range": 3.5})
    recording = open_recording(folder.inputs, folder.manifest.derived)
    run_odometry(folder, recording, known_poses(folder.inputs, recording))
    found = state_of(root)
    assert found["odometry"] == ("done", "")
    assert found["classify"][0] == found["render image_2"][0] == "out of date"
    for verb in (
        ("evaluate", "labels", root / "run", "--labels", root),
        ("evaluate", "depth", root / "run", "--depth", root),
        ("evaluate", "held-out", root / "run"),
        ("video", root / "run"),
        ("render", root / "run"),
        ("view", root / "run", "--image", root / "view.png"),
    ):
        text = refused(*verb)
        assert "is out of date" in text
        assert f"bring it up to date: docdepth run {root / 'run'}" in text
    # The first command goes on with the changed parameter and tells how to go back.
    result = again(root)
    assert result.exit_code == 0
    back = f"docdepth run {root / 'run'} --set odometry.min_range=3"
    assert f"odometry.min_range is 3.5, was 3; back: {back}" in result.output
    assert {state for state, _ in state_of(root).values()} == {"done"}
    assert cli("evaluate", "held-out", root / "run").exit_code == 0


def test_a_run_by_itself_takes_parameters_and_goes_back(root):
    run, before = root / "run", files(root / "run")
    changed = cli("run", run, "--set", "dynamics.tolerance=0.3", "--format", "png,npy")
    assert changed.exit_code == 0
    assert {state for state, _ in state_of(root).values()} == {"done"}
    assert RunFolder.open(run).parameters.dynamics.tolerance == 0.3
    assert len(list((run / "depth").glob("*.npy"))) == len(list((run / "depth").glob("*.png")))
    back = re.search(r"back: docdepth (.*)", changed.output)[1].split()
    assert cli(*back).exit_code == 0
    assert files(run) == before
    text = refused("run", run, "--set", "dynamics.tolerance=0.3", "--frames", "0:2")
    assert "keeps the inputs of the run" in text
    assert cli("run", run, "--set", "x.y=1").exit_code == 2
    assert files(run) == before


def test_changed_inputs_are_noticed(root):
    """Finding 28."""
    before = files(root / "run")
    write_image(root / "drive" / "image_2" / "000001.png", seed=99)
    assert state_of(root)["render image_2"] == (
        "out of date",
        "1 images have changed, 000001.png first",
    )
    kept = times(root / "run")
    assert again(root).exit_code == 0
    after = files(root / "run")
    assert {name for name in after if after[name] != before[name]} == {"report/000001.jpg"}
    rewritten = {name for name, time in times(root / "run").items() if time != kept[name]}
    assert rewritten == {"report/000001.jpg", "depth/000001.png", "depth/depth.json"}

    write_sweep(root / "drive", 2, scan(POSES[2], 3.0, SPARSE)[0])
    why = "sweeps have changed, velodyne/000002.bin first"
    assert state_of(root)["odometry"] == ("out of date", why)
    assert "sweeps have changed" in refused("evaluate", "held-out", root / "run")
    assert again(root).exit_code == 0
    assert files(root / "run")["frames/frame_000002.ply"] != before["frames/frame_000002.ply"]

    stamps = root / "drive" / "times.txt"
    stamps.write_text(stamps.read_text().replace("0.300000", "0.310000"))
    assert state_of(root)["odometry"] == ("out of date", "the times of the input have changed")


def test_contents_tell_whether_inputs_have_changed_if_asked(root):
    assert again(root, "--hash-inputs", "--force").exit_code == 0
    kept = times(root / "run")
    for sweep in (root / "drive" / "velodyne").iterdir():
        os.utime(sweep)
    assert {state for state, _ in state_of(root).values()} == {"done"}
    assert cli("run", root / "run").exit_code == 0
    assert times(root / "run") == kept
    sweep = root / "drive" / "velodyne" / "000001.bin"
    content = bytearray(sweep.read_bytes())
    content[5] ^= 1
    before = sweep.stat()
    sweep.write_bytes(content)
    os.utime(sweep, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert state_of(root)["odometry"][0] == "out of date"


def test_a_recording_that_was_moved_is_the_same(root):
    kept = times(root / "run")
    (root / "drive").rename(root / "elsewhere")
    assert state_of(root)["odometry"] == ("done", "")  # as far as can be told
    text = refused("run", root / "run")
    assert str(root / "drive") in text
    arguments = ("-o", root / "run", "--poses", root / "poses.txt")
    assert cli("run", root / "elsewhere", *arguments).exit_code == 0
    assert times(root / "run") == kept


@pytest.mark.parametrize(("name", "kind"), list(zip(KEPT_TRACKS, ["cut", "gone"], strict=True)))
def test_tracks_that_are_not_whole_are_found_again(root, name, kind):
    """A frame without its classes needs them."""
    before, path = files(root / "run"), root / "run" / name
    if kind == "gone":
        path.unlink()
    else:
        path.write_bytes(path.read_bytes()[:-9])
    (root / "run" / "frames" / "frame_000001.ply").unlink()
    assert again(root).exit_code == 0
    assert files(root / "run") == before


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("frames/frame_000001.ply", "cut"),
        ("labels/000002.label", "turned"),
        ("depth/000001.png", "gone"),
        ("report/000001.jpg", "cut"),
        ("depth/depth.json", "turned"),
        ("traj_odometry.ply", "gone"),
        ("calib.json", "cut"),
        ("run.yaml", "turned"),
        ("depth/000001.png", "unnoticed"),
    ],
)
def test_a_damaged_file_is_made_again_alone(root, name, kind):
    """Finding 33: nobody has to delete anything, and never the whole run."""
    before, kept = files(root / "run"), times(root / "run")
    path = root / "run" / name
    known, content = path.stat(), bytearray(path.read_bytes())
    if kind == "gone":
        path.unlink()
    elif kind == "cut":
        path.write_bytes(content[: len(content) // 2])
    else:
        content[len(content) // 3] ^= 0xFF
        path.write_bytes(content)
    changed = path.read_bytes() if path.exists() else b""
    if kind == "unnoticed":  # size and time are as they were: only reading tells
        os.utime(path, ns=(known.st_atime_ns, known.st_mtime_ns))
        assert cli("status", root / "run", "--verify").exit_code == 0
        assert "damaged" in {s.state for s in states(RunFolder.open(root / "run"), verify=True)}
        return
    assert again(root).exit_code == 0
    if kind != "gone" and name != "run.yaml":  # it may have been changed by somebody
        old = path.with_name(f"{path.name}.old")
        assert old.read_bytes() == changed
        old.unlink()
    assert files(root / "run") == before
    rewritten = {n for n, time in times(root / "run").items() if time != kept[n]}
    images = {"report/000001.jpg", "depth/000001.png"}
    allowed = {name, "depth/depth.json"} | (images if name in images else set())
    assert rewritten <= allowed, rewritten


def test_damage_that_only_reading_tells_is_mended_on_the_way(root):
    before = files(root / "run")
    path = root / "run" / "frames" / "frame_000001.ply"
    known = path.stat()
    path.write_bytes(b"x" * known.st_size)
    os.utime(path, ns=(known.st_atime_ns, known.st_mtime_ns))
    (root / "run" / "depth" / "000001.png").unlink()  # drawn from that frame
    assert again(root).exit_code == 0
    assert files(root / "run") == before


def test_a_refused_setting_changes_nothing_and_an_accepted_one_belongs_to_the_run(root):
    """Finding 34."""
    before = (root / "run" / "run.yaml").read_text()
    assert cli("render", root / "run", "--set", "render.max_depth=700").exit_code == 2
    assert (root / "run" / "run.yaml").read_text() == before
    assert cli("render", root / "run", "--set", "render.ahead=5").exit_code == 0
    assert again(root).exit_code == 0
    assert RunFolder.open(root / "run").parameters.render.ahead == 5
    text = refused("run", root / "drive", "-o", root / "run", "--poses", root / "poses.txt",
                   "--set", "render.ahead=7")  # fmt: skip
    assert "holds another run" in text
    assert "--force" in text
    assert again(root, "--set", "render.ahead=7", "--force").exit_code == 0
    assert RunFolder.open(root / "run").parameters.render.ahead == 7


def test_settings_refused_together_with_a_new_camera_are_not_kept(root):
    before = (root / "run" / "run.yaml").read_text()
    cameras = ("--camera", "image_2,image_3")
    assert "64" in refused("render", root / "run", *cameras, "--set", "render.max_depth=700")
    assert (root / "run" / "run.yaml").read_text() == before


def test_cameras_live_beside_each_other_and_own_files_stay(root):
    """Findings 32 and 35."""
    own = {root / "run" / name: b"mine" for name in ("depth/mine.png", "report/a.jpg", "notes")}
    for path, content in own.items():
        path.write_bytes(content)
    before = files(root / "run")
    assert cli("render", root / "run", "--camera", "image_3").exit_code == 0
    mounted = ("--K", "40,40,32,16", "--size", "64x32", "--name", "roof")
    result = cli("render", root / "run", "--pose", "0,0,5", *mounted)
    assert result.exit_code == 0
    after = files(root / "run")
    assert {name: after[name] for name in before} == before
    shares = {
        camera: np.mean([np.isfinite(read_depth(p)).mean() for p in maps])
        for camera, folder in (("image_2", ""), ("image_3", "image_3"), ("roof", "roof"))
        if (maps := sorted((root / "run" / "depth" / folder).glob("00*.png")))
    }
    assert len(set(shares.values())) == 3
    for camera, share in shares.items():
        assert f"density of {camera}: {100 * share:.1f} %" in result.output
    page = (root / "run" / "report" / "index.html").read_text()
    for camera in shares:
        assert f"<h2>Camera {camera}</h2>" in page
    # Other parameters: maps are made anew, what docdepth did not write stays.
    assert cli("render", root / "run", "--format", "npy").exit_code == 0
    for path, content in own.items():
        assert path.read_bytes() == content
    assert not (root / "run" / "depth" / "000001.png").exists()
    assert (root / "run" / "depth" / "roof" / "000001.npy").is_file()


def test_a_file_of_the_users_at_the_place_of_a_map_is_kept(root):
    own = root / "run" / "depth" / "image_3" / "000001.png"
    own.parent.mkdir()
    own.write_bytes(b"mine")
    assert cli("render", root / "run", "--camera", "image_3").exit_code == 0
    assert own.with_name("000001.png.old").read_bytes() == b"mine"
    assert read_depth(own).shape == (40, 96)


def test_status_tells_the_state_and_why(root):
    told = json.loads(cli("status", root / "run", "--json").stdout)
    assert told["in_use_by"] is None
    by_name = {stage["name"]: stage for stage in told["stages"]}
    assert list(by_name) == ["odometry", "classify", "render image_2"]
    for stage in by_name.values():
        assert stage["state"] == "done"
        assert stage["frames"] == stage["all_frames"] == SWEEPS
        assert stage["seconds"] > 0
    classes = sum(p.stat().st_size for p in (root / "run" / "classes").iterdir())
    labels = sum(p.stat().st_size for p in (root / "run" / "labels").iterdir())
    tracks = (root / "run" / "tracks.csv").stat().st_size
    assert by_name["classify"]["size"] == classes + labels + tracks
    (root / "run" / "labels" / "000001.label").unlink()
    text = " ".join(cli("status", root / "run").stdout.split())
    assert "classify incomplete 3/4" in text
    assert f"docdepth run {root / 'run'} makes: classify" in text


def test_a_dry_run_makes_nothing(root):
    shutil.rmtree(root / "run")
    result = again(root, "--dry-run")
    assert result.exit_code == 0, result.output
    assert "makes: odometry, classify, render image_2" in result.output
    said = " ".join(result.output.split())
    assert re.search(r"4 sweeps of \d+ points, .* [\d.]+ GB of memory and \d+ MB on disk", said)
    assert not (root / "run").exists()
    assert again(root).exit_code == 0
    before = {p: p.stat().st_mtime_ns for p in (root / "run").rglob("*")}
    result = again(root, "--dry-run", "--set", "dynamics.tolerance=0.3", "--force")
    assert "dynamics.tolerance was 0.2, is 0.3" in " ".join(result.output.split())
    assert {p: p.stat().st_mtime_ns for p in (root / "run").rglob("*")} == before


def test_resumed_runs_tell_what_they_took_in_all(root):
    """Finding 40."""
    (root / "run" / "depth" / "000001.png").unlink()
    stage = RunFolder.open(root / "run").stage("render image_2")
    assert again(root).exit_code == 0
    after = RunFolder.open(root / "run").stage("render image_2")
    assert (after.frames, after.total_frames) == (1, SWEEPS + 1)
    assert after.all_frames == SWEEPS
    assert after.total_seconds > stage.total_seconds


def test_one_command_at_a_time(root):
    """Finding 37; the lock ends with its process, however that ends."""
    code = (
        "import sys, time\nfrom docdepth.io.run_folder import RunFolder\n"
        "with RunFolder.open(sys.argv[1]).lock('test'):\n    print('locked', flush=True)\n"
        "    time.sleep(60)\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code, root / "run"], stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "locked\n"
        text = refused("render", root / "run", "--set", "render.ahead=5")
        assert f"is in use by process {process.pid} on " in text
        assert "(test, " in text
        told = json.loads(cli("status", root / "run", "--json").stdout)
        assert f"process {process.pid}" in told["in_use_by"]
    finally:
        process.send_signal(signal.SIGKILL)
        process.communicate()
    assert cli("render", root / "run", "--set", "render.ahead=5").exit_code == 0


@pytest.mark.slow
def test_two_first_commands_at_once(root):
    shutil.rmtree(root / "run")
    command = [sys.executable, "-m", "docdepth", "run", root / "drive", "-o", root / "run"]
    processes = [subprocess.Popen(command, stderr=subprocess.PIPE, text=True) for _ in range(2)]
    messages = [process.communicate()[1] for process in processes]
    codes = [process.returncode for process in processes]
    assert min(codes) == 0
    for code, message in zip(codes, messages, strict=True):
        assert (
            code == 0
            or (code == 2 and "in use by process" in message)
            or (code == 2 and "another command has changed" in message)
        ), message
    assert {state for state, _ in state_of(root).values()} == {"done"}


def test_a_run_without_its_state_says_what_to_do(root):
    shutil.rmtree(root / "run" / ".docdepth")
    (root / "run" / "run.yaml").write_text("- 1")
    assert "run.yaml is missing or damaged; begin the run again: docdepth run" in refused(
        "render", root / "run"
    )
    with pytest.raises(RunError, match="holds no run"):
        continue_run(root)


def test_warnings_reach_the_terminal_the_run_and_the_report(root, caplog):
    """Poses that stand still while the sweeps move."""
    write_kitti(root / "poses.txt", np.repeat(POSES[:1], SWEEPS, axis=0))
    result = again(root)
    assert result.exit_code == 0
    said = [
        record.getMessage()
        for record in caplog.records
        if "all poses are the same" in record.getMessage()
    ]
    assert said
    assert said[0] in RunFolder.open(root / "run").stage("odometry").warnings
    page = (root / "run" / "report" / "index.html").read_text()
    assert "<li><b>odometry</b>" in page
    assert "all poses are the same" in page


def test_warnings_of_the_inputs_are_kept(root, caplog):
    stamps = root / "drive" / "times.txt"
    stamps.write_text("0.0\n0.1\n0.2\n0.6\n")
    assert again(root).exit_code == 0
    (text,) = [t for t in RunFolder.open(root / "run").manifest.warnings if "sweeps missing" in t]
    assert "0.40 s lie between frames 2 and 3" in text
    assert text in caplog.messages
    assert "sweeps missing" in (root / "run" / "report" / "index.html").read_text()


def test_a_camera_whose_first_maps_are_refused_is_taken_back(root):
    times = root / "late.txt"
    times.write_text("100.0\n101.0\n")
    mounted = ("--K", "40,40,32,16", "--size", "64x32", "--name", "roof", "--camera-times", times)
    assert "none of the 2 images" in refused("render", root / "run", "--pose", "0,0,5", *mounted)
    assert list(RunFolder.open(root / "run").cameras) == ["image_2"]
    assert cli("run", root / "run").exit_code == 0
