"""Files of poses: TUM (``t x y z qx qy qz qw``), KITTI (a 3x4 matrix in each line), PLY, NPY.

Other SLAM systems write TUM and KITTI, and evo reads them. PLY is the trajectory of a run folder.
NPY holds matrices, (n, 4, 4) or (n, 3, 4). Poses are ``T_world_lidar``, but for the
pose files of KITTI itself, which are of the camera.
"""

from __future__ import annotations

import logging
import re
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import DamagedFileError, InputError, OdometryError
from docdepth.geometry.se3 import (
    check_rigid,
    matrix_to_quaternion,
    nearest_rigid,
    poses_from,
    quaternion_to_matrix,
)
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.atomic import write_atomically
from docdepth.io.frames import read_trajectory
from docdepth.io.untrusted import ArrayError, read_array, read_text

log = logging.getLogger(__name__)

_LATE = 0.75  # of the time between sweeps; poses may be of the middle or the end of a sweep
# Digits, less one, of a time that counts nanoseconds since 1970, and not seconds.
_OF_NANOSECONDS = 17
_MOST_DIGITS = 12  # of seconds, before the point; int64 holds 292 years of nanoseconds

POSE_FORMATS = ("tum", "kitti", "ply", "npy")


def read_poses(path: Path | str, count: int | None = None) -> NDArray[np.float64]:
    """Read the poses of ``count`` sweeps from a file of any format.

    Parameters
    ----------
    path : Path
        ``.ply`` and ``.npy`` are told by their suffix, else lines of 8 numbers are TUM, of 12
        KITTI. Pose k is that of sweep k, whatever its time.
    count : int, optional
        Number of sweeps; any if left out.

    Returns
    -------
    ndarray of float64, shape (count, 4, 4)
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix in (".ply", ".npy"):
        poses = _read_ply(path) if suffix == ".ply" else _read_npy(path)
        _check_count(poses, count, path)
        return poses
    rows = _read(path)
    if rows.shape[1] not in (8, 12):
        raise OdometryError(
            f"{path} has {rows.shape[1]} columns; TUM poses have 8 (t x y z qx qy qz qw), "
            "KITTI poses 12 (the upper 3x4 of the matrix, row by row)"
        )
    _check_count(rows, count, path)
    return _from_tum(rows, path) if rows.shape[1] == 8 else _from_kitti(rows, path)


def pose_times(path: Path | str) -> NDArray[np.int64] | None:
    """The times in a file of poses [ns], in any order; None where it has none."""
    path = Path(path)
    if path.suffix.lower() == ".ply":
        return read_trajectory(path)[0].times
    if path.suffix.lower() == ".npy" or len(_lines(path)[0].split()) != 8:
        return None
    try:
        return np.array([_nanoseconds(line) for line in _lines(path)], np.int64)
    except OverflowError:
        return None


def warn_of_other_times(path: Path, times: NDArray[np.int64]) -> None:
    """Log a warning if a file with a pose for each sweep has other times than the sweeps.

    Times on another clock, or that only count, tell nothing.
    """
    own = pose_times(path)
    if own is None or len(own) != len(times) or len(times) < 2:
        return
    other_clock = 0
    if own.max() < times[0] or own.min() > times[-1]:
        if len(np.unique(np.diff(own))) == 1:
            return  # they only count, or all is well
        other_clock = int(np.median(own - times))
        own = own - other_clock
    off = np.abs(own - times)
    worst = int(off.argmax())
    if off[worst] > _LATE * float(np.median(np.diff(times))):
        log.warning(
            "%s: pose %d is of %.3f s%s, sweep %d of %.3f s; poses are taken in the order of the "
            "sweeps: bring one for each sweep, in this order",
            path, worst, own[worst] * 1e-9, " by the clock of the sweeps" if other_clock else "",
            worst, times[worst] * 1e-9,
        )  # fmt: skip


def _check_count(rows: NDArray[np.float64], count: int | None, path: Path) -> None:
    if count is not None and len(rows) != count:
        raise OdometryError(
            f"{path} has {len(rows)} poses for {count} sweeps; "
            "bring one pose a sweep, in the order of the sweeps"
        )


def _read_ply(path: Path) -> NDArray[np.float64]:
    """The poses of a trajectory as run folders have it."""
    try:
        trajectory, indices = read_trajectory(path)
    except DamagedFileError as error:
        what = error.what or "it is not there"
        raise OdometryError(f"{path} is no trajectory of a run ({what}); name another") from None
    if not np.array_equal(indices, np.arange(len(indices))):
        raise OdometryError(
            f"{path}: its poses are not numbered 0, 1, 2, ... without gaps; bring one pose a "
            "sweep, as in traj_odometry.ply"
        )
    return trajectory.poses


def _read_npy(path: Path) -> NDArray[np.float64]:
    try:
        values = read_array(path)
    except FileNotFoundError:
        raise OdometryError(f"{path} is missing; give the file of the poses") from None
    except (OSError, ArrayError) as error:
        raise OdometryError(f"{path} cannot be read as NPY ({error}); write it again") from None
    numbers = np.issubdtype(values.dtype, np.number) and not np.iscomplexobj(values)
    if not numbers or values.ndim != 3 or values.shape[1:] not in ((4, 4), (3, 4)):
        raise OdometryError(
            f"{path} is {values.dtype} of shape {values.shape}; poses are numbers of shape "
            "(n, 4, 4) or (n, 3, 4)"
        )
    if not len(values):
        raise OdometryError(f"{path} holds no poses")
    poses = np.repeat(np.eye(4)[None], len(values), axis=0)
    poses[:, : values.shape[1]] = values
    poses = _checked(poses, path)
    return poses if values.dtype == np.float64 else nearest_rigid(poses)


def read_timed_poses(path: Path | str) -> tuple[NDArray[np.int64] | None, NDArray[np.float64]]:
    """All poses of a file of any format, and their times [ns]; None where it has none."""
    path = Path(path)
    poses = read_poses(path)
    if path.suffix.lower() == ".ply":
        return read_trajectory(path)[0].times, poses
    if path.suffix.lower() == ".npy" or len(_lines(path)[0].split()) == 12:
        return None, poses
    return read_tum(path).times, poses


def read_tum(path: Path | str) -> Trajectory:
    """A TUM file with its times, which are kept to the nanosecond."""
    rows = _read(Path(path), columns=8)
    try:
        times = np.array([_nanoseconds(line) for line in _lines(Path(path))], dtype=np.int64)
    except OverflowError:
        raise OdometryError(f"{path} has a time that is no number of seconds") from None
    try:
        return Trajectory(times, _from_tum(rows, path))
    except InputError as error:
        raise OdometryError(f"{path}: {error}") from None


def read_kitti(path: Path | str) -> NDArray[np.float64]:
    """All poses (n, 4, 4) of a KITTI file."""
    return _from_kitti(_read(Path(path), columns=12), path)


def write_tum(path: Path | str, trajectory: Trajectory) -> None:
    """Write a trajectory as TUM: seconds with nine digits, quaternions with w >= 0."""
    lines = []
    for time, pose in zip(trajectory.times.tolist(), trajectory.poses, strict=True):
        values = [*pose[:3, 3], *matrix_to_quaternion(pose[:3, :3])]
        stamp = f"{'-' if time < 0 else ''}{abs(time) // 10**9}.{abs(time) % 10**9:09d}"
        lines.append(" ".join([stamp, *(f"{value:.9f}" for value in values)]))
    write_atomically(Path(path), ("\n".join(lines) + "\n").encode())


def write_kitti(path: Path | str, poses: NDArray[np.float64]) -> None:
    """Write poses (n, 4, 4) in KITTI's format."""
    lines = [" ".join(f"{value:.12e}" for value in pose[:3].ravel()) for pose in poses]
    write_atomically(Path(path), ("\n".join(lines) + "\n").encode())


def _nanoseconds(line: str) -> int:
    """The time of a TUM line, which never passes through a float."""
    time = Decimal(line.split()[0])
    if time.is_finite() and time.adjusted() >= _OF_NANOSECONDS:
        time = time.scaleb(-9)  # as EuRoC and its followers count
    if not time.is_finite() or time.adjusted() > _MOST_DIGITS:
        raise OverflowError
    return int((time * 10**9).to_integral_value())


def _begins_with_w(path: Path) -> bool:
    """Whether a heading names the quaternion w x y z, as EuRoC's files do, not x y z w."""
    for line in read_text(path).splitlines():
        names = re.sub(r"\[[^]]*\]", "", line.lstrip("# ")).replace(",", " ").split()
        if line.lstrip().startswith("#") and len(names) == 8:
            return [name[-1].lower() for name in names[4:]] == list("wxyz")
    return False


def _lines(path: Path) -> list[str]:
    try:
        text = read_text(path)
    except FileNotFoundError:
        raise OdometryError(f"{path} is missing; give the file of the poses") from None
    except (UnicodeDecodeError, IsADirectoryError):
        raise OdometryError(f"{path} is not a text file of poses (TUM or KITTI)") from None
    except OSError as error:
        raise OdometryError(
            f"{path} cannot be read ({error.strerror}); give the file of the poses"
        ) from None
    lines = [line.replace(",", " ") for line in text.splitlines()]
    return [line for line in lines if line.strip() and not line.lstrip().startswith("#")]


def _read(path: Path, columns: int | None = None) -> NDArray[np.float64]:
    lines = _lines(path)
    if not lines:
        raise OdometryError(f"{path} holds no poses")
    columns = columns or len(lines[0].split())
    rows = np.empty((len(lines), columns))
    for k, line in enumerate(lines):
        if (found := len(line.split())) != columns:
            raise OdometryError(
                f"{path}, pose {k}: '{line.strip()[:60]}' is not {columns} numbers but {found}; "
                "each line is one pose, and a heading begins with #"
            )
        try:
            rows[k] = [float(Decimal(word)) for word in line.split()]
        except (InvalidOperation, ValueError):
            raise OdometryError(
                f"{path}, pose {k}: '{line.strip()[:60]}' is not {columns} numbers; "
                "each line is one pose, and a heading begins with #"
            ) from None
    if columns == 8 and _begins_with_w(path):
        rows[:, 4:] = np.roll(rows[:, 4:], -1, axis=1)
    return rows


def _from_tum(rows: NDArray[np.float64], path: Path | str) -> NDArray[np.float64]:
    rotations = []
    for k, row in enumerate(rows):
        try:
            rotations.append(quaternion_to_matrix(row[4:8]))
        except InputError as error:
            raise OdometryError(f"{path}, pose {k}: {error}") from None
    return _checked(poses_from(rotations, rows[:, 1:4]), path)


def _from_kitti(rows: NDArray[np.float64], path: Path | str) -> NDArray[np.float64]:
    matrices = rows.reshape(-1, 3, 4)
    poses = _checked(poses_from(list(matrices[:, :, :3]), matrices[:, :, 3]), path)
    return nearest_rigid(poses)  # printed with few digits, matrices are not quite rotations


def _checked(poses: NDArray[np.float64], path: Path | str) -> NDArray[np.float64]:
    try:
        check_rigid(poses)
    except InputError as error:
        raise OdometryError(f"{path}: {error}") from None
    return poses
