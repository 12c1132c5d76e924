"""How long a depth map takes: against points of a sweep, number of sweeps and image size.

    python benchmarks/benchmark_rendering.py RUN [-o rendering.png] [--repeat 5]

RUN is a finished run. One image in the middle of it is drawn by both presets, with sweeps thinned,
with fewer or more sweeps, and with the image smaller or larger than the camera's; medians of
several runs that take turns. A frame's surface is made once a sweep and timed apart. Needs
matplotlib (pip install "docdepth[viz]").
"""

from __future__ import annotations

import argparse
import statistics
import time
from pathlib import Path

import numpy as np

from docdepth.config import parameters
from docdepth.datasets import open_dataset
from docdepth.geometry.camera import Camera
from docdepth.io.run_folder import RunFolder
from docdepth.render.depth_map import compose_depth
from docdepth.render.frame import Frame
from docdepth.render.selection import needed_frames

PRESETS = ("default", "paper")
# Every so manieth point; spacing of the drawn sweeps [m]; size of the image over the camera's.
THINNED, STEPS, SIZES = (1, 2, 4, 8), (0.2, 0.5, 1, 2, 5), (0.5, 0.75, 1.0, 1.5, 2.0)


class Scene:
    """One image of a run, drawn in many ways."""

    def __init__(self, path: Path, threads: int) -> None:
        self.run, self.threads = RunFolder.open(path), threads
        self.trajectory = self.run.trajectory()
        self.stream = next(iter(open_dataset(path, "run").cameras.values()))
        self.time = int(self.stream.times[len(self.stream.times) // 2])
        self.seconds_a_frame: dict[str, list[float]] = {preset: [] for preset in PRESETS}

    def job(self, preset: str, thin: int = 1, step: float | None = None, size: float = 1):
        """What draws, and how many sweeps and points it draws from."""
        p = parameters(preset, {} if step is None else {"render.step": step}).render
        frames, points = {}, 0
        for k in sorted(needed_frames(self.trajectory, self.time, p)):
            record = self.run.frame(k)
            xyz, classid = record.points[::thin].copy(), record.classid[::thin].copy()
            start = time.perf_counter()
            sensor_rig, time_offset = self.run.sensor_rig(record), record.time_offset
            sensor_rig = None if sensor_rig is None else sensor_rig.select(slice(None, None, thin))
            time_offset = None if time_offset is None else time_offset[::thin]
            velocity = self.trajectory.velocity(k)
            frames[k] = Frame(
                xyz, classid, p, time_offset=time_offset, sensor_rig=sensor_rig, velocity=velocity
            )
            if thin == 1:
                self.seconds_a_frame[preset].append(time.perf_counter() - start)
            points += len(xyz)
        camera = self.stream.camera
        K = camera.K.copy()
        K[:2] *= size
        scaled = Camera(K, round(size * camera.width), round(size * camera.height))

        def draw() -> None:
            compose_depth(
                scaled, self.stream.T_camera_lidar, self.trajectory, self.time,
                frames.__getitem__, p, self.threads,
            )  # fmt: skip

        return draw, len(frames), points


def median_ms(jobs: list, repeat: int) -> list[float]:
    """Milliseconds of each job; they take turns."""
    times: list[list[float]] = [[] for _ in jobs]
    for _ in range(repeat):
        for job, spent in zip(jobs, times, strict=True):
            start = time.perf_counter()
            job()
            spent.append(1e3 * (time.perf_counter() - start))
    return [statistics.median(spent) for spent in times]


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    arguments.add_argument("run", type=Path)
    arguments.add_argument("-o", "--output", type=Path, default=Path("rendering.png"))
    arguments.add_argument("--repeat", type=int, default=5)
    arguments.add_argument("--threads", type=int, default=0)
    options = arguments.parse_args()
    scene = Scene(options.run, options.threads)
    axes: dict[str, dict[str, tuple[list[float], list[float]]]] = {}
    for preset in PRESETS:
        for label, unit, jobs in (
            ("points", 1e6, [scene.job(preset, thin=n) for n in THINNED]),
            ("sweeps", 1, [scene.job(preset, step=d) for d in STEPS]),
            ("pixels", 1e6, [scene.job(preset, size=s) for s in SIZES]),
        ):
            pixels = scene.stream.camera.width * scene.stream.camera.height
            x = {
                "points": [points / unit for _, _, points in jobs],
                "sweeps": [sweeps for _, sweeps, _ in jobs],
                "pixels": [pixels * s * s / unit for s in SIZES],
            }[label]
            y = median_ms([draw for draw, _, _ in jobs], options.repeat)
            axes.setdefault(label, {})[preset] = (x, y)
            for a, b in zip(x, y, strict=True):
                print(f"{preset:8} {label} {a:8.2f}{' M' if unit > 1 else '  '}  {b:7.1f} ms")
        made = 1e3 * statistics.median(scene.seconds_a_frame[preset])
        print(f"{preset:8} making a frame {made:.1f} ms")
    plot(axes, options.output)


def plot(axes: dict, path: Path) -> None:
    """A panel for each thing that varies."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, panels = pyplot.subplots(1, len(axes), figsize=(12, 3.5), sharey=True)
    for panel, (label, curves) in zip(panels, axes.items(), strict=True):
        for preset, (x, y) in curves.items():
            panel.plot(x, y, "o-", label=preset)
        panel.set_xlabel({"points": "million points", "pixels": "million pixels"}.get(label, label))
    panels[0].set_ylabel("ms a map")
    panels[0].set_ylim(0, 1.05 * max(max(y) for c in axes.values() for _, y in c.values()))
    panels[0].legend()
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    print(f"plot in {path}")


if __name__ == "__main__":
    np.seterr(all="ignore")
    main()
