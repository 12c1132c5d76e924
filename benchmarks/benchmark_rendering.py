"""Duration of a depth map against points per sweep, number of sweeps and image size.

    python benchmarks/benchmark_rendering.py RUN [-o rendering.png] [--repeat 5]

RUN is a finished run. The image in its middle is drawn with both presets: with thinned sweeps, with
fewer or more sweeps, and with a smaller or larger image. Prints medians of runs that take turns. A
frame is prepared once per sweep and timed apart. Needs matplotlib (pip install "docdepth[viz]").
"""

from __future__ import annotations

import argparse
import statistics
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from timing import interleaved, seconds

from docdepth.config import Parameters, parameters
from docdepth.datasets import open_dataset
from docdepth.geometry.camera import Camera
from docdepth.io.run_folder import RunFolder
from docdepth.render.depth_map import compose_depth
from docdepth.render.frame import Frame
from docdepth.render.selection import needed_frames

PRESETS = ("default", "paper")
# Every n-th point of a sweep; spacing of the drawn sweeps [m]; image size as a multiple.
THINNED, STEPS, SIZES = (1, 2, 4, 8), (0.2, 0.5, 1, 2, 5), (0.5, 0.75, 1.0, 1.5, 2.0)
LABELS = {"points": "million points", "sweeps": "sweeps", "pixels": "million pixels"}


class Job(NamedTuple):
    """One way to draw the image, and what it draws."""

    draw: Callable[[], object]
    sweeps: int
    points: int
    pixels: int


class View:
    """The image in the middle of a run."""

    def __init__(self, path: Path, threads: int) -> None:
        self.run, self.threads = RunFolder.open(path), threads
        self.trajectory = self.run.trajectory()
        self.stream = next(iter(open_dataset(path, "run").cameras.values()))
        self.time = int(self.stream.times[len(self.stream.times) // 2])
        self.frame_seconds: dict[str, list[float]] = {preset: [] for preset in PRESETS}

    def job(self, preset: str, thin: int = 1, step: float | None = None, size: float = 1) -> Job:
        """Prepare all frames of one way to draw the image."""
        p = parameters(preset, {} if step is None else {"render.step": step})
        needed = sorted(needed_frames(self.trajectory, self.time, p.render))
        frames = {k: self._frame(k, p, thin) for k in needed}
        points = sum(len(self.run.points(k)[::thin]) for k in needed)
        camera, K = self.stream.camera, self.stream.camera.K.copy()
        K[:2] *= size
        scaled = Camera(K, round(size * camera.width), round(size * camera.height))
        view = scaled, self.stream.T_camera_lidar, self.trajectory, self.time
        return Job(
            lambda: compose_depth(*view, frames.__getitem__, p.render, self.threads),
            len(needed),
            points,
            scaled.width * scaled.height,
        )

    def _frame(self, index: int, p: Parameters, thin: int) -> Frame:
        record, classid = self.run.classified_frame(index)
        every = slice(None, None, thin)
        rig, time_offset = self.run.sensor_rig(record), record.time_offset
        rig = None if rig is None else rig.select(every)
        time_offset = None if time_offset is None else time_offset[every]
        sweep = record.points[every].copy(), classid[every].copy()
        prepared: list[Frame] = []

        def prepare() -> None:
            velocity = self.trajectory.velocity(index)
            prepared.append(Frame(*sweep, p.render, time_offset, rig, velocity))

        spent = seconds(prepare)
        if thin == 1:
            self.frame_seconds[p.preset].append(spent)
        return prepared[0]


def main() -> None:
    arguments = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    arguments.add_argument("run", type=Path)
    arguments.add_argument("-o", "--output", type=Path, default=Path("rendering.png"))
    arguments.add_argument("--repeat", type=int, default=5)
    arguments.add_argument("--threads", type=int, default=0)
    options = arguments.parse_args()
    view = View(options.run, options.threads)
    curves: dict[str, dict[str, tuple[list[float], list[float]]]] = {name: {} for name in LABELS}
    for preset in PRESETS:
        series = {
            "points": [view.job(preset, thin=n) for n in THINNED],
            "sweeps": [view.job(preset, step=d) for d in STEPS],
            "pixels": [view.job(preset, size=s) for s in SIZES],
        }
        for name, jobs in series.items():
            unit = 1 if name == "sweeps" else 1e6
            x = [getattr(job, name) / unit for job in jobs]
            medians = interleaved({str(k): job.draw for k, job in enumerate(jobs)}, options.repeat)
            y = [1e3 * median for median in medians.values()]
            curves[name][preset] = (x, y)
            for a, b in zip(x, y, strict=True):
                print(f"{preset:8} {a:8.2f} {LABELS[name]:14}  {b:7.1f} ms")
        prepared = 1e3 * statistics.median(view.frame_seconds[preset])
        print(f"{preset:8} preparing a frame {prepared:.1f} ms")
    plot(curves, options.output)


def plot(curves: dict[str, dict[str, tuple[list[float], list[float]]]], path: Path) -> None:
    """One panel for each quantity that varies."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, panels = pyplot.subplots(1, len(curves), figsize=(12, 3.5), sharey=True)
    for panel, (name, presets) in zip(panels, curves.items(), strict=True):
        for preset, (x, y) in presets.items():
            panel.plot(x, y, "o-", label=preset)
        panel.set_xlabel(LABELS[name])
    panels[0].set_ylabel("ms per depth map")
    slowest = max(max(y) for presets in curves.values() for _, y in presets.values())
    panels[0].set_ylim(0, 1.05 * slowest)
    panels[0].legend()
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    print(f"plot in {path}")


if __name__ == "__main__":
    main()
