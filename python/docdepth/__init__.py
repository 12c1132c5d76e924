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
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
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

_HOMES = {
    "__version__": "docdepth._core",
    "Parameters": "docdepth.config",
    "parameters": "docdepth.config",
    "CameraStream": "docdepth.datasets",
    "Dataset": "docdepth.datasets",
    "LidarStream": "docdepth.datasets",
    "Sweep": "docdepth.datasets",
    "open_dataset": "docdepth.datasets",
    "Labels": "docdepth.dynamics.classes",
    "classify_drive": "docdepth.dynamics.classifier",
    "DocDepthError": "docdepth.errors",
    "Camera": "docdepth.geometry.camera",
    "SensorRig": "docdepth.geometry.lidar_frame",
    "Trajectory": "docdepth.geometry.trajectory",
    "grow_ground": "docdepth.ground.growing",
    "read_depth": "docdepth.io.depth",
    "write_depth": "docdepth.io.depth",
    "RunInputs": "docdepth.io.inputs",
    "Odometry": "docdepth.odometry.odometry",
    "register_drive": "docdepth.odometry.odometry",
    "Execution": "docdepth.pipeline.execution",
    "run": "docdepth.pipeline.run",
    "Run": "docdepth.pipeline.run_reader",
    "RunImage": "docdepth.pipeline.run_reader",
    "open_run": "docdepth.pipeline.run_reader",
    "Renderer": "docdepth.render.backends",
    "Scene": "docdepth.render.scene",
    "render_depth": "docdepth.render.scene",
    "render_layers": "docdepth.render.scene",
}


def __getattr__(name: str) -> Any:
    """Import a public name, or a module, when it is first asked for.

    All of them take a second, in which the command line could not be stopped.
    """
    if name in _HOMES:
        globals()[name] = getattr(import_module(_HOMES[name]), name)
        return globals()[name]
    try:
        return import_module(f"{__name__}.{name}")
    except ModuleNotFoundError as error:
        if error.name != f"{__name__}.{name}":
            raise
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}") from None


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
