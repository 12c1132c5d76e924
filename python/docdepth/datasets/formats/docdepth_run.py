"""A run folder as a recording: its frames are the sweeps."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.base import CameraStream, DatasetRepr, LidarStream, Sweep
from docdepth.datasets.format import Format
from docdepth.datasets.point_times import sweep_seconds
from docdepth.errors import DamagedFileError
from docdepth.geometry.points import DYNAMIC, MOVING_LABEL, STATIC_LABEL
from docdepth.io.depth import DESCRIPTION
from docdepth.io.frames import read_frame_name, read_trajectory
from docdepth.io.run_folder import RunFolder
from docdepth.io.untrusted import parse_json, read_file


class RunDataset(DatasetRepr):
    """Deskewed sweeps and poses of a run folder, of docdepth or of the official release."""

    name = "run"

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        self._run = RunFolder.open(self.path)
        trajectory = self._run.trajectory()
        self.times: NDArray[np.int64] = trajectory.times
        self.poses: NDArray[np.float64] | None = trajectory.poses
        self._period = sweep_seconds(self.times)
        self.cameras: dict[str, CameraStream] = {}
        several = sorted(p.parent.name for p in self.path.glob("cameras/*/traj_camera.ply"))
        for name in ["", *several]:
            trajectory_path = self._run.calibration_folder(name) / "traj_camera.ply"
            if not trajectory_path.is_file():
                continue
            camera, T_camera_lidar, distortion = self._run.calibration(name)
            shutter, indices = read_trajectory(trajectory_path)
            self.cameras[name or "camera"] = CameraStream(
                name or "camera",
                camera,
                T_camera_lidar,
                shutter.times,
                self._image_names(name, shutter.times, indices),
                distortion=np.array(distortion) if any(distortion) else None,
            )

    def _image_names(
        self, folder: str, times: NDArray[np.int64], indices: NDArray[np.int64]
    ) -> list[str]:
        """As the maps of the run are named; their numbers where these are not all there."""
        path = self.path / "depth" / folder / DESCRIPTION
        try:
            maps = parse_json(read_file(path))["maps"]
            names = {int(one["time_ns"]): name for name, one in maps.items()}
            found = [names[time] for time in times.tolist()]
            if len(set(found)) < len(found) or any(Path(name).name != name for name in found):
                raise ValueError("names are not those of files of one folder")
            return found
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            return [f"{i:010d}" for i in indices]

    def __reduce__(self) -> tuple[type[RunDataset], tuple[Path]]:
        return RunDataset, (self.path,)  # the run keeps locks, which other processes cannot have

    def __len__(self) -> int:
        return len(self.times)

    @cached_property
    def lidars(self) -> dict[str, LidarStream]:
        """The LiDARs of the recording as one: its frames do not tell when each measured."""
        self._run.check_has_frames()
        names = [read_frame_name(self._run.frame_path(k)) for k in range(len(self))]
        return {"lidar": LidarStream("lidar", self.times, names)}

    def sweep(self, index: int) -> Sweep:
        """Frame ``index``: the usable returns of the original sweep, deskewed."""
        record = self._run.frame(index)
        late = record.time_offset if self._period else None
        return Sweep(
            record.points,
            record.name,
            int(self.times[index]),
            relative_time=None if late is None else late / np.float32(self._period),
            sensor_rig=record.sensor_rig,
            motion_compensated=True,
        )

    def sweep_files(self, index: int) -> list[Path]:
        """The PLY of frame ``index``."""
        self._run.check_has_frames()
        path = self._run.frame_path(index)
        if not path.is_file():
            raise DamagedFileError(path, "")
        return [path]

    def labels(self, index: int) -> NDArray[np.uint32] | None:
        """SemanticKITTI labels: 251 for dynamic points, 9 for others; None without classes."""
        classid = self._run.frame(index).classid
        if classid is None:
            return None
        return np.where(classid >= DYNAMIC, MOVING_LABEL, STATIC_LABEL).astype(np.uint32)


FORMAT: Format = Format(
    "run",
    "a run folder with frames/frame_000000.ply and traj_odometry.ply",
    # Without frames it is still a run, whose poses can be had.
    lambda path: (
        (path / "traj_odometry.ply").is_file()
        and ((path / "frames").is_dir() or (path / "run.yaml").is_file())
    ),
    lambda path, image_size: RunDataset(path),
    found_below=False,
)
