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
    from docdepth.public import *  # noqa: F403

logging.getLogger(__name__).addHandler(logging.NullHandler())


def __getattr__(name: str) -> Any:
    """Import all public names when the first is asked for.

    That takes a second, in which the command line could not be stopped.
    """
    public = import_module("docdepth.public")
    globals().update({each: getattr(public, each) for each in [*public.__all__, "__all__"]})
    if name not in globals():
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return globals()[name]


def __dir__() -> list[str]:
    return sorted({*globals(), *__getattr__("__all__")})
