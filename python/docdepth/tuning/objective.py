"""What trials are scored by: true labels, true depth maps, or sweeps that were left out."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from docdepth.errors import DatasetError
from docdepth.evaluation.held_out import evaluate_held_out
from docdepth.evaluation.runs import evaluate_depth, evaluate_labels
from docdepth.io.run_folder import RunFolder

LABELS = ("odometry", "ground", "dynamics")
_TRUTH = {"labels": "labels", "depth": "depth_2"}
"""Folder of the truth in a recording."""


@dataclass(frozen=True)
class Objective:
    """What trials are scored by.

    Parameters
    ----------
    by : {"held-out", "labels", "depth"}
        ``held-out`` compares depth with sweeps that were left out and needs no truth.
    truth : Path, optional
        True labels or depth maps, as for ``docdepth evaluate``.
    camera : str, optional
        Needed for depth where the run has several.
    every : int
        ``held-out`` leaves out every n-th sweep, one at a time.
    """

    by: Literal["held-out", "labels", "depth"] = "held-out"
    truth: Path | None = None
    camera: str | None = None
    every: int = 10

    @property
    def stages(self) -> tuple[str, ...]:
        """Stages whose parameters can change the score."""
        return LABELS if self.by == "labels" else (*LABELS, "render")

    def check(self, run: RunFolder) -> None:
        """Refuse a truth that is not there, and a run without this camera."""
        self.truth_files()
        if self.by != "labels":
            run.calibration(run.depth_folder(self.camera))

    def measure(self, trial: Path, threads: int = 0) -> dict[str, object]:
        """All metrics of a run folder by name."""
        if self.truth is None:
            options = {"camera": self.camera, "threads": threads}
            return evaluate_held_out(trial, self.every, **options).as_dict()  # type: ignore[arg-type]
        if self.by == "labels":
            return evaluate_labels(trial, self.truth).as_dict()
        return evaluate_depth(trial, self.truth, camera=self.camera).as_dict()

    def truth_files(self) -> list[list[Any]]:
        """Name, size and time of the files of the truth."""
        if self.truth is None:
            return []
        if not self.truth.is_dir():
            exists = self.truth.exists()
            raise DatasetError(f"{self.truth} is {'not a folder' if exists else 'not there'}")
        inside = self.truth / _TRUTH[self.by]
        with os.scandir(inside if inside.is_dir() else self.truth) as files:
            known = [(file.path, file.stat()) for file in files if file.is_file()]
        return sorted([os.path.abspath(path), s.st_size, s.st_mtime_ns] for path, s in known)
