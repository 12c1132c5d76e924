"""Plant small faults one at a time and say which tests notice: ``python tests/mutants.py``.

A fault is a piece of code; ``{{this ~ that}}`` in it says what is replaced by what. It is found by
its text anywhere in the package and the core, so it survives moves of files. Each is planted in a
worktree of HEAD, the core is built again, and fast tests run until the first fails: related ones
first, then all others unless ``--related`` is given.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SOURCES = "cpp/docdepth", "python/docdepth"

FAULTS = {
    "tests/dynamics/test_tracking.py tests/dynamics/test_track_paths.py": [
        # matching and tracks
        "-match.shift, track) {{>= ~ <}} kMinMemberShare",
        "if (share {{< ~ >}} options_.min_share)",
        "{{< ~ >}}= kGate * kGate",
        "- state.time) {{> ~ <}} gap + kTimeTolerance",
        "place.where.width() {{> ~ <}}= kMinEgoPath",
        "object.transient_share() {{< ~ >}} kTogetherShare * share",
        # paths
        "facing.dot(model.normals[index]) {{< ~ >}} 0",
        "filtered[k], predicted[k{{ + 1 ~ }}])",
        "t <= first.time ? {{first : last ~ last : first}}",
        "distance(k) < distance(k - 1) ? {{k : k - 1 ~ k - 1 : k}}",
        "2 * inside {{> ~ <}}= points.size()",
        "there.share {{> ~ <}} found.share",
        # evidence
        "share {{> ~ <}}= kMeanFreeShare * count",
        "off.x() < half.x() {{+ ~ -}} its.x()",
        "float(count.dynamic) {{> ~ <}} kMinDynamicSampleShare",
        "(votes.static {{>= ~ <}} always)",
    ],
    "tests/dynamics/test_voting.py": [
        "(before {{> ~ <}} 0.0f ? 1 : 0)",
        "r * angle {{< ~ >}} p.max_ray_distance",
        "returns.range[i] {{> ~ <}}= image[pixels[i]]",
        "> turn / 2) corners[i][0] {{-= ~ +=}} turn",
        'reach {{+ ~ -}} _ROUNDING, "right"',
    ],
    "tests/render/test_render.py": [
        "(camera.fy * y) / z + camera.cy) {{+ ~ -}} 0.5f",
        "std::floor(sigma{{ + 0.5 ~ }})",
        "depth {{> ~ <}} p.max_depth",
    ],
    "tests/render/test_rays.py": ["(ray {{> ~ <}} range + margin)"],
    "tests/render/test_behind_boxes.py": ["enter < leave && leave {{< ~ >}} depth"],
    "tests/render/test_moving_objects.py": ["then = centre {{- ~ +}} earlier"],
    "tests/render/test_selection.py": ["arc, {{- ~ }}p.behind"],
    "tests/odometry/test_odometry.py tests/odometry/test_smoothing.py": [
        "moved = [p {{+ ~ -}} share",
        "squared {{> ~ <}} _LOST**2 and off",
    ],
    "tests/pipeline/test_stage.py": [
        "recorded.get(stage, key) {{!= ~ ==}} key",
        "made_of.items() {{<= ~ >=}} key.items()",
    ],
    "tests/geometry": [
        "right_handed = {{ ~ -}}np.linalg.det",
        "arc[i] - arc[kept[-1]] {{>= ~ <}} spacing",
        "(1.0 {{- ~ +}} np.cos(safe)) / safe**2",
    ],
    "tests/io": [
        "own.max() < times[0] {{or ~ and}} own.min() > times[-1]",
        "scale >= _PNG_MOST {{+ ~ -}} 0.5",
        '(byte_order {{or ~ and}} "<")',
    ],
    "tests/datasets/test_point_times.py": [
        "shift = {{- ~ }}round(SHARE_BEFORE[instant",
        "np.abs(late) {{<= ~ >=}} LONGEST",
    ],
}


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--work", type=Path, required=True, help="folder of the worktree; kept")
    parser.add_argument("--related", action="store_true", help="run related tests only")
    parser.add_argument("--only", type=int, nargs="*", help="numbers of faults")
    arguments = parser.parse_args()
    tree: Path = arguments.work.resolve()
    if not tree.exists():
        add = ["git", "worktree", "add", "--quiet", "--detach", str(tree), "HEAD"]
        subprocess.run(add, check=True, cwd=ROOT)
    if _build(tree):
        sys.exit(f"{tree} does not compile")
    faults = [(tests.split(), text) for tests, texts in FAULTS.items() for text in texts]
    caught, tried = 0, arguments.only or range(len(faults))
    for number in tried:
        result = _try(tree, *faults[number], arguments.related)
        caught += result.startswith("caught")
        print(f"{number:2}  {faults[number][1]:60}  {result}", flush=True)
    print(f"{caught} of {len(tried)} faults are caught")


def _try(tree: Path, tests: list[str], fault: str, related: bool) -> str:
    head, old, new, tail = re.split(r"\{\{(.*?) ~ (.*?)\}\}", fault)[:4]
    files = (p for folder in SOURCES for p in sorted((tree / folder).rglob("*")) if p.is_file())
    places = [p for p in files if p.suffix in (".cpp", ".hpp", ".py")]
    places = [p for p in places if head + old + tail in p.read_text(encoding="utf-8")]
    if len(places) != 1:
        return f"not planted: stands in {len(places)} files"
    (path,) = places
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace(head + old + tail, head + new + tail, 1), encoding="utf-8")
    try:
        if _build(tree, "docdepth_tests"):
            return "caught by the compiler"
        failed = _failure_in_cpp(tree)
        if failed is None:
            _build(tree)
            failed = _first_failure(tree, [name for name in tests if (tree / name).exists()])
        if failed is None and not related:
            failed = _first_failure(tree, ["tests"])
        return f"caught by {failed}" if failed else "survives"
    finally:
        path.write_text(text, encoding="utf-8")


def _build(tree: Path, target: str = "all") -> int:
    """Build the core in place, and its tests; not 0 if that fails."""
    build, cmake = tree / "build" / "mutants", str(Path(sys.executable).with_name("cmake"))
    if not (build / "build.ninja").exists():
        import pybind11

        options = ["-DDOCDEPTH_INPLACE=ON", "-DDOCDEPTH_TESTS=ON"]
        options += ["-DCMAKE_INTERPROCEDURAL_OPTIMIZATION=OFF"]  # it takes most of a build
        options += [f"-Dpybind11_DIR={pybind11.get_cmake_dir()}", "-G", "Ninja"]
        options += [f"-DPython_EXECUTABLE={sys.executable}"]
        options += [f"-DCMAKE_MAKE_PROGRAM={Path(sys.executable).with_name('ninja')}"]
        subprocess.run([cmake, "-S", tree, "-B", build, *options], check=True, capture_output=True)
    command = [cmake, "--build", build, "--target", target]
    return subprocess.run(command, capture_output=True).returncode


def _failure_in_cpp(tree: Path) -> str | None:
    tests = tree / "build" / "mutants" / "docdepth_tests"
    done = subprocess.run([tests], capture_output=True, text=True)
    case = re.search(r"TEST CASE:\s*(.+)", done.stdout)
    return f"C++: {case[1] if case else 'a crash'}" if done.returncode else None


def _first_failure(tree: Path, tests: list[str]) -> str | None:
    """The first test that fails; None: all pass."""
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", "--tb=no"]
    environment = os.environ | {"PYTHONPATH": str(tree / "python")}
    command += ["-m", "not slow", *tests]
    done = subprocess.run(command, cwd=tree, env=environment, capture_output=True, text=True)
    named = re.search(r"^(?:FAILED|ERROR) (\S+)", done.stdout, re.MULTILINE)
    if done.returncode == 0:
        return None
    return named[1].removeprefix("tests/") if named else f"exit code {done.returncode}"


if __name__ == "__main__":
    main()
