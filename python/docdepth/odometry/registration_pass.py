"""One pass of odometry over a drive, and what is kept of it on disk."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docdepth.config import OdometryParameters
from docdepth.datasets.base import Dataset
from docdepth.errors import InputError, OdometryError
from docdepth.io.atomic import write_atomically
from docdepth.odometry.deskewing import AROUND, centred_motion, deskew
from docdepth.odometry.registration import PreviousPoses, register

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class DeskewedSweeps:
    """Sweeps read when asked for and deskewed with the motion at their stamp."""

    dataset: Dataset
    motion: Callable[[int], NDArray[np.float64]] | None

    def __call__(self, index: int) -> NDArray[np.float32]:
        sweep = self.dataset.sweep(index)
        if sweep.motion_compensated or sweep.relative_time is None or self.motion is None:
            return sweep.points
        try:
            return deskew(sweep.points, sweep.relative_time, self.motion(index))
        except InputError as error:
            raise OdometryError(f"sweep {sweep.name} (frame {index}): {error}") from None


@dataclass(frozen=True)
class RegistrationPass:
    """One pass: every sweep registered once, deskewed with the poses of the pass before.

    Attributes
    ----------
    number : int
        From 0; the first finds the way, the others refine it.
    kept : Path, optional
        File of the poses of the whole pass.
    """

    number: int
    dataset: Dataset
    parameters: OdometryParameters
    kept: Path | None

    def run(
        self, before: PreviousPoses | None, tell: Callable[[int, NDArray[np.float64]], object]
    ) -> NDArray[np.float64]:
        """Poses (n, 4, 4), kept once they are whole; ``tell(k, pose)`` after each sweep."""
        count = len(self.dataset)

        def motion(k: int) -> NDArray[np.float64]:
            assert before is not None
            known = before(min(k + AROUND, count - 1))
            one: NDArray[np.float64] = centred_motion(known, self.dataset.times, [k])[0]
            return one

        points = DeskewedSweeps(self.dataset, None if before is None else motion)
        poses = np.repeat(np.eye(4)[None], count, axis=0)
        for k, pose in enumerate(register(points, count, self.parameters, before)):
            poses[k] = pose
            tell(k, pose)
        self._save(poses)
        return poses

    def load(self) -> NDArray[np.float64] | None:
        """Poses of an earlier run, if they are of the same drive and parameters."""
        if self.kept is None or not self.kept.is_file():
            return None
        with np.load(self.kept) as kept:
            if str(kept["key"]) != self._key():
                return None
            poses: NDArray[np.float64] = kept["poses"]
        log.info("odometry goes on after %s", self.kept.name)
        return poses

    def _save(self, poses: NDArray[np.float64]) -> None:
        if self.kept is None:
            return
        key = np.array(self._key())
        write_atomically(self.kept, lambda stream: np.savez(stream, poses=poses, key=key))

    def _key(self) -> str:
        settings = self.parameters.model_dump_json(exclude={"passes"})
        return f"{Path(self.dataset.path).resolve()} {len(self.dataset)} {settings}"
