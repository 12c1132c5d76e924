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
``confidence``
    float32, 0..1: how likely the depth is less than 5 % off, see :func:`confidence`

Where there is no depth, floats are NaN and counts 0.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from docdepth import _core
from docdepth.config import Layer, RenderParameters
from docdepth.errors import InputError
from docdepth.geometry.camera import Camera
from docdepth.geometry.trajectory import Trajectory
from docdepth.render.depth_map import arguments
from docdepth.render.frame import Frame
from docdepth.render.selection import drawn_sweeps

# Of confidence(): a, b, c.
_CONFIDENCE = {"triangles": (4.47, 0.67, 2.79), "splats": (3.9, 1.0, 2.7)}

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
    """Layers of a depth map that :func:`~docdepth.render.depth_map.render` drew.

    They are gathered by the processor, whichever renderer drew the map: every sweep is drawn once
    more, alone, and held against the depth that is there. The map itself never depends on it.

    Parameters
    ----------
    names : sequence of str
        Of :data:`LAYERS`; and ``measures``, uint16, how many measurements there are, whether they
        agree or not.
    depth : ndarray of float32, shape (h, w)
        Metres, NaN = none.
    camera, T_camera_lidar, trajectory, time, frames, parameters, threads
        As they were given to :func:`~docdepth.render.depth_map.render`.

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
    gather = _core.splat_layers if p.surface == "splats" else _core.mesh_layers
    found: dict[str, NDArray[Any]] = gather(
        **arguments(camera, T_camera_lidar, trajectory, time, frames, p),
        depth=np.ascontiguousarray(depth),
        threads=threads,
    )
    world, moving = drawn_sweeps(trajectory, time, p)
    world = [i for i in world for _ in frames(i).parts]
    delays = (trajectory.times[[*world, *moving]] - np.int64(time)).astype(np.float64) * 1e-9
    sweep = found["sweep"]
    if "confidence" in names:
        found["confidence"] = confidence(depth, found["support"], found["measures"], p.surface)
    found["time"] = np.where(sweep < 0, np.nan, delays[sweep]).astype(np.float32)
    return {name: found[name] for name in names}


def confidence(
    depth: NDArray[np.float32],
    support: NDArray[np.uint16],
    measures: NDArray[np.uint16],
    surface: str = "triangles",
) -> NDArray[np.float32]:
    """How likely the depth of each pixel is less than 5 % off.

    The logistic function of ``a + b ln((s + 1/4) / (m - s + 1)) - c e``: of m measurements of the
    pixel s agree with its depth, and a pixel that nobody measured counts as a quarter of one
    against one. Of triangles the logarithm is that of such a pixel at the least: sweeps that all
    measured another depth make it no worse than none did. e is 0 where the map is smooth within 3
    pixels and 1 at a depth edge, the logarithm of the largest second difference of nearness over
    nearness, from 0.1 to 100 %. a, b and c were fitted to exact depth of synthetic drives, see
    ``benchmarks/confidence.py``.

    Parameters
    ----------
    depth : ndarray of float32, shape (h, w)
        Metres, NaN = none.
    support, measures : ndarray of uint16, shape (h, w)
        Measurements that agree with the depth, and all.
    surface : {"triangles", "splats"}
        What was drawn.

    Returns
    -------
    ndarray of float32, shape (h, w)
        NaN where there is no depth.
    """
    a, b, c = _CONFIDENCE[surface]
    odds, edge = features(depth, support, measures, surface)
    chance = 1 / (1 + np.exp(-(a + b * odds - c * edge)))
    return np.where(np.isnan(depth), np.nan, chance).astype(np.float32)


def features(
    depth: NDArray[np.float32],
    support: NDArray[np.uint16],
    measures: NDArray[np.uint16],
    surface: str = "triangles",
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """The two terms of :func:`confidence`: logarithm of the odds, and edge, 0..1."""
    against = measures.astype(np.float32) - support
    odds = np.log((support.astype(np.float32) + 0.25) / (against + 1))
    if surface == "triangles":
        odds = np.maximum(odds, np.float32(np.log(0.25)))
    bend = cv2.dilate(_bends(depth), np.ones((7, 7), np.uint8))
    return odds, np.log10(np.clip(bend, 1e-3, 1)) / 3 + 1


def _bends(depth: NDArray[np.float32]) -> NDArray[np.float32]:
    """Second difference of nearness, linear on planes, over nearness; 1 where it is unknown."""
    near = np.pad(1 / depth, 1, constant_values=np.nan)
    here = near[1:-1, 1:-1]
    across = np.abs(near[1:-1, :-2] + near[1:-1, 2:] - 2 * here)
    along = np.abs(near[:-2, 1:-1] + near[2:, 1:-1] - 2 * here)
    bend = np.fmax(across, along) / here  # of the two that which is known
    return np.nan_to_num(bend, nan=1.0).astype(np.float32)


def check_layers(names: Sequence[str], parameters: RenderParameters) -> None:
    """Refuse layers that there are not.

    Raises
    ------
    InputError
    """
    unknown = [name for name in names if name not in (*LAYERS, "measures")]
    if unknown:
        raise InputError(f"unknown layer {unknown[0]!r}; there are {', '.join(LAYERS)}")
    if parameters.surface == "splats" and "normal" in names:
        raise InputError(
            "splats face the camera and have no normal; leave the layer out, or draw sweeps as "
            "surfaces (--set render.surface=triangles)"
        )
