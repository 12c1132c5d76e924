"""Lenses: from points of the camera to pixels and back, and Zhang's calibration of K."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from docdepth.calibration.board import Board
from docdepth.errors import CalibrationError

Floats = NDArray[np.float64]

MODELS = ("pinhole", "fisheye")
FEWEST_IMAGES = 3
"""Images of the board from which K can be estimated."""

_MOST_ERROR = 2.0  # pixels; above, K has not converged
_ORIGIN = np.zeros(3)


@dataclass(frozen=True)
class Lens:
    """K and distortion of a camera.

    Attributes
    ----------
    model : {"pinhole", "fisheye"}
        Brown's distortion, or OpenCV's fisheye (Kannala and Brandt).
    K : ndarray of float64, shape (3, 3)
    distortion : ndarray of float64
        In OpenCV's order: k1 k2 p1 p2 [k3 ...], or k1 k2 k3 k4 of a fisheye.
    width, height : int
        Image size in pixels.
    """

    model: str
    K: Floats
    distortion: Floats
    width: int
    height: int

    def project(self, points: Floats) -> Floats:
        """Pixels (N, 2) of points (N, 3) in the camera frame; NaN for those behind it."""
        pixels = np.full((len(points), 2), np.nan)
        ahead = points[:, 2] > 1e-6
        if ahead.any():
            seen = np.ascontiguousarray(points[ahead])[:, None]
            if self.model == "fisheye":
                found = cv2.fisheye.projectPoints(seen, _ORIGIN, _ORIGIN, self.K, self.distortion)
            else:
                found = cv2.projectPoints(seen, _ORIGIN, _ORIGIN, self.K, self.distortion)
            pixels[ahead] = np.asarray(found[0]).reshape(-1, 2)
        return pixels

    def rays(self, pixels: Floats) -> Floats:
        """Places (N, 2) where the rays of pixels (N, 2) meet the plane one metre ahead."""
        undistort = cv2.fisheye.undistortPoints if self.model == "fisheye" else cv2.undistortPoints
        found = undistort(np.ascontiguousarray(pixels)[:, None], self.K, self.distortion)
        return np.asarray(found, np.float64).reshape(-1, 2)

    def moved(self, step: Floats) -> Lens:
        """The lens with other numbers: ``step`` (8,) changes fx, fy by shares, then cx, cy in focal
        lengths, then the first four of the distortion."""
        fx, fy = self.K[0, 0], self.K[1, 1]
        K, distortion = self.K.copy(), self.distortion.copy()
        K[0, 0], K[1, 1] = fx * (1 + step[0]), fy * (1 + step[1])
        K[0, 2], K[1, 2] = K[0, 2] + fx * step[2], K[1, 2] + fy * step[3]
        distortion[:4] += step[4:]
        return Lens(self.model, K, distortion, self.width, self.height)

    def in_image(self, pixels: Floats) -> NDArray[np.bool_]:
        """Which pixels (N, 2) lie in the image."""
        with np.errstate(invalid="ignore"):
            low = (pixels >= -0.5).all(axis=1)
            return np.asarray(
                low & (pixels < np.array((self.width, self.height)) - 0.5).all(axis=1)
            )


def estimate_lens(
    board: Board, corners: Sequence[Floats], size: tuple[int, int], model: str = "pinhole"
) -> tuple[Lens, float]:
    """K and distortion from images of a board (Zhang 2000).

    Parameters
    ----------
    corners : sequence of ndarray, shape (rows * columns, 2)
        Pixels of the corners in each image.
    size : (int, int)
        Width and height of the images in pixels.
    model : {"pinhole", "fisheye"}

    Returns
    -------
    lens : Lens
    error : float
        Root mean square of the corners' errors [px].
    """
    if len(corners) < FEWEST_IMAGES:
        raise CalibrationError(
            f"K needs the board in at least {FEWEST_IMAGES} images, it was found in "
            f"{len(corners)}; take more images, or say K in docdepth.yaml",
            code="few-boards",
        )
    places = [board.corners[None].astype(np.float32) for _ in corners]
    pixels = [c[None].astype(np.float32) for c in corners]
    try:
        if model == "fisheye":
            flags = cv2.CALIB_RECOMPUTE_EXTRINSIC | cv2.CALIB_FIX_SKEW
            error, K, D, *_ = cv2.fisheye.calibrate(places, pixels, size, None, None, flags=flags)
        else:
            # k3 trades against k1 and k2 where corners do not reach the edge of the image.
            flags = cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST
            error, K, D, *_ = cv2.calibrateCamera(places, pixels, size, None, None, flags=flags)
    except cv2.error as failure:
        raise CalibrationError(
            f"K of a {model} lens cannot be estimated from {len(corners)} images "
            f"({' '.join(str(failure).split())[-120:]}); take images of the board tilted in all "
            "directions and in all parts of the picture, or say K in docdepth.yaml"
        ) from None
    distortion = np.asarray(D, np.float64).ravel()
    if not np.isfinite(K).all() or error > _MOST_ERROR:
        raise CalibrationError(
            f"a {model} lens misses the corners by {error:.1f} px (at most {_MOST_ERROR}); is it "
            "the right model (`model`), and the right number of corners?",
            code="corners-misfit",
        )
    return Lens(model, np.asarray(K, np.float64), distortion, *size), float(error)
