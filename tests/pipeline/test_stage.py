"""Two toy stages under random kills, losses, damage and changes: the engine mends what is wrong."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from docdepth.config import Parameters
from docdepth.io.run_folder import RunFolder
from docdepth.pipeline.stage import FrameOutputs, Stage

FRAMES = 4


@pytest.fixture(autouse=True, scope="module")
def _no_power_failure() -> Iterator[None]:
    """Nothing here asks whether files are on the disk, which takes most of the time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda stream: None)
        yield


class Killed(BaseException):
    """In place of a signal."""


@dataclass
class Toy:
    """A run of two stages; each frame of the second is made of one of the first and of an image."""

    root: Path
    factor: int = 2
    offset: int = 1
    images: list[int] = field(default_factory=lambda: [0] * FRAMES)
    written: list[str] = field(default_factory=list)
    left: int = 10**6  # writes until the process is killed

    def stages(self) -> list[Stage]:
        run = RunFolder.create(self.root, None, Parameters())
        first = Stage(
            run,
            "odometry",
            {"version": 1, "odometry": {"factor": self.factor}},
            [FrameOutputs([self.root / "frames" / f"{k}"]) for k in range(FRAMES)],
            [self.root / "poses"],
            [self.root / "frames"],
        )
        second = Stage(
            run,
            "render front",
            {"version": 1, "odometry": first.key, "render": {"offset": self.offset}},
            [
                FrameOutputs(
                    [self.root / "depth" / f"{k}", self.root / "report" / f"{k}"],
                    {"image": str(self.images[k])},
                    f"image {k}",
                )
                for k in range(FRAMES)
            ],
            [self.root / "camera"],
            [self.root / "depth", self.root / "report"],
            previous=first,
        )
        return [first, second]

    def content(self, path: Path) -> bytes:
        """What a file has to hold."""
        kind, k = path.parent.name, int(path.name) if path.name.isdigit() else 0
        return {
            "frames": f"frame {k * self.factor}",
            "depth": f"depth {k * self.factor + self.offset} {self.images[k]}",
            "report": f"report {self.images[k]}",
        }.get(kind, f"{path.name} {self.factor} {self.offset * (path.name == 'camera')}").encode()

    def make(self) -> None:
        for stage in self.stages():
            left = stage.left()
            if not left and stage.is_made_once():
                continue
            with stage.working():
                for path in stage.once:
                    self.write(stage, path, {})
                for k in left:
                    for path in stage.frames[k].files:
                        self.write(stage, path, dict(stage.frames[k].made_of))
                stage.remove_outdated()

    def write(self, stage: Stage, path: Path, more: dict[str, str]) -> None:
        self.left -= 1
        if self.left == 0:
            raise Killed
        content = self.content(path)
        stage.run.write(path, lambda stream: stream.write(content), {**stage.made_of, **more})
        self.written.append(path.relative_to(self.root).as_posix())

    def results(self) -> dict[str, bytes]:
        """All files, but those that were changed and are kept beside the new ones."""
        places = [self.root / "poses", self.root / "camera"]
        for kind in ("frames", "depth", "report"):
            places += (self.root / kind).glob("*")
        files = [p for p in places if p.is_file() and ".old" not in p.name]
        return {p.relative_to(self.root).as_posix(): p.read_bytes() for p in files}

    def expected(self) -> dict[str, bytes]:
        files = [
            file
            for stage in self.stages()
            for files in [*(outputs.files for outputs in stage.frames), stage.once]
            for file in files
        ]
        return {file.relative_to(self.root).as_posix(): self.content(file) for file in files}

    def states(self, verify: bool = False) -> dict[str, str]:
        return {stage.name: stage.state(verify).state for stage in self.stages()}


def change(toy: Toy, number: int) -> None:
    if number % 3 == 0:
        toy.factor += 1
    elif number % 3 == 1:
        toy.offset += 1
    else:
        toy.images[number % FRAMES] += 1


def change_back(toy: Toy, number: int) -> None:
    toy.factor, toy.offset = 2, 1


def lose(toy: Toy, number: int) -> None:
    if found := sorted(toy.results()):
        (toy.root / found[number % len(found)]).unlink()


def lose_folder(toy: Toy, number: int) -> None:
    shutil.rmtree(toy.root / ["frames", "depth", "report"][number % 3], ignore_errors=True)


def damage(toy: Toy, number: int) -> None:
    if found := sorted(toy.results()):
        path = toy.root / found[number % len(found)]
        path.write_bytes(path.read_bytes()[:-1] + bytes([number % 256]) * (number % 2))
        os.utime(path, ns=(number, number))


def kill(toy: Toy, number: int) -> None:
    toy.left = 1 + number % (4 * FRAMES)
    try:
        toy.make()
    except Killed:
        pass
    finally:
        toy.left = 10**6


def make(toy: Toy, number: int) -> None:
    toy.make()


ACTIONS = [change, change_back, lose, lose_folder, damage, damage, kill, make]


@given(st.lists(st.tuples(st.sampled_from(ACTIONS), st.integers(0, 10**6)), max_size=8))
@settings(max_examples=30, deadline=None, derandomize=True)
def test_whatever_happened_the_same_is_made_and_no_more(tmp_path_factory, actions) -> None:
    toy = Toy(tmp_path_factory.mktemp("toy"))
    for action, number in actions:
        action(toy, number)
    told, before, expected = toy.states(verify=True), toy.results(), toy.expected()
    keys = {
        name: toy.stages()[0].run.recorded_key(toy.root / name) for name in before
    }  # what is there was made of

    toy.written.clear()
    toy.make()

    assert toy.results() == expected
    assert set(toy.states(verify=True).values()) == {"done"}
    wrong = {name for name in expected if before.get(name) != expected[name]}
    assert wrong <= set(toy.written)
    if not wrong:
        # Nothing but what was made of other inputs, though it has the same content.
        run = toy.stages()[0].run
        same = [n for n in toy.written if "/" in n and keys[n] == run.recorded_key(toy.root / n)]
        assert same == []
    assert (set(told.values()) == {"done"}) == (not toy.written)
    toy.written.clear()
    toy.make()
    assert toy.written == []


@pytest.fixture
def made(tmp_path: Path) -> Toy:
    toy = Toy(tmp_path)
    toy.make()
    return toy


def why(toy: Toy) -> list[tuple[str, str]]:
    return [(s.state, s.why) for s in (stage.state() for stage in toy.stages())]


def test_a_changed_input_is_named_in_each_stage_after_it(made: Toy) -> None:
    made.factor = 7
    reason = "odometry.factor was 2, is 7"
    assert why(made) == [
        ("out of date", reason),
        ("out of date", f"odometry is out of date: {reason}"),
    ]
    made.factor, made.offset = 2, 5
    assert why(made) == [("done", ""), ("out of date", "render.offset was 1, is 5")]


def test_a_stage_before_that_was_made_again_is_named(made: Toy) -> None:
    made.factor = 7
    first, _ = made.stages()
    with first.working():
        for path in (file for outputs in first.frames for file in outputs.files):
            made.write(first, path, {})
        made.write(first, first.once[0], {})
    assert why(made) == [("done", ""), ("out of date", "odometry was made again")]


def test_files_that_are_not_as_they_should_be_are_named(made: Toy) -> None:
    (made.root / "depth" / "2").unlink()
    (made.root / "frames" / "1").write_bytes(b"other")
    made.images[0] = 3
    assert why(made) == [
        ("damaged", "frames/1 differs from what was written"),
        ("incomplete", "depth/2 is missing"),
    ]
    state = made.stages()[1].state()
    assert (state.frames, state.all_frames) == (FRAMES - 2, FRAMES)


def test_changed_images_are_named_and_redrawn_alone(made: Toy) -> None:
    made.images[1] = made.images[3] = 8
    assert why(made)[1] == ("out of date", "2 images have changed, image 1 first")
    made.written.clear()
    made.make()
    drawn = {name for name in made.written if name.startswith("depth")}
    assert drawn == {"depth/1", "depth/3"}


def test_profiles_of_commands_add_up_as_long_as_the_inputs_are_the_same(made: Toy) -> None:
    first, _ = made.stages()
    with first.working() as profile:
        profile.frames = 3
    with contextlib.suppress(Killed), made.stages()[0].working() as profile:
        profile.frames = 2
        raise Killed
    entry = made.stages()[0].run.stage("odometry")
    assert (entry.state, entry.frames, entry.total_frames) == ("running", 2, 5)
    made.factor = 3
    with made.stages()[0].working() as profile:
        profile.frames = 1
    assert made.stages()[0].run.stage("odometry").total_frames == 1
