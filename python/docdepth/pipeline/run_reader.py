"""A run folder, read: images with depth and poses, sweeps with classes, tracks, the static map.

Arrays are read when they are asked for and are not kept. Nothing is written.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.config import Parameters
from docdepth.datasets.base import CameraStream, ReadSequence, checked_index
from docdepth.errors import DamagedFileError, RunError
from docdepth.geometry.camera import Camera
from docdepth.geometry.lidar_frame import LidarFrame
from docdepth.geometry.points import DYNAMIC
from docdepth.geometry.se3 import inverse
from docdepth.geometry.track import Tracks
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.depth import described_maps, maps_in, read_depth
from docdepth.io.images import encode_image
from docdepth.io.run_folder import RunFolder
from docdepth.io.tracks import tracks_in
from docdepth.io.untrusted import read_layers
from docdepth.pipeline.cameras import camera_parameters, run_cameras
from docdepth.pipeline.cloud_map import VOXEL, CloudMap, gather_map
from docdepth.pipeline.run_inputs import check_place, recording_of
from docdepth.render.layers import LAYERS, TRIANGLES_ONLY
from docdepth.render.occupancy import MountedCamera, Occupancy, OccupancyGrids
from docdepth.render.scene import Scene, render_layers
from docdepth.visualization.pictures import overlay


def open_run(path: Path | str) -> Run:
    """Open a run folder to read it.

    Parameters
    ----------
    path : Path or str

    Raises
    ------
    RunError
        It holds no run, or one that is damaged.
    """
    run = Run(path)
    len(run.sweeps)  # a run has at least poses
    return run


class Run:
    """A run folder: what ``docdepth run`` found, as arrays.

    It can be pickled, so that a data loader may use it in worker processes.

    Parameters
    ----------
    path : Path or str

    Attributes
    ----------
    path : Path
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)

    def __fspath__(self) -> str:
        return str(self.path)

    def __reduce__(self) -> tuple[type[Run], tuple[Path]]:
        return Run, (self.path,)  # a folder keeps locks, which other processes cannot have

    def __repr__(self) -> str:
        cameras = ", ".join(f"{c} ({len(of)} images)" for c, of in self.cameras.items()) or "none"
        return (
            f"<Run {self.path}: {len(self.sweeps)} sweeps, {len(self.tracks)} tracks, "
            f"cameras: {cameras}>"
        )

    @cached_property
    def folder(self) -> RunFolder:
        """Its files."""
        return RunFolder.open(self.path)

    @property
    def parameters(self) -> Parameters:
        """The parameters of the run."""
        return self.folder.parameters

    @cached_property
    def trajectory(self) -> Trajectory:
        """``T_world_lidar`` of each sweep."""
        return self.folder.trajectory()

    @cached_property
    def tracks(self) -> Tracks:
        """The moving objects by id: where each is over time, and how large."""
        return tracks_in(self.path)

    @cached_property
    def sweeps(self) -> RunSweeps:
        """The sweeps: deskewed points with class and instance."""
        return RunSweeps(self)

    @cached_property
    def cameras(self) -> dict[str, RunImages]:
        """The images of each camera that have depth, by the camera's name.

        Raises
        ------
        RunError
            The depth maps of a camera are not done.
        """
        return {name: RunImages(self, name) for name in self.folder.cameras}

    def static_map(self, voxel: float = VOXEL) -> CloudMap:
        """What stands, in the world: the mean of the static points of each voxel.

        Parameters
        ----------
        voxel : float
            Side of a voxel [m].

        Raises
        ------
        RunError
            The frames were deleted, or are not classified.
        """
        return gather_map(self.folder, voxel)[0]

    def occupancy(self, index: int) -> Occupancy:
        """What is free and what is occupied around the vehicle at a sweep.

        The rays of some fifty sweeps are kept for the next call, so ask in order of time.

        Parameters
        ----------
        index : int
            Of the sweep; negative ones count from the end.

        Raises
        ------
        RunError
            The frames were deleted, or are not classified.
        InputError
            No ground is found below the vehicle.
        """
        return self._occupancy.at(checked_index(index, len(self.sweeps), "sweeps"))

    @cached_property
    def _occupancy(self) -> OccupancyGrids:
        recorded = [entry for entry in self.folder.cameras.values() if entry.virtual is None]
        cameras = [MountedCamera(*self.folder.calibration(entry.folder)[:2]) for entry in recorded]
        return OccupancyGrids(self.sweeps, self.trajectory, self.tracks, cameras)


class RunSweeps(ReadSequence[LidarFrame]):
    """The sweeps of a run: ``points``, ``classid``, ``instance`` of each.

    Points are those of usable returns, in the LiDAR frame at the sweep's stamp [m].
    """

    def __init__(self, run: Run) -> None:
        self.run = run

    def __len__(self) -> int:
        return len(self.run.trajectory)

    def __repr__(self) -> str:
        return f"<{len(self)} sweeps of {self.run.path}>"

    def read(self, index: int) -> LidarFrame:
        """Read sweep ``index``."""
        return self.run.folder.classified_frame(index)[0]


class RunImages(ReadSequence["RunImage"]):
    """The images of one camera of a run that have a depth map, in order of time.

    Attributes
    ----------
    name : str
        Of the camera.
    camera : Camera
        The rectified camera of depth and image.
    T_camera_lidar : ndarray of float64, shape (4, 4)
    names : list of str
        Of the images.
    times : ndarray of int64, shape (n,)
        Of the images [ns].
    """

    def __init__(self, run: Run, name: str) -> None:
        folder = run.folder
        self.run, self.name, self.what = run, name, f"images of {name}"
        self.subfolder = folder.cameras[name].folder
        self.camera, self.T_camera_lidar, _ = folder.calibration(self.subfolder)
        maps = described_maps(run.path / "depth" / self.subfolder)
        if not maps or folder.stage(f"render {name}").state != "done":
            raise RunError(
                f"the depth maps of {name} in {run.path} are not done",
                f"go on: `docdepth.run(..., {str(run.path)!r})`",
            )
        self.names = list(maps)
        self.times = np.array([time for time, _ in maps.values()], np.int64)
        if any(Path(one).name != one for one in maps):
            raise DamagedFileError(run.path / "depth", "it names files of other folders")

    def __len__(self) -> int:
        return len(self.names)

    def __repr__(self) -> str:
        size = f"{self.camera.width} x {self.camera.height}"
        return f"<{len(self)} images of {self.name}, {size}, in {self.run.path}>"

    def read(self, index: int) -> RunImage:
        """Image ``index``, whose arrays are read when they are asked for."""
        return RunImage(self, index)

    def __getstate__(self) -> dict[str, object]:
        return {k: v for k, v in self.__dict__.items() if k not in ("stream", "scene")}

    @cached_property
    def depth_files(self) -> dict[str, Path]:
        """The depth map of each image, of several formats the most exact."""
        return maps_in(self.run.path / "depth" / self.subfolder)

    @cached_property
    def stream(self) -> CameraStream:
        """The camera as the recording has it; without photos where that is away."""
        folder = self.run.folder
        if folder.recording_path is None or not folder.recording_path.exists():
            return CameraStream(self.name, self.camera, self.T_camera_lidar, self.times, self.names)
        return run_cameras(folder, recording_of(folder), [self.name])[0].stream

    @cached_property
    def scene(self) -> Scene:
        """What draws layers that the run has not stored."""
        run = self.run
        p = camera_parameters(run.folder, self.name)
        tracks = list(run.tracks.values())
        return Scene(run.sweeps, run.trajectory, run.sweeps, p, tracks)  # type: ignore[arg-type]


class RunImage:
    """One image of a run with its depth; arrays are read whenever they are asked for.

    Attributes
    ----------
    of : RunImages
        The images of its camera.
    index : int
        Its place among them.
    name : str
    time : int
        Nanoseconds.
    """

    def __init__(self, of: RunImages, index: int) -> None:
        self.of, self.index = of, index
        self.name, self.time = of.names[index], int(of.times[index])

    def __repr__(self) -> str:
        return f"<image {self.name} of {self.of.name} at {self.time} ns>"

    def _repr_jpeg_(self) -> bytes:
        """What a notebook shows: the depth over the photo."""
        image = self.image
        photo = None if image is None else np.ascontiguousarray(image[..., ::-1])
        return encode_image(overlay(self.depth, photo), ".jpg")

    @property
    def camera(self) -> Camera:
        """The rectified camera."""
        return self.of.camera

    @property
    def K(self) -> NDArray[np.float64]:
        """Its matrix (3, 3) in pixels; integer coordinates are pixel centres."""
        return self.of.camera.K

    @property
    def T_world_camera(self) -> NDArray[np.float64]:
        """Where it was taken (4, 4): x right, y down, z forward."""
        pose = self.of.run.trajectory.interpolate(self.time)[0]
        return np.asarray(pose @ inverse(self.of.T_camera_lidar))

    @property
    def image(self) -> NDArray[np.uint8] | None:
        """The photo without lens distortion, uint8 RGB (h, w, 3); None where there is none.

        Raises
        ------
        RunError, DatasetError
            The recording is away, or has another image by now.
        """
        stream, run = self.of.stream, self.of.run
        check_place(run.folder)
        if not stream.images:
            return None
        if self.name not in stream.names:
            raise RunError(f"the recording has no image {self.name} of {stream.name} any more")
        photo = stream.rectified_image(stream.names.index(self.name))
        return None if photo is None else np.ascontiguousarray(photo[..., ::-1])

    @property
    def depth(self) -> NDArray[np.float32]:
        """Metres along the optical axis (h, w), NaN without depth.

        Raises
        ------
        DatasetError
            The file is missing or damaged.
        """
        missing = self.of.run.path / "depth" / self.of.subfolder / f"{self.name}.png"
        return read_depth(self.of.depth_files.get(self.name, missing))

    @property
    def layers(self) -> ImageLayers:
        """Further arrays of each pixel by name, as :mod:`docdepth.render.layers` has them."""
        return ImageLayers(self)

    @property
    def moving(self) -> NDArray[np.bool_]:
        """Where the image shows a moving object (h, w), by the layer ``class``."""
        classid = self.layers["class"]
        return np.asarray((classid >= DYNAMIC) & (classid < 255))


class ImageLayers(Mapping[str, NDArray[Any]]):
    """The layers of an image: read where the run has stored them, else drawn, which takes long."""

    def __init__(self, image: RunImage) -> None:
        self._image = image

    def __iter__(self) -> Iterator[str]:
        images = self._image.of
        p = camera_parameters(images.run.folder, images.name).render
        return iter(n for n in LAYERS if p.primitive != "splats" or n not in TRIANGLES_ONLY)

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def __repr__(self) -> str:
        return f"<layers of {self._image!r}: {', '.join(self)}>"

    def __getitem__(self, name: str) -> NDArray[Any]:
        image, images = self._image, self._image.of
        if name not in tuple(self):
            raise KeyError(f"no layer {name!r}; there are {', '.join(self)}")
        file = images.run.path / "layers" / images.subfolder / f"{image.name}.npz"
        stored = read_layers(file, name)
        if name in stored:
            return stored[name]
        scene, depth = images.scene, image.depth
        return render_layers(scene, images.stream, [name], time=image.time, depth=depth)[name]
