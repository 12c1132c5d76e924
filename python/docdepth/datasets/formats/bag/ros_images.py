"""Images and cameras of ROS messages."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.base import LensModel
from docdepth.errors import CalibrationError, DatasetError
from docdepth.geometry.camera import Camera
from docdepth.geometry.camera import camera_of as named_camera
from docdepth.geometry.se3 import are_rotations
from docdepth.io.images import decode_photo, upper_bits

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
_VIDEO = ("h264", "h265", "hevc", "h.264", "h.265", "av1", "vp8", "vp9")
_OTHER_IMAGES = (
    "FFMPEGPacket",
    "CompressedVideo",
    "theora_image_transport/msg/Packet",
    "foxglove_msgs/msg/CompressedImage",
    "foxglove_msgs/msg/RawImage",
)
"""Ends of the types of messages that hold images in a form that docdepth does not read."""
_MODELS: dict[str, LensModel] = {
    "": "pinhole",
    "plumb_bob": "pinhole",
    "rational_polynomial": "pinhole",
    "thin_prism": "pinhole",
    "equidistant": "fisheye",
    "fisheye": "fisheye",
}
_OFF_CENTRE = 0.05  # of width and height; both that far off the middle, a principal point is wrong


def is_photo(message: Any) -> bool:
    """Whether a message holds an image for people, not depth, labels or the like."""
    if message.__msgtype__ == IMAGES[1]:
        return "compressedDepth" not in message.format and not is_video(message)
    return _of_eight_bits(message.encoding) in _ENCODINGS


def is_video(message: Any) -> bool:
    """Whether a message holds a piece of a video, most of which need the pieces before."""
    is_compressed = message.__msgtype__ == IMAGES[1]
    return is_compressed and any(codec in message.format.lower() for codec in _VIDEO)


def unread_images(kind: str) -> bool:
    """Whether messages of a type hold images, but none that docdepth reads."""
    return kind.endswith(_OTHER_IMAGES)


def measures(message: Any) -> bool:
    """Whether a message holds an image of numbers: depth, disparity, labels."""
    return message.__msgtype__ == IMAGES[1] or message.encoding[:2] in ("16", "32", "64")


def _of_eight_bits(encoding: str) -> str:
    """What the encoding of photos of 16 bits is called with 8 bits; others stay as they are."""
    eight = encoding.removesuffix("16") + "8"
    return eight if encoding.endswith("16") and eight in _ENCODINGS else encoding


def decode_image(message: Any, where: str) -> NDArray[np.uint8]:
    """The image of a message as BGR."""
    if message.__msgtype__ == IMAGES[1]:
        image = decode_photo(np.asarray(message.data, np.uint8))
        if image is None:
            raise DatasetError(
                f"{where} is not a readable image ({message.format}); record JPEG, PNG or raw "
                "images, not a video"
            )
        return image
    name = _of_eight_bits(message.encoding)
    if name not in _ENCODINGS:
        raise DatasetError(
            f"{where} has the encoding {message.encoding!r}; docdepth reads {', '.join(_ENCODINGS)}"
        )
    channels, conversion = _ENCODINGS[name]
    line = channels if name == message.encoding else 2 * channels
    width, height, step = message.width, message.height, message.step
    if not width or not height:
        raise DatasetError(f"{where} is an image of {width} x {height} pixels")
    data = np.asarray(message.data, np.uint8)
    if step < width * line or len(data) < height * step:
        raise DatasetError(f"{where} has {len(data)} bytes for {width} x {height} pixels")
    lines = np.ascontiguousarray(data[: height * step].reshape(height, step)[:, : width * line])
    if name != message.encoding:
        lines = upper_bits(lines.view(">u2" if message.is_bigendian else "<u2"))
    image = lines.reshape(height, width, channels)
    return image if conversion is None else np.asarray(cv2.cvtColor(image, conversion), np.uint8)


def size_of(message: Any, where: str) -> tuple[int, int] | None:
    """Width and height of the image of a message; None where it cannot be read."""
    if message.__msgtype__ == IMAGES[0]:
        return message.width, message.height
    try:
        height, width = decode_image(message, where).shape[:2]
    except DatasetError:
        return None
    return width, height


def camera_of(
    info: Any, rectified: bool, size: tuple[int, int] | None, where: str
) -> tuple[Camera, NDArray[np.float64] | None, LensModel]:
    """Camera, distortion and model of a CameraInfo.

    ``rectified``: the images are, so P holds their intrinsics. ``size`` is width and height of the
    images, if they are known.
    """
    K = np.asarray(info.K if hasattr(info, "K") else info.k, np.float64).reshape(3, 3)
    P = np.asarray(info.P if hasattr(info, "P") else info.p, np.float64).reshape(3, 4)
    D = np.asarray(info.D if hasattr(info, "D") else info.d, np.float64)
    if not K.any():
        raise CalibrationError(f"{where}: K is 0, so the camera was not calibrated")
    if rectified:
        return _camera(info, P[:, :3] if P.any() else K, size, where), None, "pinhole"
    name = info.distortion_model
    if name.endswith("brown_conrady") and not D.any():  # RealSense: images without distortion
        name = ""
    if name not in _MODELS:
        raise CalibrationError(
            f"{where}: distortion model {name!r} is unknown; there are "
            f"{', '.join(filter(None, _MODELS))}"
        )
    camera, model = _camera(info, K, size, where), _MODELS[name]
    whole = np.array((info.width, info.height) if info.width and info.height else size)
    off, off_rectified = (np.abs(matrix[:2, 2] / whole - 0.5) for matrix in (K, P))
    if (off > _OFF_CENTRE).all() and (off_rectified < _OFF_CENTRE).all():
        # As kitti2bag writes them: images of KITTI are rectified, K and D are those before.
        raise CalibrationError(
            f"{where}: K of its CameraInfo is not of these images of {whole[0]} x {whole[1]} "
            f"pixels: its principal point is {K[0, 2]:.0f}, {K[1, 2]:.0f}. P fits them, so they "
            "may be rectified already; then say K as P has it"
        )
    if not D.any():
        return camera, np.zeros(4) if model == "fisheye" else None, model
    return camera, D, model


def rectification_of(info: Any) -> NDArray[np.float64]:
    """``T_rectified_camera`` (4, 4): rectified images of a stereo pair look another way.

    That is R of a CameraInfo; cameras that are not rectified onto another one have none.
    """
    T = np.eye(4)
    R = np.asarray(info.R if hasattr(info, "R") else info.r, np.float64).reshape(3, 3)
    if are_rotations(R[None])[0]:
        T[:3, :3] = R
    return T


def _camera(info: Any, K: NDArray[np.float64], size: tuple[int, int] | None, where: str) -> Camera:
    """The camera of images that may be a part of the sensor's, or binned.

    K, width and height of a CameraInfo are those of all pixels of the sensor. Some drivers leave
    out the size.
    """
    whole = (info.width, info.height) if info.width and info.height else size
    if whole is None or size is None or size == whole:
        return named_camera(K, whole or (0, 0), where)
    roi, steps = info.roi, (max(info.binning_x, 1), max(info.binning_y, 1))
    part = (roi.width or whole[0], roi.height or whole[1])
    if any(abs(s - p / step) >= 1 for s, p, step in zip(size, part, steps, strict=True)):
        raise CalibrationError(
            f"{where}: its CameraInfo is of {whole[0]} x {whole[1]} pixels, its images have "
            f"{size[0]} x {size[1]}"
        )
    K = K.copy()
    K[:2, 2] -= (roi.x_offset, roi.y_offset)
    K[:2] /= np.array(steps)[:, None]
    return named_camera(K, size, where)
