"""Calls all of the compiled module with arguments nobody should pass: ``hostile.py SEED CASES``.

Each call starts from arguments that fit and spoils some of them. The call that is under way stands
in the last line of the output, so that a crash names it. Functions, constructors, methods and
properties are taken from the stubs, so that a new one is called as well.
"""

from __future__ import annotations

import ast
import faulthandler
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import docdepth._core as _core
from hostile_scene import Scene

STUBS = Path(_core.__file__).with_name("_core.pyi")
SLOWEST = 3.0  # seconds of one call on so few points
MEMORY = 3 << 30  # bytes; what needs more must be refused


def callables() -> dict[str, list[tuple[str, str]]]:
    """Arguments of each function, constructor and method by its dotted name: name and type."""
    tree = ast.parse(STUBS.read_text(encoding="utf-8"))
    found = {}
    for node in tree.body:
        if isinstance(node, ast.FunctionDef):
            found[node.name] = _arguments(node)
        elif isinstance(node, ast.ClassDef) and node.name != "GlError":
            for member in node.body:
                if isinstance(member, ast.FunctionDef) and not any(
                    isinstance(d, ast.Attribute) for d in member.decorator_list
                ):
                    found[f"{node.name}.{member.name}"] = _arguments(member)
    return found


def _arguments(node: ast.FunctionDef) -> list[tuple[str, str]]:
    return [
        (a.arg, ast.unparse(a.annotation) if a.annotation else "")
        for a in node.args.args
        if a.arg != "self"
    ]


def call(
    scene: Scene, name: str, arguments: list[tuple[str, str]]
) -> tuple[str, Callable[[], Any]]:
    """One call with some arguments spoiled: what is called, and the call."""
    given = {a: scene.fitting(name, a, kind) for a, kind in arguments}
    told = []
    if given:
        some = scene.random.choice(list(given), scene.random.integers(1, 4))
        for a in dict.fromkeys(some.tolist()):
            what, given[a] = scene.spoiled(given[a])
            told.append(f"{a}: {what}")
    owner, _, method = name.rpartition(".")
    values = list(given.values())
    if not owner:
        return f"{name} {told}", lambda: getattr(_core, name)(*values)
    kind = getattr(_core, owner)
    if method == "__init__":
        return f"{name} {told}", lambda: _used(scene, kind(*values))
    if method == "of":
        return f"{name} {told}", lambda: _used(scene, kind.of(*values))

    def of_instance() -> Any:
        instance = scene.instances.get(owner, kind)()
        member = getattr(instance, method)
        return member(*values) if callable(member) else member

    return f"{name} {told}", of_instance


def _used(scene: Scene, made: Any) -> None:
    """Use an object that was made of bad arguments as its room does."""
    good = scene.good
    camera = (good["K"], good["width"], good["height"])
    if isinstance(made, _core.GroundMap):
        made.insert(scene.points, np.eye(4))
        made.grow()
        made.label(scene.points, np.eye(4))
    elif isinstance(made, _core.ScanMesh):
        of_mesh = made.triangles, made.discontinuity, made.isolated
        if len(of_mesh[0]) and max(of_mesh[0].max(), len(of_mesh[2])) < len(scene.points):
            of_objects = good["isolated_angle"], good["owner"], good["motion"]
            _core.MeshFrame(scene.points, good["classid"], *of_mesh, *of_objects)
    elif isinstance(made, _core.KeyFrame):
        _core.vote(scene.points, good["ground"], np.eye(4), [made], np.eye(4)[None], 1)
    elif isinstance(made, _core.Frame):
        placed = [(made, np.eye(4))]
        depth = _core.render_splats(*camera, placed, placed, (50.0, 3.0), (80.0, 35.0), 1)
        _core.splat_layers(*camera, placed, placed, (50.0, 3.0), (80.0, 35.0), depth, 1)
    elif isinstance(made, _core.MeshFrame):
        statics = [*scene.static_meshes[:1], (made, np.eye(4))]
        sightings = [(made, k + 1, np.eye(4), 4) for k in range(min(made.objects, 9))]
        moving = [*scene.sighted, (3, sightings, sightings, sightings)]
        around = [(made, np.eye(4), 0.0)]
        boxes = [(np.eye(4), (4.0, 2.0, 4.2))]
        depth = _core.render_meshes(*camera, statics, moving, 3, 1, around, boxes)
        _core.mesh_layers(*camera, statics, moving, 3, depth, 1, around, True)
    elif isinstance(made, _core.Rays):
        made.query_visibility(scene.points)
    elif isinstance(made, _core.Detections):
        _ = made.arrays
        found = [made, *(good["read"](k) for k in range(4)), made]
        times = np.arange(len(found)) * 0.1
        _core.track_objects(found.__getitem__, times, _core.TrackParameters(), 1, good["take"], 2)
    elif isinstance(made, _core.GroundParameters):
        made.neighbors = 3


def say(text: str) -> None:
    """At once, so that it is there after a crash."""
    sys.stdout.write(text.encode("ascii", "backslashreplace").decode() + "\n")
    sys.stdout.flush()


def main(seed: int, cases: int) -> int:
    faulthandler.enable()
    if "--unlimited" not in sys.argv:
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    known, scene, wrong = callables(), Scene(seed), 0
    # Drivers are not ours to test; what takes no arguments is called once.
    names = [n for n in known if not n.startswith(("egl_devices", "GlRenderer"))]
    takes = [n for n in names if known[n]]
    names += [n for n in takes for _ in range(cases // len(takes))]
    ended: dict[str, int] = {}
    for case, name in enumerate(names):
        told, made = call(scene, name, known[name])
        say(f"{case} {told}")
        started, outcome = time.perf_counter(), "a result"
        try:
            made()
        except MemoryError:
            outcome = "MemoryError"
        except Exception as error:
            outcome = type(error).__name__
        seconds = time.perf_counter() - started
        if outcome == "MemoryError" or seconds > SLOWEST:
            say(f"WRONG {outcome} after {seconds:.1f} s: {told}")
            wrong += 1
        ended[outcome] = ended.get(outcome, 0) + 1
    say(f"ended {ended}")
    return wrong


if __name__ == "__main__":
    sys.exit(min(main(int(sys.argv[1]), int(sys.argv[2])), 100))
