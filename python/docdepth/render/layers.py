"""Layers beside a depth map: further knowledge of each pixel.

``class``
    uint8: 0 ground, 50 static, 100 dynamic; 255 where there is no depth
``instance``
    uint16: id of the track of the moving object; 0 where there is none. Triangles only
``time``
    float32: seconds from the image to the sweep that the depth comes from; negative before it
``range``
    float32: metres from the LiDAR to the measured point
``support``
    uint16: number of measurements that agree with the depth within 2 %. Of triangles, each sweep
    measures a pixel once; of splats, each splat that covers the pixel counts
``std``
    float32: standard deviation of the agreeing depths in metres; NaN of a single one
``normal``
    float32, x y z: surface normal in the camera frame, towards the camera, of a plane fitted to the
    depth map around the pixel as far as it is flat; where nothing is, of the nearest facet.
    Triangles only
``confidence``
    float32, 0..1: probability that the depth is less than 5 % off, see :func:`confidence`
``normal_confidence``
    float32, 0..1: probability that the normal is less than 11.25 degrees off, see
    :func:`normal_confidence`. Triangles only
``seen``
    uint8: what rays within 0.1 s of the image say of the depth: 0 did not look there, 1 agree,
    2 contradict; 255 where there is no depth. Triangles only

Where there is no depth, floats are NaN and counts 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, get_args

import cv2
import numpy as np
from numpy.typing import NDArray

import docdepth._core as _core
from docdepth.config import Layer, RenderParameters
from docdepth.errors import InputError
from docdepth.render.depth_map import RenderList

LAYERS: tuple[str, ...] = get_args(Layer)

NOT_LOOKED_AT, AGREED, CONTRADICTED = 0, 1, 2
"""Values of the layer ``seen``."""

TRIANGLES_ONLY = {
    "normal": "splats face the camera and have no normal",
    "normal_confidence": "splats face the camera and have no normal",
    "instance": "splats are not followed along tracks and have no instance",
    "seen": "splats are no rays and tell nothing of what was seen",
}
"""Layers that splats do not have, and why."""

_CONFIDENCE = {"triangles": (4.94, 0.51, 1.83, 1.65, 3.22), "splats": (3.9, 1.0, 2.7, 0.0, 0.0)}
"""Weights a to e of :func:`confidence` [-], fitted to the exact depth of synthetic drives; those of
triangles by five LiDARs whose beams have their width."""

_NORMAL_CONFIDENCE, _LEAST_LEAN = (-3.99, 1.64, 0.13), 1e-4
"""Weights a and b of :func:`normal_confidence`, and that of a facet [-], fitted to four LiDARs; and
how much a plane may lean at least [rad]."""


def compose_layers(
    names: Sequence[str], depth: NDArray[np.float32], drawn: RenderList, threads: int
) -> dict[str, NDArray[Any]]:
    """Gather layers of a depth map of :func:`~docdepth.render.depth_map.compose_depth`.

    Every sweep is drawn once more, alone, and its depth compared with the map. This is always done
    on the CPU, whichever renderer drew the map; the map does not depend on it.

    Parameters
    ----------
    names : sequence of str
        Of :data:`LAYERS`; also ``measures``, uint16: the number of all measurements, whether they
        agree or not.
    depth : ndarray of float32, shape (h, w)
        Metres, NaN = none.
    drawn : RenderList
        Of which the map was drawn.

    Returns
    -------
    dict of str to ndarray, shape (h, w) or (h, w, 3)
        By name, in the order of ``names``.
    """
    p, camera = drawn.parameters, drawn.view.camera
    check_layers(names, p)
    if depth.shape != (camera.height, camera.width) or depth.dtype != np.float32:
        raise InputError(
            f"depth must be float32 of shape ({camera.height}, {camera.width}) as the camera's "
            f"image, got {depth.dtype} {depth.shape}"
        )
    depth = np.ascontiguousarray(depth)
    image = camera.K, camera.width, camera.height
    found: dict[str, NDArray[Any]]
    if p.primitive == "splats":
        found = _core.splat_layers(
            *image, drawn.static, drawn.dynamic, p.static_size, p.dynamic_size, depth, threads
        )
    else:
        seen = "seen" in names or "confidence" in names
        found = _core.mesh_layers(
            *image, drawn.static, drawn.objects, drawn.visibility,
            depth, threads, drawn.around, seen,
        )  # fmt: skip
    if "normal" in names or "normal_confidence" in names:
        found["normal"], lean = _core.fit_normals(*image, depth, found["normal"], threads)
        found["normal_confidence"] = normal_confidence(depth, lean)
    part = found["sweep"]
    found["time"] = np.where(part < 0, np.nan, drawn.delays[part]).astype(np.float32)
    if "confidence" in names:
        found["confidence"] = confidence(
            depth, found["support"], found["measures"], found.get("seen")
        )
    return {name: found[name] for name in names}


def check_layers(names: Sequence[str], parameters: RenderParameters) -> None:
    """Refuse unknown layers, and layers that the primitive does not have."""
    unknown = [name for name in names if name not in (*LAYERS, "measures")]
    if unknown:
        raise InputError(f"unknown layer {unknown[0]!r}; there are {', '.join(LAYERS)}")
    for name, reason in TRIANGLES_ONLY.items():
        if parameters.primitive == "splats" and name in names:
            raise InputError(
                f"{reason}; leave the layer {name} out, or draw triangles "
                "(render.primitive=triangles)"
            )


def confidence(
    depth: NDArray[np.float32],
    support: NDArray[np.uint16],
    measures: NDArray[np.uint16],
    seen: NDArray[np.uint8] | None = None,
) -> NDArray[np.float32]:
    """Probability that the depth of each pixel is less than 5 % off.

    A logistic regression on three features::

        confidence = 1 / (1 + exp(-(a + b * log_odds - c * edge - d * unseen - e * contradicted)))

    ``log_odds = ln((support + 1/4) / (measures - support + 1))`` grows with the measurements that
    agree with the depth and falls with those that do not. The constants 1/4 and 1 are the prior of
    a pixel without measurements. For triangles ``support`` is one less, as the measurement that the
    depth comes from confirms nothing, and ``log_odds`` is at least ``ln(1/4)``: disagreement alone
    is no worse than no measurement.

    ``edge`` is 0 where the map is smooth and 1 at a depth edge. It is the largest relative second
    difference of inverse depth within 3 pixels, on a logarithmic scale from 0.1 % to 100 %; planes
    have none, since their inverse depth is linear in the image.

    ``unseen`` is 1 where no ray around the image's time tells, ``contradicted`` where rays say
    otherwise; both are 0 elsewhere.

    Parameters
    ----------
    depth : ndarray of float32, shape (h, w)
        Metres, NaN = none.
    support, measures : ndarray of uint16, shape (h, w)
        Number of measurements that agree with the depth, and of all.
    seen : ndarray of uint8, shape (h, w), optional
        The layer, of a map drawn from triangles; absent for splats.

    Returns
    -------
    ndarray of float32, shape (h, w)
        NaN where there is no depth.
    """
    a, b, c, d, e = _CONFIDENCE["splats" if seen is None else "triangles"]
    disagreeing = measures.astype(np.float32) - support
    others = support.astype(np.float32)
    if seen is not None:
        others = np.maximum(others - 1, 0)
    log_odds = np.log((others + 0.25) / (disagreeing + 1))
    doubt = np.zeros(depth.shape, np.float32)
    if seen is not None:
        log_odds = np.maximum(log_odds, np.float32(np.log(0.25)))
        doubt[seen == NOT_LOOKED_AT] = d
        doubt[seen == CONTRADICTED] = e
    largest = cv2.dilate(_relative_curvature(depth), np.ones((7, 7), np.uint8))
    edge = np.log10(np.clip(largest, 1e-3, 1)) / 3 + 1
    probability = 1 / (1 + np.exp(-(a + b * log_odds - c * edge - doubt)))
    return np.where(np.isnan(depth), np.nan, probability).astype(np.float32)


def normal_confidence(depth: NDArray[np.float32], lean: NDArray[np.float32]) -> NDArray[np.float32]:
    """Probability that the normal of each pixel is less than 11.25 degrees off.

    A logistic regression, fitted to the exact surfaces of synthetic drives::

        confidence = 1 / (1 + exp(-(a - b ln(lean))))

    where a plane is fitted; a constant where nothing is flat and the normal is that of a facet.

    Parameters
    ----------
    depth : ndarray of float32, shape (h, w)
        Metres, NaN = none.
    lean : ndarray of float32, shape (h, w)
        How far the surface leaves its plane, over half the width of the plane [rad]; infinite where
        nothing is flat.

    Returns
    -------
    ndarray of float32, shape (h, w)
        NaN where there is no depth.
    """
    a, b, facet = _NORMAL_CONFIDENCE
    log_odds = a - b * np.log(np.maximum(lean, _LEAST_LEAN))
    probability = np.where(np.isinf(lean), facet, 1 / (1 + np.exp(-log_odds)))
    return np.where(np.isnan(depth), np.nan, probability).astype(np.float32)


def _relative_curvature(depth: NDArray[np.float32]) -> NDArray[np.float32]:
    """Second difference of inverse depth over inverse depth; 1 where it is unknown."""
    inverse_depth = np.pad(1 / depth, 1, constant_values=np.nan)
    centre = inverse_depth[1:-1, 1:-1]
    horizontal = np.abs(inverse_depth[1:-1, :-2] + inverse_depth[1:-1, 2:] - 2 * centre)
    vertical = np.abs(inverse_depth[:-2, 1:-1] + inverse_depth[2:, 1:-1] - 2 * centre)
    curvature = np.fmax(horizontal, vertical) / centre  # fmax ignores a NaN
    return np.nan_to_num(curvature, nan=1.0).astype(np.float32)
