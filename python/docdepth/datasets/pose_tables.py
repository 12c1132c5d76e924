"""Poses that a recording brings along: a table of stamped rows, brought to the times of its sweeps.

Tables of data sets have their own times, more rows or fewer than there are sweeps, and no pose
where the vehicle stood or where the satellites were lost.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from decimal import Decimal, InvalidOperation
from math import isfinite
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.files import is_there, read_lines
from docdepth.errors import DatasetError, InputError, OdometryError
from docdepth.geometry.se3 import (
    check_rigid,
    inverse,
    nearest_rigid,
    poses_from,
    quaternion_to_matrix,
    rotation_exp,
    se3_exp,
    se3_log,
)
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.poses import pose_times, read_poses, warn_of_other_times

log = logging.getLogger(__name__)

# Between poses farther apart in time and in space, a sweep has none: what the vehicle did is open.
_LONGEST_GAP = 250_000_000  # ns
_FARTHEST = 1.0  # metres
_LONGEST_END = 150_000_000  # ns before the first pose and after the last one


def read_pose_table(
    file: Path, columns: tuple[int, ...], remedy: str
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Rows of a whole number, such as a stamp, and as many further numbers as ``columns`` allows.

    They stand between commas or blanks. A heading is left out, and so are rows with NaN: they are
    times at which the pose is not known. Stamps (n,) increase, and of rows (n, columns) with the
    same one the first stays.
    """
    stamps: list[int] = []
    rows: list[list[float]] = []
    for n, line in enumerate(read_lines(file, remedy), 1):
        words = line.replace(",", " ").split()
        if not words or words[0].startswith("#") or (n == 1 and words[0][0].isalpha()):
            continue
        try:
            stamp, row = _whole(words[0]), [float(word) for word in words[1:]]
            if len(row) not in columns:
                raise ValueError
            if rows and len(row) != len(rows[0]):
                raise ValueError
        except (ValueError, InvalidOperation):
            counts = " or ".join(str(count) for count in columns)
            raise DatasetError(
                f"{file}, line {n}: '{line.strip()[:60]}' ({len(words)} values) is not a whole "
                f"number and {counts} more numbers; {remedy}"
            ) from None
        if all(map(isfinite, row)):
            stamps.append(stamp)
            rows.append(row)
    if not rows:
        raise DatasetError(f"{file} holds no poses; {remedy}")
    increasing, first = np.unique(np.array(stamps, np.int64), return_index=True)
    return increasing, np.array(rows, np.float64)[first]


def read_table_poses(
    file: Path,
    columns: tuple[int, ...],
    remedy: str,
    times: NDArray[np.int64],
    poses_of: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    unit: int = 1,
) -> NDArray[np.float64] | None:
    """Poses (n, 4, 4) of a table at the times of the sweeps; NaN where they are not known.

    ``columns`` and ``remedy`` are those of :func:`read_pose_table`. ``poses_of`` makes
    ``T_world_lidar`` (m, 4, 4) of rows, whose stamps count ``unit`` nanoseconds. None without file.
    """
    if not is_there(file):
        return None
    stamps, rows = read_pose_table(file, columns, remedy)
    stamps, rows = rows_around(stamps * unit, rows, times)
    return poses_at(stamps, poses_of(rows), times, file)


def _whole(word: str) -> int:
    """A whole number, also one that is written as 1.5e18."""
    number = Decimal(word)
    if not number.is_finite() or number.adjusted() > 18 or number != number.to_integral_value():
        raise ValueError
    whole = int(number)
    if abs(whole) >= 1 << 63:
        raise ValueError
    return whole


def rows_around(
    stamps: NDArray[np.int64], rows: NDArray[np.float64], times: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The rows before and after each sweep, the first and the last: all that poses come from.

    Tables have up to a million rows (n, k), of which few lie beside a sweep. ``stamps`` (n,) and
    ``times`` (m,) of the sweeps are nanoseconds, increasing.
    """
    after, last = np.searchsorted(stamps, times), len(stamps) - 1
    kept = np.unique(np.concatenate([(after - 1).clip(0), after.clip(max=last), [0, last]]))
    return stamps[kept], rows[kept]


def poses_of_matrices(rows: NDArray[np.float64], file: Path) -> NDArray[np.float64]:
    """Poses (n, 4, 4) of rows with the upper 3x4, or all, of their matrices."""
    matrices = rows.reshape(len(rows), -1, 4)
    poses = poses_from(list(matrices[:, :3, :3]), matrices[:, :3, 3])
    return nearest_rigid(_checked(poses, file))  # printed with few digits


def poses_of_angles(
    positions: NDArray[np.float64], roll_pitch_yaw: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Poses (n, 4, 4) of positions (n, 3) in metres and angles (n, 3) in radians.

    The rotation is Rz(yaw) Ry(pitch) Rx(roll): it takes vectors of the vehicle to the world.
    """
    roll, pitch, yaw = (rotation_exp(roll_pitch_yaw * axis) for axis in np.eye(3))
    return poses_from(list(yaw @ pitch @ roll), positions)


def read_poses_at(path: Path, times: NDArray[np.int64]) -> NDArray[np.float64]:
    """The poses (n, 4, 4) of sweeps at these times [ns], from a file of any format.

    One pose for each sweep is taken in the order of the sweeps, and a warning tells where the file
    has other times. More or fewer that have times on the clock of the sweeps are interpolated.
    """
    poses, own = read_poses(path), pose_times(path)
    if len(poses) == len(times):
        warn_of_other_times(path, times)
        return poses
    if own is None or len(own) != len(poses) or (np.diff(own) <= 0).any():
        raise OdometryError(
            f"{path} has {len(poses)} poses for {len(times)} sweeps; bring one pose a sweep, in "
            "the order of the sweeps, or TUM with increasing times, which are interpolated"
        )
    try:
        found = continue_ends(poses_at(own, poses, times, path), own, poses, times)
    except DatasetError as error:
        raise OdometryError(
            f"{path} has {len(poses)} poses for {len(times)} sweeps, at times of another clock: "
            f"{error}"
        ) from None
    lacking = np.flatnonzero(np.isnan(found).any(axis=(1, 2)))
    if len(lacking):
        more = f" and {len(lacking) - 1} more" if len(lacking) > 1 else ""
        raise OdometryError(
            f"{path} has {len(poses)} poses for {len(times)} sweeps, and none near sweep "
            f"{lacking[0]} at {times[lacking[0]] * 1e-9:.3f} s{more}; bring poses that are at most "
            "0.25 s or 1 m apart, or choose `frames` that have some"
        )
    log.info("%s: %d poses are interpolated to %d sweeps", path, len(poses), len(times))
    return found


def poses_at(
    stamps: NDArray[np.int64],
    poses: NDArray[np.float64],
    times: NDArray[np.int64],
    file: Path,
) -> NDArray[np.float64]:
    """Poses (m, 4, 4) at the times of the sweeps, interpolated; NaN where they are not known.

    ``poses`` (n, 4, 4) hold at ``stamps`` (n,), increasing nanoseconds; ``file`` is for messages.
    NaN are those before the first pose, after the last one, and between poses that are more than a
    quarter of a second and a metre apart.
    """
    trajectory = Trajectory(stamps, _checked(poses, file))
    after = np.searchsorted(stamps, times).clip(1, max(len(stamps) - 1, 1)) % len(stamps)
    before = (after - 1).clip(0)
    moved = np.linalg.norm(poses[after, :3, 3] - poses[before, :3, 3], axis=1)
    near = (stamps[after] - stamps[before] <= _LONGEST_GAP) | (moved <= _FARTHEST)
    known = trajectory.covers(times) & (near | np.isin(times, stamps))
    if not known.any():
        raise DatasetError(
            f"{file} has poses from {stamps[0]} to {stamps[-1]} ns, but the sweeps are from "
            f"{times[0]} to {times[-1]} ns; is it the file of this recording?"
        )
    result = np.full((len(times), 4, 4), np.nan)
    result[known] = trajectory.interpolate(times[known])
    return result


def continue_ends(
    result: NDArray[np.float64],
    stamps: NDArray[np.int64],
    poses: NDArray[np.float64],
    times: NDArray[np.int64],
) -> NDArray[np.float64]:
    """Poses of sweeps just before the first pose and after the last one: the motion goes on.

    ``result`` (m, 4, 4) are poses at ``times`` (m,), ``poses`` (n, 4, 4) those that are known at
    ``stamps`` (n,), increasing; nanoseconds. Sweeps up to 0.15 s outside get one, a sweep and a
    half.
    """
    result = result.copy()
    for near, beside in ((0, 1), (-1, -2)) if len(stamps) > 1 else ():
        late = times - stamps[near]
        outside = late < 0 if near == 0 else late > 0
        omega, velocity = se3_log(inverse(poses[near]) @ poses[beside])
        for k in np.flatnonzero(outside & (np.abs(late) <= _LONGEST_END)):
            share = float(late[k] / (stamps[beside] - stamps[near]))
            result[k] = poses[near] @ se3_exp(share * omega, share * velocity)
    return result


def _checked(poses: NDArray[np.float64], file: Path) -> NDArray[np.float64]:
    try:
        check_rigid(poses)
    except InputError as error:
        raise DatasetError(f"{file}: {error}") from None
    return poses


def pose_of(
    quaternion: Iterable[float], translation: Iterable[float], where: str
) -> NDArray[np.float64]:
    """A pose (4, 4) of a quaternion w x y z and a translation in metres.

    Generators are asked here, so that a number that is missing is named as well.
    """
    try:
        w, x, y, z = (float(value) for value in quaternion)
        position = [float(value) for value in translation]
        if not np.isfinite(position).all():
            raise ValueError(f"its translation is {position}")
        return poses_from([quaternion_to_matrix([x, y, z, w])], [position])[0]
    except (InputError, ValueError, TypeError, LookupError) as error:
        raise DatasetError(f"{where} is no pose ({error}); restore the file") from None
