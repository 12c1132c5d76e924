"""Writes a recording that docdepth reads in other formats, without a bit lost."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import yaml
from bags import BagWriter
from writers import seconds, write_pcd

from docdepth.datasets import CameraStream, Dataset, Sweep
from docdepth.datasets.images import read_image_of
from docdepth.datasets.point_times import median_period


def rows_of(sweep: Sweep, period: int) -> np.ndarray:
    """x y z intensity and seconds after the stamp as doubles, which keep a float32's share."""
    rows = np.empty(
        len(sweep.points),
        [(name, "<f4") for name in ("x", "y", "z", "intensity")] + [("t", "<f8")],
    )
    for k, axis in enumerate("xyz"):
        rows[axis] = sweep.points[:, k]
    rows["intensity"] = sweep.intensity
    rows["t"] = sweep.relative_time.astype(np.float64) * (period * 1e-9)
    return rows


def camera_entry(stream: CameraStream) -> dict:
    return {
        "K": stream.camera.K.ravel().tolist(),
        "T_camera_lidar": stream.T_camera_lidar.ravel().tolist(),
    }


def _settings(dataset: Dataset, poses: list[str], folder: Path) -> dict:
    entries: dict = {"motion_compensated": dataset.sweep(0).motion_compensated}
    if poses:
        (folder / "poses.txt").write_text("\n".join(poses) + "\n")
        entries["poses"] = "poses.txt"
    return entries


def write_folder(folder: Path, dataset: Dataset, poses: list[str]) -> Path:
    """A folder of binary PCD files; ``poses`` are the lines of a file of poses."""
    (folder / "sweeps").mkdir(parents=True)
    period = median_period(dataset.times)
    for k in range(len(dataset)):
        sweep = dataset.sweep(k)
        write_pcd(folder / "sweeps" / f"{sweep.name}.pcd", rows_of(sweep, period))
    (folder / "stamps.txt").write_text(seconds(dataset.times))
    entries = _settings(dataset, poses, folder)
    entries |= {"sweeps": "sweeps", "times": "stamps.txt", "cameras": {}}
    for name, stream in dataset.cameras.items():
        (folder / f"{name}.txt").write_text(seconds(stream.times))
        images = {"images": name} if stream.images else {}
        for image in stream.images:
            (folder / name).mkdir(exist_ok=True)
            (folder / name / image.name).symlink_to(image)
        size = [stream.camera.width, stream.camera.height]
        more = {"times": f"{name}.txt", "size": size}
        entries["cameras"][name] = camera_entry(stream) | images | more
    (folder / "docdepth.yaml").write_text(yaml.safe_dump(entries))
    return folder


def write_bag(path: Path, kind: str, dataset: Dataset, poses: list[str]) -> Path:
    """A bag with raw images; docdepth.yaml has the extrinsics, which quaternions would round."""
    path.parent.mkdir(parents=True)
    period, cameras = median_period(dataset.times), {}
    with BagWriter(path, kind) as bag:
        for k, time in enumerate(dataset.times.tolist()):
            bag.write("/points", bag.cloud(rows_of(dataset.sweep(k), period), time), time)
        for name, stream in dataset.cameras.items():
            if not stream.images:
                continue
            size = (stream.camera.width, stream.camera.height)
            for image, time in zip(stream.images, stream.times.tolist(), strict=True):
                info = bag.camera_info(stream.camera.K, np.zeros(5), size, time)
                bag.write(f"/{name}/camera_info", info, time)
                message = bag.image(read_image_of(image), time)
                bag.write(f"/{name}/image_raw", message, time)
            place = {"T_camera_lidar": stream.T_camera_lidar.ravel().tolist()}
            cameras[f"/{name}/image_raw"] = place
    folder = path if path.is_dir() else path.parent
    entries = _settings(dataset, poses, folder) | {"cameras": cameras}
    (folder / "docdepth.yaml").write_text(yaml.safe_dump(entries))
    return path
