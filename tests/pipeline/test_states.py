"""A run folder under random commands, changes, losses and kills: `run` always mends it, alone."""

from __future__ import annotations

import contextlib
import os
import shutil
from dataclasses import dataclass, field
from pathlib import Path
from typing import get_args
from unittest.mock import Mock

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from docdepth.config import replaced
from docdepth.errors import DocDepthError, RunError
from docdepth.io.manifest import Keep
from docdepth.io.poses import write_kitti
from docdepth.io.recorded_folder import RecordedFolder
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline import run_classify, run_odometry
from docdepth.pipeline.cameras import virtual_camera
from docdepth.pipeline.depth_files import DepthImage
from docdepth.pipeline.plan import require, states
from docdepth.pipeline.render_again import render_again
from docdepth.pipeline.run import continue_run, run
from docdepth.pipeline.run_inputs import known_poses, recording_of
from motion import straight
from small_drive import SPARSE, SWEEPS, results, write_image, write_small_drive, write_sweep
from walled_yard import scan

VIRTUAL = virtual_camera("0,0,1", "40,40,32,16", "64x32")
STAGES = {"odometry": ("min_range", [3.0, 3.5]), "dynamics": ("tolerance", [0.2, 0.3])}
STAGES |= {"ground": ("neighbors", [30, 20]), "render": ("ahead", [80.0, 5.0])}
STAGES |= {"output": ("format", [("png",), ("npy",), ("png", "npz")])}


class Killed(BaseException):
    """In place of a signal."""


@dataclass
class World:
    """A drive, a run of it, and what the user laid into the run folder."""

    root: Path
    own: dict[Path, bytes] = field(default_factory=dict)
    notes_lost: bool = False
    damaged: set[str] = field(default_factory=set)
    version: int = 0
    redrawn: set[str] = field(default_factory=set)  # images that have changed

    def __post_init__(self) -> None:
        self.drive = write_small_drive(self.root / "drive")
        write_kitti(self.root / "poses.txt", straight(SWEEPS, 0.5).poses)
        self.run = self.root / "run"
        self.make()

    def make(self, keep: str | None = None) -> RunFolder:
        """The first command."""
        poses = self.root / "poses.txt"
        return run(self.drive, self.run, poses=poses, camera="image_2", keep=keep, threads=1).folder

    def fresh(self) -> Path:
        """The same results, made at once in another folder."""
        folder, made = RunFolder.open(self.run), self.root / "fresh"
        shutil.rmtree(made, ignore_errors=True)
        run(
            self.drive,
            made,
            folder.parameters,
            poses=self.root / "poses.txt",
            camera="image_2",
            threads=1,
        )
        for name, entry in folder.cameras.items():
            if entry.virtual is not None:
                render_again(made, entry.settings, virtual=(name, entry.virtual), threads=1)
            elif name != "image_2" or entry.settings:
                render_again(made, entry.settings, name, threads=1)
        return made

    def results(self) -> dict[str, bytes]:
        """The results of the run, without files of the user and copies that have to be kept."""
        own = {path.relative_to(self.run).as_posix() for path in self.own}
        found = {name: what for name, what in results(self.run).items() if name not in own}
        return {name: what for name, what in found.items() if not self._has_to_be_kept(name)}

    def _has_to_be_kept(self, name: str) -> bool:
        """Where a file was damaged, or nothing tells whose it is, it lies beside the new one."""
        original, old, _ = name.partition(".old")
        return bool(old) and (self.notes_lost or original in self.damaged)

    def products(self) -> list[Path]:
        """Every file in the run folder that docdepth wrote, notes included."""
        return sorted(
            p for p in self.run.rglob("*") if p.is_file() and p not in self.own and p.name != "lock"
        )


# What may happen to a run. Each takes the world and a random number.


def first_command(world: World, number: int) -> None:
    world.make()


def stage_again(world: World, number: int) -> None:
    """Each stage with another parameter, or with the one before."""
    stage = list(STAGES)[number % len(STAGES)]
    name, values = STAGES[stage]
    change = {f"{stage}.{name}": values[(number // 10) % len(values)]}
    if stage in ("render", "output"):
        camera = [None, "image_2", "image_3"][(number // 100) % 3]
        render_again(world.run, change, camera, threads=1)
        return
    folder = RunFolder.open(world.run)
    values = replaced(folder.parameters, change)
    folder.manifest.parameters = values
    if stage == "odometry":
        recording = recording_of(folder)
        run_odometry(folder, recording, known_poses(folder.inputs, recording))
    else:
        require(folder, "odometry")
        run_classify(folder, threads=1)


def other_camera(world: World, number: int) -> None:
    if number % 2:
        render_again(world.run, {}, "image_3", threads=1)
    else:
        render_again(world.run, {"output.format": ("npy",)}, virtual=("roof", VIRTUAL), threads=1)


def delete(world: World, number: int) -> None:
    files = world.products()
    _lose(world, files[number % len(files)])


def delete_folder(world: World, number: int) -> None:
    folders = sorted(p for p in world.run.rglob("*") if p.is_dir() and _without_own(world, p))
    if folders:
        folder = folders[number % len(folders)]
        world.notes_lost |= ".docdepth" in folder.relative_to(world.run).parts
        shutil.rmtree(folder)


def damage(world: World, number: int) -> None:
    """Cut a file off, turn a byte over, or fill it with zeros."""
    files = world.products()
    path = files[number % len(files)]
    content = bytearray(path.read_bytes())
    if not content:
        return
    kind = (number // 1000) % 3
    if kind == 0:
        content = content[: len(content) // 2]
    elif kind == 1:
        content[number % len(content)] ^= 0xFF
    else:
        content = bytearray(len(content))
    path.write_bytes(content)
    world.damaged.add(path.relative_to(world.run).as_posix())
    world.notes_lost |= ".docdepth" in path.parts or path.name == "run.yaml"


def change_input(world: World, number: int) -> None:
    world.version += 1
    k = number % SWEEPS
    if number % 3 == 0:
        points = scan(straight(SWEEPS, 0.5).poses[k], world.version, SPARSE)[0]
        write_sweep(world.drive, k, points)
    elif number % 3 == 1:
        write_image(world.drive / "image_2" / f"{k:06d}.png", seed=world.version + 50)
        world.redrawn.add(f"{k:06d}")
    else:
        text = (world.drive / "calib.txt").read_text()
        world.drive.joinpath("calib.txt").write_text(text.replace("60 0 48", "61 0 48"))


def lay_own_file(world: World, number: int) -> None:
    name = ["notes.txt", "depth/mine.png", "report/mine.jpg", "labels/mine.label", "frames/a.ply"]
    path = world.run / name[number % len(name)]
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(b"mine %d" % number)
    world.own[path] = path.read_bytes()


def keep(world: World, number: int) -> None:
    """Frames as well, or only the results."""
    world.make(get_args(Keep)[number % 2])


def kill(world: World, number: int) -> None:
    """The first command ends at some write, before or after the file gets its name."""
    replace, left = os.replace, [number % 25]

    def stopped(*arguments: object) -> None:
        left[0] -= 1
        if left[0] == 0 and number % 2:
            raise Killed
        replace(*arguments)
        if left[0] == 0:
            raise Killed

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "replace", stopped)
        with contextlib.suppress(Killed):
            world.make()


ACTIONS = [
    first_command, stage_again, stage_again, other_camera, delete, delete_folder, damage, damage,
    change_input, lay_own_file, kill, keep, keep,
]  # fmt: skip


def _without_own(world: World, folder: Path) -> bool:
    return not any(folder in path.parents for path in world.own)


def _lose(world: World, path: Path) -> None:
    world.notes_lost |= ".docdepth" in path.parts or path.name == "run.yaml"
    path.unlink()


@given(
    actions=st.lists(
        st.tuples(st.sampled_from(ACTIONS), st.integers(0, 10**6)), min_size=1, max_size=6
    )
)
@settings(
    max_examples=int(os.environ.get("DOCDEPTH_EXAMPLES", "4")),
    deadline=None,
    derandomize=True,
    report_multiple_bugs=False,
    phases=[Phase.generate],
    suppress_health_check=[HealthCheck.too_slow],
)
def test_run_ends_like_a_fresh_one_whatever_happened(tmp_path_factory, actions):
    world = World(tmp_path_factory.mktemp("world"))
    for action, number in actions:
        # Some are refused with a sentence, as `render` of a run that is not up to date.
        with contextlib.suppress(DocDepthError):
            action(world, number)
    before = {p: (p.read_bytes(), p.stat().st_mtime_ns) for p in world.products()}
    known, written = {}, RecordedFolder(world.run)
    keys = {p: written.key(p) for p in before}
    with contextlib.suppress(RunError):  # run.yaml and its copy may be lost
        known = {s.name: s.state for s in states(RunFolder.open(world.run))}

    folder = world.make()

    assert [s for s in states(folder, verify=True) if s.state != "done"] == []
    made = world.results()
    fresh = results(world.fresh())
    if folder.manifest.keep == "results":
        fresh = {
            name: content
            for name, content in fresh.items()
            if not name.startswith(("frames/", "classes/"))
        }
    assert made.keys() == fresh.keys()
    assert [name for name in made if made[name] != fresh[name]] == []
    for path, content in world.own.items():
        assert path.read_bytes() == content
    if not world.notes_lost:
        # Of a stage that was killed while it made something else, some files are of the old key.
        same = {p: seen for p, seen in before.items() if keys[p] == folder.key(p) and p.is_file()}
        _check_that_little_was_written(world, same, known)
    # And then there is nothing to do.
    times = {p: p.stat().st_mtime_ns for p in world.run.rglob("*") if p.is_file()}
    continue_run(world.run, threads=1)
    written = [p.name for p, t in times.items() if p.is_file() and p.stat().st_mtime_ns != t]
    assert written in ([], ["lock"])
    shutil.rmtree(world.root)


def test_a_camera_that_was_drawn_stays_though_the_report_was_refused(tmp_path: Path) -> None:
    world = World(tmp_path)
    (world.run / "calib.json").write_bytes(b"\xff")  # of image_2, which the report reads
    with pytest.raises(DocDepthError, match=r"calib\.json is damaged"):
        render_again(world.run, {}, "image_3", threads=1)
    folder = world.make()
    assert "image_3" in folder.cameras
    assert {state.state for state in states(folder, verify=True)} == {"done"}


def test_nothing_stays_of_a_camera_without_a_map(tmp_path: Path) -> None:
    world = World(tmp_path)
    before = set(world.results())
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(DepthImage, "write", Mock(side_effect=DocDepthError("too deep")))
        with pytest.raises(DocDepthError, match="too deep"):
            render_again(world.run, {}, "image_3", threads=1)
    assert "image_3" not in RunFolder.open(world.run).cameras
    assert set(world.results()) == before


def _check_that_little_was_written(
    world: World, before: dict[Path, tuple[bytes, int]], known: dict[str, str]
) -> None:
    """Results that were as they should be have not been touched."""
    for stage, folders in (
        ("odometry", ["frames"]),
        ("classify", ["classes", "labels"]),
        ("render image_2", ["depth", "report", "layers"]),
    ):
        if known.get(stage) == "out of date" or known.get("odometry") == "out of date":
            continue
        for path, (content, time) in before.items():
            inside = path.parent.relative_to(world.run).as_posix() in folders
            rewritten = ("index.html", "depth.json")
            if inside and "render" in stage and path.stem in world.redrawn:
                continue
            if inside and path.name not in rewritten and path.read_bytes() == content:
                assert path.stat().st_mtime_ns == time, (stage, path)
