"""Dense, metric depth ground truth for camera images from LiDAR recordings (DOC-Depth).

The public names, by stage:

- recordings: :func:`open_dataset`, :class:`Dataset`, :class:`Sweep`, :class:`LidarStream`,
  :class:`CameraStream`, :class:`Camera`, :class:`SensorRig`, :class:`Trajectory`
- odometry (paper III-B): :func:`register_drive`, :class:`Odometry`
- ground (IV-A): :func:`grow_ground`
- dynamics (IV-B, IV-C): :func:`classify_drive`, :class:`Labels`
- depth maps (V): :class:`Scene`, :func:`render_depth`, :func:`render_layers`, :class:`Renderer`
- files: :func:`run`, :class:`RunInputs`, :class:`Execution`, :func:`open_run`, :class:`Run`,
  :class:`RunImage`, :func:`read_depth`, :func:`write_depth`
- parameters and errors: :func:`parameters`, :class:`Parameters`, :class:`DocDepthError`

Everything else is internal and may change without notice.
"""

import logging

from docdepth._core import __version__
from docdepth.config import Parameters, parameters
from docdepth.datasets import CameraStream, Dataset, LidarStream, Sweep, open_dataset
from docdepth.dynamics.classes import Labels
from docdepth.dynamics.classifier import classify_drive
from docdepth.errors import DocDepthError
from docdepth.geometry.camera import Camera
from docdepth.geometry.lidar_frame import SensorRig
from docdepth.geometry.trajectory import Trajectory
from docdepth.ground.growing import grow_ground
from docdepth.io.depth import read_depth, write_depth
from docdepth.io.inputs import RunInputs
from docdepth.odometry.odometry import Odometry, register_drive
from docdepth.pipeline.execution import Execution
from docdepth.pipeline.run import run
from docdepth.pipeline.run_reader import Run, RunImage, open_run
from docdepth.render.backends import Renderer
from docdepth.render.scene import Scene, render_depth, render_layers

logging.getLogger(__name__).addHandler(logging.NullHandler())

__all__ = [
    "Camera",
    "CameraStream",
    "Dataset",
    "DocDepthError",
    "Execution",
    "Labels",
    "LidarStream",
    "Odometry",
    "Parameters",
    "Renderer",
    "Run",
    "RunImage",
    "RunInputs",
    "Scene",
    "SensorRig",
    "Sweep",
    "Trajectory",
    "__version__",
    "classify_drive",
    "grow_ground",
    "open_dataset",
    "open_run",
    "parameters",
    "read_depth",
    "register_drive",
    "render_depth",
    "render_layers",
    "run",
    "write_depth",
]
