"""Checks of a camera: its images, times, intrinsics and extrinsics."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from docdepth.datasets import CameraStream, Dataset, Sweep, usable_points
from docdepth.datasets.files import (
    ImageSource,
    file_of,
    is_there,
    settings_file,
    suggest_skipping,
    unreadable,
)
from docdepth.diagnostics.alignment import find_misalignment
from docdepth.diagnostics.sweeps import broken_frames_found, sample
from docdepth.errors import DatasetError, DocDepthError, Finding, collect_errors, collect_findings
from docdepth.geometry.camera import pixels_in_image
from docdepth.geometry.se3 import transform_points
from docdepth.io.untrusted import open_file, read_text

_IMAGES = 6  # that are opened
_TAIL = 64  # bytes at the end of an image that hold its mark
_OUTSIDE = 0.2  # share of the images outside the sweeps that is worth a word
_FIELDS_DEG = (10.0, 170.0)  # of view of pinhole cameras
_FOCAL_RATIO = 2.0  # of fx and fy
_CENTRE = (0.2, 0.8)  # where the principal point lies, as a share of the image
# Where both of its coordinates lie if K is of images of another size. A crop moves one of them:
# from 0.46 (KITTI) to 0.63 (KITTI-360).
_RESIZED, _SAME_SCALE = (0.42, 0.58), 1.15
_LEVER_ARM = 3.0  # metres between camera and LiDAR of a car
_DOWN_DEG = 60.0  # between the image's y axis and the direction down in the frame of the LiDAR
_FEWEST_SEEN = 0.005  # share of the points that a camera of 20 degrees sees
_COLUMNS = 32  # that an image is divided in
_REACHED = 0.3  # share of them that the sweeps reach


def check_camera(
    recording: Dataset, stream: CameraStream, sweeps: dict[int, Sweep]
) -> list[Finding]:
    """Check one camera of a recording against sweeps that were read."""
    found = _check_images(stream)
    with collect_findings(found):
        found += _check_times(recording, stream)
    where = _extrinsics_of(recording)
    geometry = [*_check_intrinsics(stream), *_check_extrinsics(stream, sweeps, where)]
    found += geometry
    broken = any(one.severity == "error" for one in found)
    if stream.images and not geometry and not broken:  # edges would tell the same in other words
        with collect_findings(found):
            misfit = find_misalignment(recording, stream, sweeps)
            if misfit:
                remedy = f"check {where}, the intrinsics, and the times of the images"
                found.append(Finding("misaligned", stream.name, misfit, remedy))
    return found


def _check_images(stream: CameraStream) -> list[Finding]:
    """All images are files with content; some can be opened and fit the camera."""
    found: list[Finding] = []
    for image in stream.images:
        try:
            empty = image.stat().st_size == 0
        except OSError:
            empty = True
        if empty:
            with collect_findings(found), suggest_skipping():
                if image.is_file():
                    raise DatasetError(f"{image} is empty; copy the image again or remove it")
                raise unreadable(file_of(image), "put the image back")
            return found
    sampled = sample(len(stream.images), _IMAGES) if stream.images else []
    size = stream.camera.width, stream.camera.height
    odd = [k for k, image in enumerate(stream.images) if _is_odd(image, size)]
    broken: list[DocDepthError] = []
    opened = sorted({*sampled, *odd[:_IMAGES]})
    for index in opened:
        with collect_errors(broken):
            stream.rectified_image(index)
    return found + broken_frames_found(broken, len(opened))


def _is_odd(image: ImageSource, size: tuple[int, int]) -> bool:
    """Whether a PNG or JPEG lacks its end, or a PNG is of another size: worth opening."""
    if not isinstance(image, Path):
        return False
    with open_file(image) as stream:
        head = stream.read(24)
        stream.seek(max(image.stat().st_size - _TAIL, 0))
        tail = stream.read()
    if head.startswith(b"\x89PNG"):
        return b"IEND" not in tail or head[16:] != struct.pack(">II", *size)
    return head.startswith(b"\xff\xd8") and b"\xff\xd9" not in tail


def _check_times(recording: Dataset, stream: CameraStream) -> list[Finding]:
    times = recording.times
    inside = (stream.times >= times[0]) & (stream.times <= times[-1])
    spans = "there is no image"
    if len(stream.times):
        ends = (*stream.times[[0, -1]], *times[[0, -1]])
        spans = "images are from {:.3f} to {:.3f} s, sweeps from {:.3f} to {:.3f} s".format(
            *(int(time) / 1e9 for time in ends)
        )
    if not inside.any():
        raise DatasetError(
            f"none of the {len(stream.names)} images of {stream.name} lies between the first and "
            f"the last sweep ({spans}); are camera and LiDAR on one clock?",
            "give other times by `camera_times`",
            code="image-times",
        )
    outside = int((~inside).sum())
    if outside <= max(2, _OUTSIDE * len(inside)):
        return []
    text = (
        f"{outside} of {len(inside)} images lie outside the sweeps and get no depth map ({spans})"
    )
    remedy = "if the clocks differ, give other times by `camera_times`"
    return [Finding("images-outside", stream.name, text, remedy)]


def _check_intrinsics(stream: CameraStream) -> list[Finding]:
    found, camera = [], stream.camera
    fx, fy, cx, cy = camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2]
    size = f"{camera.width} x {camera.height}"
    for name, length, focal in (("wide", camera.width, fx), ("high", camera.height, fy)):
        field = float(np.degrees(2 * np.arctan(length / (2 * focal))))
        if not field < _FIELDS_DEG[1] or (name == "wide" and field < _FIELDS_DEG[0]):
            text = (
                f"the field of view is {field:.0f} degrees {name} (focal length {focal:.1f} "
                f"pixels, image {size}); is the image size right? Is K in pixels?"
            )
            found.append(Finding("field-of-view", stream.name, text))
    if not 1 / _FOCAL_RATIO < fx / fy < _FOCAL_RATIO:
        text = f"focal lengths {fx:.1f} and {fy:.1f} pixels differ more than pixels of a camera do"
        found.append(Finding("focal-lengths", stream.name, text, "check K"))
    across, down = cx / camera.width, cy / camera.height
    resized = max(across, down) < _RESIZED[0] or min(across, down) > _RESIZED[1]
    if resized and 1 / _SAME_SCALE < across / down < _SAME_SCALE:
        text = (
            f"the principal point ({cx:.1f}, {cy:.1f}) is the centre of an image of {2 * cx:.0f} x "
            f"{2 * cy:.0f} pixels, but images have {size}; were they resized?"
        )
        found.append(Finding("resized", stream.name, text, "then scale K, too"))
    elif not all(_CENTRE[0] < c < _CENTRE[1] for c in (across, down)):
        text = (
            f"the principal point ({cx:.1f}, {cy:.1f}) lies far from the centre of the {size} "
            "image; is the image size right?"
        )
        found.append(Finding("principal-point", stream.name, text))
    return found


def _check_extrinsics(stream: CameraStream, sweeps: dict[int, Sweep], where: str) -> list[Finding]:
    """Implausible places and directions."""
    found, name = [], stream.name
    distance = float(np.linalg.norm(stream.T_camera_lidar[:3, 3]))
    if distance > _LEVER_ARM:
        text = f"camera and LiDAR are {distance:.1f} m apart; is {where} in metres?"
        found.append(Finding("lever-arm", name, text))
    down_deg = float(np.degrees(np.arccos(np.clip(-stream.T_camera_lidar[1, 2], -1, 1))))
    if down_deg > _DOWN_DEG:
        text = (
            f"the y axis of the image points {down_deg:.0f} degrees away from down in the frame of "
            f"the LiDAR; {where} takes points of the LiDAR (x forward, y left, z up) to the camera "
            "(x right, y down, z forward): are its axes in this order, is it the inverse, or was a "
            "quaternion read as x y z w that is w x y z?"
        )
        found.append(Finding("not-upright", name, text))
    seen, columns = _seen(stream, sweeps)
    if sweeps and seen < _FEWEST_SEEN:
        text = f"{100 * seen:.1f} % of the points of the sweeps fall into the image"
        found.append(Finding("few-points-seen", name, text, f"check {where}"))
    elif sweeps and columns < _REACHED:
        text = f"sweeps reach {100 * columns:.0f} % of the width of the image"
        found.append(Finding("few-columns-seen", name, text, f"check {where}"))
    return found


def _seen(stream: CameraStream, sweeps: dict[int, Sweep]) -> tuple[float, float]:
    """Share of the points that fall into the image, and of its columns that they reach."""
    shares, reached = [], np.zeros(_COLUMNS, np.bool_)
    for sweep in sweeps.values():
        points = sweep.points[usable_points(sweep.points)]
        places = transform_points(stream.T_camera_lidar, points)
        rows, u, _ = pixels_in_image(places, stream.camera)
        reached[u * _COLUMNS // stream.camera.width] = True
        shares.append(len(rows) / max(len(points), 1))
    return float(np.mean(shares)) if shares else 0.0, float(reached.mean())


def _extrinsics_of(recording: Dataset) -> str:
    """Where the extrinsics of a recording stand."""
    if (recording.path / "calib.txt").is_file():
        return f"Tr in {recording.path / 'calib.txt'}"
    raw = recording.path.parent / "calib_velo_to_cam.txt"
    if raw.is_file():
        return f"R and T in {raw}"
    described = settings_file(recording.path)
    given = is_there(described) and "T_camera_lidar" in read_text(described)
    return f"T_camera_lidar in {described}" if given else f"the calibration of {recording.path}"
