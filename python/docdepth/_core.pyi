"""
C++ core of docdepth; use the documented functions of docdepth.* instead.
"""

from __future__ import annotations
import collections.abc
import numpy
import numpy.typing
import typing

__all__: list[str] = [
    "Frame",
    "GroundMap",
    "GroundParameters",
    "KeyFrame",
    "RangeImage",
    "render_splats",
    "vote",
]

class GroundParameters:
    def __init__(self) -> None: ...
    @property
    def max_slope(self) -> float: ...
    @max_slope.setter
    def max_slope(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def neighbors(self) -> int: ...
    @neighbors.setter
    def neighbors(self, arg0: typing.SupportsInt | typing.SupportsIndex) -> None: ...
    @property
    def plane_distance(self) -> float: ...
    @plane_distance.setter
    def plane_distance(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def seed_radius(self) -> float: ...
    @seed_radius.setter
    def seed_radius(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def voxel_size(self) -> float: ...
    @voxel_size.setter
    def voxel_size(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...

class GroundMap:
    def __init__(
        self, parameters: GroundParameters, threads: typing.SupportsInt | typing.SupportsIndex = 0
    ) -> None: ...
    def __len__(self) -> int: ...
    def grow(self) -> int: ...
    def insert(
        self,
        points: typing.Annotated[numpy.typing.ArrayLike, numpy.float32],
        T_world_lidar: typing.Annotated[numpy.typing.ArrayLike, numpy.float64],
    ) -> None: ...
    def label(
        self,
        points: typing.Annotated[numpy.typing.ArrayLike, numpy.float32],
        T_world_lidar: typing.Annotated[numpy.typing.ArrayLike, numpy.float64],
    ) -> numpy.typing.NDArray[numpy.bool]: ...

class KeyFrame:
    pass

class RangeImage(KeyFrame):
    def __init__(
        self,
        points: typing.Annotated[numpy.typing.ArrayLike, numpy.float32],
        ground: typing.Annotated[numpy.typing.ArrayLike, numpy.bool],
        resolution: typing.SupportsFloat | typing.SupportsIndex,
        window: typing.SupportsInt | typing.SupportsIndex,
        tolerance: typing.SupportsFloat | typing.SupportsIndex,
    ) -> None: ...

class Frame:
    def __init__(
        self,
        points: typing.Annotated[numpy.typing.ArrayLike, numpy.float32],
        classid: typing.Annotated[numpy.typing.ArrayLike, numpy.uint16],
        crop: typing.SupportsFloat | typing.SupportsIndex,
    ) -> None: ...
    @property
    def dynamic_size(self) -> int: ...
    @property
    def static_size(self) -> int: ...

def render_splats(
    K: typing.Annotated[numpy.typing.ArrayLike, numpy.float64],
    width: typing.SupportsInt | typing.SupportsIndex,
    height: typing.SupportsInt | typing.SupportsIndex,
    static_frames: collections.abc.Sequence[
        tuple[Frame, typing.Annotated[numpy.typing.ArrayLike, numpy.float64]]
    ],
    dynamic_frames: collections.abc.Sequence[
        tuple[Frame, typing.Annotated[numpy.typing.ArrayLike, numpy.float64]]
    ],
    static_size: tuple[
        typing.SupportsFloat | typing.SupportsIndex, typing.SupportsFloat | typing.SupportsIndex
    ],
    dynamic_size: tuple[
        typing.SupportsFloat | typing.SupportsIndex, typing.SupportsFloat | typing.SupportsIndex
    ],
    threads: typing.SupportsInt | typing.SupportsIndex = 0,
) -> numpy.typing.NDArray[numpy.float32]: ...
def vote(
    points: typing.Annotated[numpy.typing.ArrayLike, numpy.float32],
    ground: typing.Annotated[numpy.typing.ArrayLike, numpy.bool],
    T_world_lidar: typing.Annotated[numpy.typing.ArrayLike, numpy.float64],
    key_frames: collections.abc.Sequence[KeyFrame],
    poses: typing.Annotated[numpy.typing.ArrayLike, numpy.float64],
    threads: typing.SupportsInt | typing.SupportsIndex = 0,
) -> tuple: ...

__version__: str = "0.1.0"
