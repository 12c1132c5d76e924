"""Images and cameras of ROS messages."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.base import LensModel
from docdepth.errors import CalibrationError, DatasetError
from docdepth.geometry.camera import Camera
from docdepth.io.images import decode_image as decode_content

IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"

# Channels of 8 bits, and how OpenCV names the way to BGR; None: it is.
_ENCODINGS: dict[str, tuple[int, int | None]] = {
    "bgr8": (3, None),
    "8UC3": (3, None),
    "rgb8": (3, cv2.COLOR_RGB2BGR),
    "bgra8": (4, cv2.COLOR_BGRA2BGR),
    "8UC4": (4, cv2.COLOR_BGRA2BGR),
    "rgba8": (4, cv2.COLOR_RGBA2BGR),
    "mono8": (1, cv2.COLOR_GRAY2BGR),
    "8UC1": (1, cv2.COLOR_GRAY2BGR),
    "bayer_rggb8": (1, cv2.COLOR_BayerBG2BGR),
    "bayer_bggr8": (1, cv2.COLOR_BayerRG2BGR),
    "bayer_gbrg8": (1, cv2.COLOR_BayerGR2BGR),
    "bayer_grbg8": (1, cv2.COLOR_BayerGB2BGR),
    "yuv422": (2, cv2.COLOR_YUV2BGR_UYVY),
    "uyvy": (2, cv2.COLOR_YUV2BGR_UYVY),
    "yuv422_yuy2": (2, cv2.COLOR_YUV2BGR_YUY2),
    "yuyv": (2, cv2.COLOR_YUV2BGR_YUY2),
}
_MODELS: dict[str, LensModel] = {
    "": "pinhole",
    "plumb_bob": "pinhole",
    "rational_polynomial": "pinhole",
    "thin_prism": "pinhole",
    "equidistant": "fisheye",
    "fisheye": "fisheye",
}


def is_photo(message: Any) -> bool:
    """Whether a message holds an image for people, not depth, labels or the like."""
    if message.__msgtype__ == IMAGES[1]:
        return "compressedDepth" not in message.format
    return message.encoding in _ENCODINGS


def decode_image(message: Any, where: str) -> NDArray[np.uint8]:
    """The image of a message as BGR.

    Raises
    ------
    DatasetError
        It is truncated, or of an encoding that docdepth does not know.
    """
    if message.__msgtype__ == IMAGES[1]:
        data = np.asarray(message.data, np.uint8)
        image = decode_content(data, cv2.IMREAD_COLOR)
        if image is None:
            raise DatasetError(f"{where} is not a readable image ({message.format})")
        return np.asarray(image, np.uint8)
    if message.encoding not in _ENCODINGS:
        raise DatasetError(
            f"{where} has the encoding {message.encoding!r}; docdepth reads {', '.join(_ENCODINGS)}"
        )
    channels, conversion = _ENCODINGS[message.encoding]
    width, height, step = message.width, message.height, message.step
    if not width or not height:
        raise DatasetError(f"{where} is an image of {width} x {height} pixels")
    data = np.asarray(message.data, np.uint8)
    if step < width * channels or len(data) < height * step:
        raise DatasetError(f"{where} has {len(data)} bytes for {width} x {height} pixels")
    lines = data[: height * step].reshape(height, step)[:, : width * channels]
    image = np.ascontiguousarray(lines).reshape(height, width, channels)
    return image if conversion is None else np.asarray(cv2.cvtColor(image, conversion), np.uint8)


def camera_of(
    info: Any, rectified: bool, where: str
) -> tuple[Camera, NDArray[np.float64] | None, LensModel]:
    """Camera, distortion and model of a CameraInfo.

    Parameters
    ----------
    info : sensor_msgs/CameraInfo
    rectified : bool
        The images are rectified: P holds their intrinsics.
    where : str

    Raises
    ------
    CalibrationError
        The camera is not calibrated, or its model is unknown.
    """
    K = np.asarray(info.K if hasattr(info, "K") else info.k, np.float64).reshape(3, 3)
    P = np.asarray(info.P if hasattr(info, "P") else info.p, np.float64).reshape(3, 4)
    D = np.asarray(info.D if hasattr(info, "D") else info.d, np.float64)
    if not K.any():
        raise CalibrationError(f"{where}: K is 0, so the camera was not calibrated")
    if rectified:
        return Camera(P[:, :3] if P.any() else K, info.width, info.height), None, "pinhole"
    name = info.distortion_model
    if name not in _MODELS:
        raise CalibrationError(
            f"{where}: distortion model {name!r} is unknown; there are {', '.join(_MODELS)}"
        )
    camera, model = Camera(K, info.width, info.height), _MODELS[name]
    if not D.any():
        return camera, np.zeros(4) if model == "fisheye" else None, model
    return camera, D, model
