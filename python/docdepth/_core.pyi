"""
C++ core of docdepth; use the documented functions of docdepth.* instead.
"""
from __future__ import annotations
import collections.abc
import docdepth.errors
import numpy
import numpy.typing
import typing
__all__: list[str] = ['Detections', 'Frame', 'GlError', 'GlRenderer', 'GroundMap', 'GroundParameters', 'KeyFrame', 'Margins', 'MeshFrame', 'MeshImage', 'MeshImageParameters', 'MeshParameters', 'ObjectParameters', 'RangeImage', 'Rays', 'ScanMesh', 'TrackParameters', 'add_isolated_points', 'add_points_inside', 'classify_objects', 'cluster_objects', 'egl_devices', 'join_meshes', 'mesh_layers', 'nearest_neighbors', 'render_meshes', 'render_splats', 'splat_layers', 'track_objects', 'vote']
class GroundParameters:
    @staticmethod
    def __new__(*args, **kwargs):
        """
        (*args, **kwargs) -> None
        """
    def __init__(self) -> None:
        ...
    @property
    def least_share(self) -> float:
        ...
    @least_share.setter
    def least_share(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None:
        ...
    @property
    def max_slope(self) -> float:
        ...
    @max_slope.setter
    def max_slope(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None:
        ...
    @property
    def neighbors(self) -> int:
        ...
    @neighbors.setter
    def neighbors(self, arg0: typing.SupportsInt | typing.SupportsIndex) -> None:
        ...
    @property
    def plane_distance(self) -> float:
        ...
    @plane_distance.setter
    def plane_distance(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None:
        ...
    @property
    def seed_quantile(self) -> float:
        ...
    @seed_quantile.setter
    def seed_quantile(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None:
        ...
    @property
    def seed_radius(self) -> float:
        ...
    @seed_radius.setter
    def seed_radius(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None:
        ...
    @property
    def step_height(self) -> float:
        ...
    @step_height.setter
    def step_height(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None:
        ...
    @property
    def voxel_size(self) -> float:
        ...
    @voxel_size.setter
    def voxel_size(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None:
        ...
class GroundMap:
    @staticmethod
    def __new__(*args, **kwargs):
        """
        (*args, **kwargs) -> None
        """
    def __init__(self, parameters: GroundParameters, threads: typing.SupportsInt | typing.SupportsIndex = 0) -> None:
        ...
    def __len__(self) -> int:
        ...
    def grow(self) -> int:
        ...
    def insert(self, points: typing.Annotated[numpy.typing.ArrayLike, numpy.float32], T_world_lidar: typing.Annotated[numpy.typing.ArrayLike, numpy.float64]) -> None:
        ...
    def label(self, points: typing.Annotated[numpy.typing.ArrayLike, numpy.float32], T_world_lidar: typing.Annotated[numpy.typing.ArrayLike, numpy.float64]) -> numpy.typing.NDArray[numpy.bool]:
        ...
class MeshParameters:
    @staticmethod
    def __new__(*args, **kwargs):
        """
        (*args, **kwargs) -> None
        """
    def __init__(self) -> None:
        ...
    @property
    def flatness(self) -> float:
        ...
    @flatness.setter
    def flatness(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None:
        ...
    @property
    def jump_ratio(self) -> float:
        ...
    @jump_ratio.setter
    def jump_ratio(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None:
        ...
    @property
    def max_gap(self) -> float:
        ...
    @max_gap.setter
    def max_gap(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None:
        ...
    @property
    def noise(self) -> float:
        ...
    @noise.setter
    def noise(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None:
        ...
class ScanMesh:
    @staticmethod
    def __new__(*args, **kwargs):
        """
        (*args, **kwargs) -> None
        """
    def __init__(self, points: typing.Annotated[numpy.typing.ArrayLike, numpy.float32], parameters: MeshParameters) -> None:
        ...
    @property
    def discontinuity(self) -> numpy.typing.NDArray[numpy.uint8]:
        ...
    @property
    def isolated(self) -> numpy.typing.NDArray[numpy.uint32]:
        ...
    @property
    def triangles(self) -> numpy.typing.NDArray[numpy.uint32]:
        ...
class KeyFrame:
    @staticmethod
    def __new__(*args, **kwargs):
        """
        (*args, **kwargs) -> None
        """
class RangeImage(KeyFrame):
    @staticmethod
    def __new__(*args, **kwargs):
        """
        (*args, **kwargs) -> None
        """
    def __init__(self, points: typing.Annotated[numpy.typing.ArrayLike, numpy.float32], ground: typing.Annotated[numpy.typing.ArrayLike, numpy.bool], resolution: typing.SupportsFloat | typing.SupportsIndex, window: typing.SupportsInt | typing.SupportsIndex, tolerance: typing.SupportsFloat | typing.SupportsIndex, plain: bool = False) -> None:
        ...
class Margins:
    @staticmethod
    def __new__(*args, **kwargs):
        """
        (*args, **kwargs) -> None
        """
    def __init__(self, normal_tolerance: typing.SupportsFloat | typing.SupportsIndex, radial_tolerance: typing.SupportsFloat | typing.SupportsIndex, radial_growth: typing.SupportsFloat | typing.SupportsIndex) -> None:
        ...
    @property
    def normal_tolerance(self) -> float:
        ...
    @normal_tolerance.setter
    def normal_tolerance(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None:
        ...
    @property
    def radial_growth(self) -> float:
        ...
    @radial_growth.setter
    def radial_growth(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None:
        ...
    @property
    def radial_tolerance(self) -> float:
        ...
    @radial_tolerance.setter
    def radial_tolerance(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None:
        ...
class MeshImageParameters:
    level: Margins
    upright: Margins
    @staticmethod
    def __new__(*args, **kwargs):
        """
        (*args, **kwargs) -> None
        """
    def __init__(self) -> None:
        ...
    @property
    def ground_tolerance(self) -> float:
        ...
    @ground_tolerance.setter
    def ground_tolerance(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None:
        ...
    @property
    def level_cosine(self) -> float:
        ...
    @level_cosine.setter
    def level_cosine(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None:
        ...
    @property
    def max_ray_distance(self) -> float:
        ...
    @max_ray_distance.setter
    def max_ray_distance(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None:
        ...
    @property
    def resolution(self) -> float:
        ...
    @resolution.setter
    def resolution(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None:
        ...
    @property
    def tolerance(self) -> float:
        ...
    @tolerance.setter
    def tolerance(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None:
        ...
    @property
    def window(self) -> int:
        ...
    @window.setter
    def window(self, arg0: typing.SupportsInt | typing.SupportsIndex) -> None:
        ...
class MeshImage(KeyFrame):
    @staticmethod
    def __new__(*args, **kwargs):
        """
        (*args, **kwargs) -> None
        """
    def __init__(self, points: typing.Annotated[numpy.typing.ArrayLike, numpy.float32], ground: typing.Annotated[numpy.typing.ArrayLike, numpy.bool], mesh: ScanMesh, parameters: MeshImageParameters) -> None:
        ...
class ObjectParameters:
    @staticmethod
    def __new__(*args, **kwargs):
        """
        (*args, **kwargs) -> None
        """
    def __init__(self) -> None:
        ...
    @property
    def clear_ratio(self) -> float:
        ...
    @clear_ratio.setter
    def clear_ratio(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None:
        ...
    @property
    def clear_votes(self) -> int:
        ...
    @clear_votes.setter
    def clear_votes(self, arg0: typing.SupportsInt | typing.SupportsIndex) -> None:
        ...
    @property
    def cluster_distance(self) -> float:
        ...
    @cluster_distance.setter
    def cluster_distance(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None:
        ...
    @property
    def cluster_distance_growth(self) -> float:
        ...
    @cluster_distance_growth.setter
    def cluster_distance_growth(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None:
        ...
    @property
    def dynamic_share(self) -> float:
        ...
    @dynamic_share.setter
    def dynamic_share(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None:
        ...
    @property
    def isolated_votes(self) -> int:
        ...
    @isolated_votes.setter
    def isolated_votes(self, arg0: typing.SupportsInt | typing.SupportsIndex) -> None:
        ...
    @property
    def max_static_ratio(self) -> float:
        ...
    @max_static_ratio.setter
    def max_static_ratio(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None:
        ...
    @property
    def min_cluster_size(self) -> int:
        ...
    @min_cluster_size.setter
    def min_cluster_size(self, arg0: typing.SupportsInt | typing.SupportsIndex) -> None:
        ...
    @property
    def min_dynamic_share(self) -> float:
        ...
    @min_dynamic_share.setter
    def min_dynamic_share(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None:
        ...
    @property
    def min_object_height(self) -> float:
        ...
    @min_object_height.setter
    def min_object_height(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None:
        ...
    @property
    def min_object_points(self) -> int:
        ...
    @min_object_points.setter
    def min_object_points(self, arg0: typing.SupportsInt | typing.SupportsIndex) -> None:
        ...
    @property
    def min_object_width(self) -> float:
        ...
    @min_object_width.setter
    def min_object_width(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None:
        ...
    @property
    def neighbor_radius(self) -> float:
        ...
    @neighbor_radius.setter
    def neighbor_radius(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None:
        ...
    @property
    def observed_free_share(self) -> float:
        ...
    @observed_free_share.setter
    def observed_free_share(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None:
        ...
    @property
    def observed_free_votes(self) -> int:
        ...
    @observed_free_votes.setter
    def observed_free_votes(self, arg0: typing.SupportsInt | typing.SupportsIndex) -> None:
        ...
class TrackParameters:
    @staticmethod
    def __new__(*args, **kwargs):
        """
        (*args, **kwargs) -> None
        """
    def __init__(self) -> None:
        ...
    @property
    def max_gap(self) -> float:
        ...
    @max_gap.setter
    def max_gap(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None:
        ...
    @property
    def max_gap_standing(self) -> float:
        ...
    @max_gap_standing.setter
    def max_gap_standing(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None:
        ...
    @property
    def max_speed(self) -> float:
        ...
    @max_speed.setter
    def max_speed(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None:
        ...
    @property
    def min_detections(self) -> int:
        ...
    @min_detections.setter
    def min_detections(self, arg0: typing.SupportsInt | typing.SupportsIndex) -> None:
        ...
    @property
    def min_distance(self) -> float:
        ...
    @min_distance.setter
    def min_distance(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None:
        ...
    @property
    def window(self) -> float:
        ...
    @window.setter
    def window(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None:
        ...
class Detections:
    @staticmethod
    def __new__(*args, **kwargs):
        """
        (*args, **kwargs) -> None
        """
    @staticmethod
    def of(numbers: typing.Annotated[numpy.typing.ArrayLike, numpy.uint32], boxes: typing.Annotated[numpy.typing.ArrayLike, numpy.float32], samples: typing.Annotated[numpy.typing.ArrayLike, numpy.float32]) -> Detections:
        ...
    def __init__(self, points: typing.Annotated[numpy.typing.ArrayLike, numpy.float32], ground: typing.Annotated[numpy.typing.ArrayLike, numpy.bool], objects: typing.Annotated[numpy.typing.ArrayLike, numpy.uint32], dynamic: typing.Annotated[numpy.typing.ArrayLike, numpy.bool], T_world_lidar: typing.Annotated[numpy.typing.ArrayLike, numpy.float64]) -> None:
        ...
    @property
    def arrays(self) -> tuple:
        ...
class Frame:
    @staticmethod
    def __new__(*args, **kwargs):
        """
        (*args, **kwargs) -> None
        """
    def __init__(self, points: typing.Annotated[numpy.typing.ArrayLike, numpy.float32], classid: typing.Annotated[numpy.typing.ArrayLike, numpy.uint16], crop: typing.SupportsFloat | typing.SupportsIndex) -> None:
        ...
    @property
    def dynamic_size(self) -> int:
        ...
    @property
    def static_size(self) -> int:
        ...
class MeshFrame:
    @staticmethod
    def __new__(*args, **kwargs):
        """
        (*args, **kwargs) -> None
        """
    def __init__(self, points: typing.Annotated[numpy.typing.ArrayLike, numpy.float32], classid: typing.Annotated[numpy.typing.ArrayLike, numpy.uint16], triangles: typing.Annotated[numpy.typing.ArrayLike, numpy.uint32], discontinuity: typing.Annotated[numpy.typing.ArrayLike, numpy.uint8], isolated: typing.Annotated[numpy.typing.ArrayLike, numpy.uint32], isolated_angle: typing.SupportsFloat | typing.SupportsIndex, owner: typing.Annotated[numpy.typing.ArrayLike, numpy.uint16], motion: typing.Annotated[numpy.typing.ArrayLike, numpy.float32], time_offset: typing.Annotated[numpy.typing.ArrayLike, numpy.float32] | None = None, displacement: typing.Annotated[numpy.typing.ArrayLike, numpy.float32] | None = None, ray_origins: typing.Annotated[numpy.typing.ArrayLike, numpy.float32] | None = None) -> None:
        ...
class Rays:
    @staticmethod
    def __new__(*args, **kwargs):
        """
        (*args, **kwargs) -> None
        """
    def __init__(self, points: typing.Annotated[numpy.typing.ArrayLike, numpy.float32], normals: typing.Annotated[numpy.typing.ArrayLike, numpy.float32], ray_origins: typing.Annotated[numpy.typing.ArrayLike, numpy.float32] | None = None) -> None:
        ...
    def query_visibility(self, points: typing.Annotated[numpy.typing.ArrayLike, numpy.float32]) -> numpy.typing.NDArray[numpy.float32]:
        ...
class GlError(docdepth.errors.BackendError):
    pass
class GlRenderer:
    @staticmethod
    def __new__(*args, **kwargs):
        """
        (*args, **kwargs) -> None
        """
    def __init__(self, backend: str, device: typing.SupportsInt | typing.SupportsIndex = -1, library: str = '') -> None:
        ...
    def render_meshes(self, K: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], width: typing.SupportsInt | typing.SupportsIndex, height: typing.SupportsInt | typing.SupportsIndex, static_frames: collections.abc.Sequence[tuple[MeshFrame, typing.Annotated[numpy.typing.ArrayLike, numpy.float64]]], objects: collections.abc.Sequence[tuple[typing.SupportsInt | typing.SupportsIndex, collections.abc.Sequence[tuple[MeshFrame, typing.SupportsInt | typing.SupportsIndex, typing.Annotated[numpy.typing.ArrayLike, numpy.float64], typing.SupportsInt | typing.SupportsIndex]], collections.abc.Sequence[tuple[MeshFrame, typing.SupportsInt | typing.SupportsIndex, typing.Annotated[numpy.typing.ArrayLike, numpy.float64], typing.SupportsInt | typing.SupportsIndex]], collections.abc.Sequence[tuple[MeshFrame, typing.SupportsInt | typing.SupportsIndex, typing.Annotated[numpy.typing.ArrayLike, numpy.float64], typing.SupportsInt | typing.SupportsIndex]]]], visibility_sweeps: typing.SupportsInt | typing.SupportsIndex, threads: typing.SupportsInt | typing.SupportsIndex = 0) -> numpy.typing.NDArray[numpy.float32]:
        ...
    def render_splats(self, K: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], width: typing.SupportsInt | typing.SupportsIndex, height: typing.SupportsInt | typing.SupportsIndex, static_frames: collections.abc.Sequence[tuple[Frame, typing.Annotated[numpy.typing.ArrayLike, numpy.float64]]], dynamic_frames: collections.abc.Sequence[tuple[Frame, typing.Annotated[numpy.typing.ArrayLike, numpy.float64]]], static_size: tuple[typing.SupportsFloat | typing.SupportsIndex, typing.SupportsFloat | typing.SupportsIndex], dynamic_size: tuple[typing.SupportsFloat | typing.SupportsIndex, typing.SupportsFloat | typing.SupportsIndex], threads: typing.SupportsInt | typing.SupportsIndex = 0) -> numpy.typing.NDArray[numpy.float32]:
        ...
    @property
    def point_limit(self) -> int:
        ...
    @property
    def renderer(self) -> str:
        ...
    @property
    def software(self) -> bool:
        ...
    @property
    def version(self) -> str:
        ...
def add_isolated_points(points: typing.Annotated[numpy.typing.ArrayLike, numpy.float32], ground: typing.Annotated[numpy.typing.ArrayLike, numpy.bool], objects: typing.Annotated[numpy.typing.ArrayLike, numpy.uint32], static_votes: typing.Annotated[numpy.typing.ArrayLike, numpy.uint16], dynamic_votes: typing.Annotated[numpy.typing.ArrayLike, numpy.uint16], dynamic: typing.Annotated[numpy.typing.ArrayLike, numpy.bool], parameters: ObjectParameters) -> numpy.typing.NDArray[numpy.uint8]:
    ...
def add_points_inside(points: typing.Annotated[numpy.typing.ArrayLike, numpy.float32], ground: typing.Annotated[numpy.typing.ArrayLike, numpy.bool], static_votes: typing.Annotated[numpy.typing.ArrayLike, numpy.uint16], dynamic_votes: typing.Annotated[numpy.typing.ArrayLike, numpy.uint16], T_world_lidar: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], boxes: typing.Annotated[numpy.typing.ArrayLike, numpy.float32], voxels: typing.Annotated[numpy.typing.ArrayLike, numpy.uint64], dynamic: typing.Annotated[numpy.typing.ArrayLike, numpy.bool], parameters: ObjectParameters) -> numpy.typing.NDArray[numpy.uint8]:
    ...
def classify_objects(points: typing.Annotated[numpy.typing.ArrayLike, numpy.float32], ground: typing.Annotated[numpy.typing.ArrayLike, numpy.bool], objects: typing.Annotated[numpy.typing.ArrayLike, numpy.uint32], static_votes: typing.Annotated[numpy.typing.ArrayLike, numpy.uint16], dynamic_votes: typing.Annotated[numpy.typing.ArrayLike, numpy.uint16], mesh: ScanMesh, parameters: ObjectParameters) -> numpy.typing.NDArray[numpy.uint8]:
    ...
def cluster_objects(points: typing.Annotated[numpy.typing.ArrayLike, numpy.float32], ground: typing.Annotated[numpy.typing.ArrayLike, numpy.bool], mesh: ScanMesh, parameters: ObjectParameters) -> numpy.typing.NDArray[numpy.uint32]:
    ...
def egl_devices(library: str = '') -> list[bool]:
    ...
def join_meshes(meshes: collections.abc.Sequence[ScanMesh]) -> ScanMesh:
    ...
def mesh_layers(K: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], width: typing.SupportsInt | typing.SupportsIndex, height: typing.SupportsInt | typing.SupportsIndex, static_frames: collections.abc.Sequence[tuple[MeshFrame, typing.Annotated[numpy.typing.ArrayLike, numpy.float64]]], objects: collections.abc.Sequence[tuple[typing.SupportsInt | typing.SupportsIndex, collections.abc.Sequence[tuple[MeshFrame, typing.SupportsInt | typing.SupportsIndex, typing.Annotated[numpy.typing.ArrayLike, numpy.float64], typing.SupportsInt | typing.SupportsIndex]], collections.abc.Sequence[tuple[MeshFrame, typing.SupportsInt | typing.SupportsIndex, typing.Annotated[numpy.typing.ArrayLike, numpy.float64], typing.SupportsInt | typing.SupportsIndex]], collections.abc.Sequence[tuple[MeshFrame, typing.SupportsInt | typing.SupportsIndex, typing.Annotated[numpy.typing.ArrayLike, numpy.float64], typing.SupportsInt | typing.SupportsIndex]]]], visibility_sweeps: typing.SupportsInt | typing.SupportsIndex, depth: typing.Annotated[numpy.typing.ArrayLike, numpy.float32], threads: typing.SupportsInt | typing.SupportsIndex = 0) -> dict:
    ...
def nearest_neighbors(points: typing.Annotated[numpy.typing.ArrayLike, numpy.float32], queries: typing.Annotated[numpy.typing.ArrayLike, numpy.float32], threads: typing.SupportsInt | typing.SupportsIndex = 0) -> tuple:
    ...
def render_meshes(K: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], width: typing.SupportsInt | typing.SupportsIndex, height: typing.SupportsInt | typing.SupportsIndex, static_frames: collections.abc.Sequence[tuple[MeshFrame, typing.Annotated[numpy.typing.ArrayLike, numpy.float64]]], objects: collections.abc.Sequence[tuple[typing.SupportsInt | typing.SupportsIndex, collections.abc.Sequence[tuple[MeshFrame, typing.SupportsInt | typing.SupportsIndex, typing.Annotated[numpy.typing.ArrayLike, numpy.float64], typing.SupportsInt | typing.SupportsIndex]], collections.abc.Sequence[tuple[MeshFrame, typing.SupportsInt | typing.SupportsIndex, typing.Annotated[numpy.typing.ArrayLike, numpy.float64], typing.SupportsInt | typing.SupportsIndex]], collections.abc.Sequence[tuple[MeshFrame, typing.SupportsInt | typing.SupportsIndex, typing.Annotated[numpy.typing.ArrayLike, numpy.float64], typing.SupportsInt | typing.SupportsIndex]]]], visibility_sweeps: typing.SupportsInt | typing.SupportsIndex, threads: typing.SupportsInt | typing.SupportsIndex = 0) -> numpy.typing.NDArray[numpy.float32]:
    ...
def render_splats(K: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], width: typing.SupportsInt | typing.SupportsIndex, height: typing.SupportsInt | typing.SupportsIndex, static_frames: collections.abc.Sequence[tuple[Frame, typing.Annotated[numpy.typing.ArrayLike, numpy.float64]]], dynamic_frames: collections.abc.Sequence[tuple[Frame, typing.Annotated[numpy.typing.ArrayLike, numpy.float64]]], static_size: tuple[typing.SupportsFloat | typing.SupportsIndex, typing.SupportsFloat | typing.SupportsIndex], dynamic_size: tuple[typing.SupportsFloat | typing.SupportsIndex, typing.SupportsFloat | typing.SupportsIndex], threads: typing.SupportsInt | typing.SupportsIndex = 0) -> numpy.typing.NDArray[numpy.float32]:
    ...
def splat_layers(K: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], width: typing.SupportsInt | typing.SupportsIndex, height: typing.SupportsInt | typing.SupportsIndex, static_frames: collections.abc.Sequence[tuple[Frame, typing.Annotated[numpy.typing.ArrayLike, numpy.float64]]], dynamic_frames: collections.abc.Sequence[tuple[Frame, typing.Annotated[numpy.typing.ArrayLike, numpy.float64]]], static_size: tuple[typing.SupportsFloat | typing.SupportsIndex, typing.SupportsFloat | typing.SupportsIndex], dynamic_size: tuple[typing.SupportsFloat | typing.SupportsIndex, typing.SupportsFloat | typing.SupportsIndex], depth: typing.Annotated[numpy.typing.ArrayLike, numpy.float32], threads: typing.SupportsInt | typing.SupportsIndex = 0) -> dict:
    ...
def track_objects(detections: collections.abc.Sequence[Detections], times: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], parameters: TrackParameters, threads: typing.SupportsInt | typing.SupportsIndex = 0) -> list:
    ...
def vote(points: typing.Annotated[numpy.typing.ArrayLike, numpy.float32], ground: typing.Annotated[numpy.typing.ArrayLike, numpy.bool], T_world_lidar: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], key_frames: collections.abc.Sequence[KeyFrame], poses: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], threads: typing.SupportsInt | typing.SupportsIndex = 0) -> tuple:
    ...
__version__: str = '0.1.0'
