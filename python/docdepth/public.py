"""The names of :mod:`docdepth`, which imports them from here when the first is asked for."""

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
