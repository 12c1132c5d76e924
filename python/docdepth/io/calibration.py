"""Calibration of a camera on disk, in the layout of the official DOC-Depth release."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
import yaml
from numpy.typing import NDArray

from docdepth.errors import CalibrationError
from docdepth.geometry.camera import Camera, checked_place
from docdepth.io.atomic import WriteFile, write_atomically
from docdepth.io.untrusted import parse_json, read_text

INTRINSICS = "calib.json"
"""File of K (``mtx``), distortion (``dist``) and image size in pixels (``size``)."""

EXTRINSICS = "calib_lidar_ref_cam.txt"
"""File of ``T_camera_lidar``, four lines of four numbers."""

ROS, KALIBR = "camera_info.yaml", "camchain.yaml"
"""The same camera as ROS's camera_calibration_parsers and Kalibr read it."""


_Parsed = TypeVar("_Parsed")


@dataclass(frozen=True)
class CameraCalibration:
    """What a file tells of a camera."""

    T_camera_lidar: NDArray[np.float64]  # (4, 4)
    name: str = ""  # of the camera; empty if the file does not tell
    camera: Camera | None = None  # None in a file with the extrinsic alone
    distortion: Sequence[float] = ()
    model: Literal["pinhole", "fisheye"] = "pinhole"


def write_calibration(
    folder: Path,
    camera: Camera,
    T_camera_lidar: NDArray[np.float64],
    distortion: Sequence[float] = (0.0,) * 5,
    model: str = "pinhole",
    write_file: WriteFile = write_atomically,
    more: dict[str, object] | None = None,
    name: str = "",
) -> None:
    """Write both files, and those of ROS and Kalibr if the camera has a name.

    Parameters
    ----------
    distortion : sequence of float
        Of the images before they are rectified, in OpenCV's order.
    model : str
        Of the distortion; "fisheye" is that of ``cv2.fisheye``.
    more : dict, optional
        Further entries of the first file, ready for JSON.
    name : str
        Of the camera.
    """
    calibration: dict[str, object] = {
        "mtx": camera.K.tolist(),
        "dist": list(distortion),
        "size": [camera.width, camera.height],
    }
    if model != "pinhole":
        calibration["model"] = model
    if name:
        calibration |= {"camera": name, "T_camera_lidar": T_camera_lidar.tolist()}
        numbers = [float(value) for value in distortion]
        for file, content in (
            (ROS, _as_ros(name, camera, numbers, model)),
            (KALIBR, _as_kalibr(name, camera, T_camera_lidar, numbers, model)),
        ):
            if content:
                text = yaml.safe_dump(content, default_flow_style=None, sort_keys=False).encode()
                write_file(folder / file, text)
    intrinsics = json.dumps(calibration | (more or {}), indent=1).encode()
    rows = "\n".join(" ".join(repr(float(v)) for v in row) for row in T_camera_lidar) + "\n"
    write_file(folder / INTRINSICS, intrinsics)
    write_file(folder / EXTRINSICS, rows.encode())


def _as_ros(name: str, camera: Camera, numbers: list[float], model: str) -> dict[str, object]:
    """What ``sensor_msgs/CameraInfo`` holds."""
    many = "rational_polynomial" if len(numbers) > 5 else "plumb_bob"

    def matrix(values: NDArray[np.float64]) -> dict[str, object]:
        rows, cols = values.shape
        return {"rows": rows, "cols": cols, "data": values.ravel().tolist()}

    return {
        "image_width": camera.width,
        "image_height": camera.height,
        "camera_name": name,
        "camera_matrix": matrix(camera.K),
        "distortion_model": "equidistant" if model == "fisheye" else many,
        "distortion_coefficients": matrix(np.array([numbers])),
        "rectification_matrix": matrix(np.eye(3)),
        "projection_matrix": matrix(np.column_stack([camera.K, np.zeros(3)])),
    }


def _as_kalibr(
    name: str, camera: Camera, T: NDArray[np.float64], numbers: list[float], model: str
) -> dict[str, object] | None:
    """A chain of one camera; None with the distortion that Kalibr has no model for."""
    if any(numbers[4:]):
        return None
    K = camera.K
    return {
        "cam0": {
            "camera_model": "pinhole",
            "intrinsics": [float(K[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2))],
            "distortion_model": "equidistant" if model == "fisheye" else "radtan",
            "distortion_coeffs": (numbers + [0.0] * 4)[:4],
            "resolution": [camera.width, camera.height],
            "rostopic": f"/{name}",
            "T_cam_lidar": T.tolist(),
        }
    }


def read_calibration(folder: Path, remedy: str) -> tuple[Camera, NDArray[np.float64], list[float]]:
    """Camera, ``T_camera_lidar`` (4, 4) and distortion; ``remedy`` is for files that are missing.

    Without an image size, as in the official release, the principal point is taken for the centre
    of the image.
    """
    camera, distortion, _ = _read(folder / INTRINSICS, _camera, remedy)
    return camera, _read(folder / EXTRINSICS, _extrinsic, remedy), distortion


def read_camera_calibration(file: Path) -> CameraCalibration:
    """The calibration of one camera, for a recording that has none or another.

    Parameters
    ----------
    file : Path
        ``calib.json``, whose extrinsic may stand in ``calib_lidar_ref_cam.txt`` beside it; or a
        text file with the extrinsic alone.
    """
    remedy = "name calib.json of `docdepth.calibration.calibrate()`, or a text file of a 4x4 matrix"
    if file.suffix.lower() != ".json":
        return CameraCalibration(_read(file, _extrinsic, remedy))
    camera, distortion, entries = _read(file, _camera, remedy)
    model = entries.get("model", "pinhole")
    if model not in ("pinhole", "fisheye"):
        raise CalibrationError(f"{file}: model is {model!r}, not pinhole or fisheye")
    if "T_camera_lidar" in entries:
        T = checked_place(str(file), entries["T_camera_lidar"], remedy)
    else:
        T = _read(file.parent / EXTRINSICS, _extrinsic, remedy)
    return CameraCalibration(T, str(entries.get("camera", "")), camera, distortion, model)


def _camera(text: str) -> tuple[Camera, list[float], dict[str, Any]]:
    """Camera, distortion, and all entries."""
    entries = parse_json(text)
    K = np.array(entries["mtx"], dtype=np.float64)
    if K.shape != (3, 3):
        raise ValueError(f"mtx has shape {K.shape}, not (3, 3)")
    width, height = entries.get("size") or np.round(2 * K[:2, 2]).astype(int).tolist()
    distortion = np.ravel(entries.get("dist") or []).astype(float).tolist()
    if "T_camera_lidar" in entries:
        entries["T_camera_lidar"] = np.array(entries["T_camera_lidar"], np.float64)
    return Camera(K, int(width), int(height)), distortion, entries


def _extrinsic(text: str) -> NDArray[np.float64]:
    return np.loadtxt(text.splitlines(), ndmin=2)


def _read(file: Path, parse: Callable[[str], _Parsed], remedy: str) -> _Parsed:
    """What a file holds, in the form that ``parse`` gives it."""
    try:
        found = parse(read_text(file))
    except FileNotFoundError:
        raise CalibrationError(f"{file} is missing; {remedy}") from None
    except OSError as error:
        raise CalibrationError(f"{file} cannot be read ({error.strerror}); {remedy}") from None
    except CalibrationError as error:  # of the camera
        raise CalibrationError(f"{file}: {error}") from None
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise CalibrationError(f"{file} is damaged: {error}") from None
    if isinstance(found, np.ndarray):
        checked_place(str(file), found, remedy)
    return found
