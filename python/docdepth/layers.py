"""What is known of each pixel of a depth map beside its depth.

``class``
    uint8: 0 ground, 50 static, 100 dynamic, 255 where there is no depth
``time``
    float32, seconds from the image to the sweep that the depth comes from; negative before it
``range``
    float32, metres from the LiDAR when it was measured
``support``
    uint16: how many measurements agree with the depth within 2 %. Drawn as surfaces, each sweep
    measures a pixel once; drawn as splats, each splat that covers it does
``std``
    float32, metres: standard deviation of the depths that agree; NaN of a single one
``normal``
    float32, x y z: of the surface in the camera's frame, towards the camera. Splats have none

Where there is no depth, floats are NaN and counts 0.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from docdepth import _core
from docdepth.config import Layer, RenderParameters
from docdepth.errors import InputError
from docdepth.render import Camera, Frame, arguments, drawn_sweeps
from docdepth.trajectory import Trajectory

LAYERS: tuple[str, ...] = get_args(Layer)


def layers(
    names: Sequence[str],
    depth: NDArray[np.float32],
    camera: Camera,
    T_camera_lidar: NDArray[np.float64],
    trajectory: Trajectory,
    time: int,
    frames: Callable[[int], Frame],
    parameters: RenderParameters | None = None,
    threads: int = 0,
) -> dict[str, NDArray[Any]]:
    """Layers of a depth map that :func:`~docdepth.render.render` drew.

    They are gathered by the processor, whichever renderer drew the map: every sweep is drawn once
    more, alone, and held against the depth that is there. The map itself never depends on it.

    Parameters
    ----------
    names : sequence of str
        Of :data:`LAYERS`.
    depth : ndarray of float32, shape (h, w)
        Metres, NaN = none.
    camera, T_camera_lidar, trajectory, time, frames, parameters, threads
        As they were given to :func:`~docdepth.render.render`.

    Returns
    -------
    dict of str to ndarray, shape (h, w) or (h, w, 3)
        By name, in the order of ``names``.

    Raises
    ------
    InputError
        A name is unknown, the depth map is of another size, or normals of splats are asked for.
    """
    p = parameters or RenderParameters()
    check_layers(names, p)
    if depth.shape != (camera.height, camera.width) or depth.dtype != np.float32:
        raise InputError(
            f"depth must be float32 of shape ({camera.height}, {camera.width}) as the camera's "
            f"image, got {depth.dtype} {depth.shape}"
        )
    gather = _core.splat_layers if p.surface == "splats" else _core.surface_layers
    found: dict[str, NDArray[Any]] = gather(
        **arguments(camera, T_camera_lidar, trajectory, time, frames, p),
        depth=np.ascontiguousarray(depth),
        threads=threads,
    )
    world, moving = drawn_sweeps(trajectory, time, p)
    delays = (trajectory.times[[*world, *moving]] - np.int64(time)).astype(np.float64) * 1e-9
    sweep = found["sweep"]
    found["time"] = np.where(sweep < 0, np.nan, delays[sweep]).astype(np.float32)
    return {name: found[name] for name in names}


def check_layers(names: Sequence[str], parameters: RenderParameters) -> None:
    """Refuse layers that there are not.

    Raises
    ------
    InputError
    """
    unknown = [name for name in names if name not in LAYERS]
    if unknown:
        raise InputError(f"unknown layer {unknown[0]!r}; there are {', '.join(LAYERS)}")
    if parameters.surface == "splats" and "normal" in names:
        raise InputError(
            "splats face the camera and have no normal; leave the layer out, or draw sweeps as "
            "surfaces (--set render.surface=triangles)"
        )
