"""Given poses that are centimetres or decimetres off, as those of GNSS, refined by registration.

Votes compare sweeps that were taken up to 80 m apart. Poses that are 15 cm off over ten sweeps make
half of the world look moving, though neighbouring sweeps fit each other. Poses that are 3 cm off
make a twentieth of what moves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from docdepth.config import OdometryParameters
from docdepth.errors import Finding
from docdepth.geometry.se3 import nearest_rotation, se3_exp, se3_log
from docdepth.geometry.trajectory import Trajectory, parts_of
from docdepth.odometry.deskewing import centred_motion
from docdepth.odometry.passes import register
from docdepth.odometry.pose_checks import MISFIT, misfit, sudden_change
from docdepth.odometry.registration_log import RegistrationLog
from docdepth.odometry.smoothing import smoothed
from docdepth.odometry.sweeps import SweepPart, ThinnedSweeps, deskewed_points

_APART = 10  # sweeps between those that are compared
# Metres by which points move when sweeps are aligned with those ten before. Median of exact poses:
# 0.002 to 0.021 by five sensors; of two SLAMs 0.03 and 0.05. With noise of 5 cm 0.06 to 0.1, with
# 0.1 degrees 0.03 to 0.17, by GPS and IMU 0.16.
_DOUBTFUL, _POOR = 0.02, 0.06
_BETTER = 0.5  # of the misfit; refined poses that fit little better are not taken
# Metres of noise along the way: by GPS and IMU, and by registration, 0.1 to 5 mm.
_SHAKES, _BETTER_IF_SHAKEN = 0.007, 0.8
_JERK = 2.0  # metres/s^3; a vehicle drives and brakes as gently as that
_MEDIAN_OF_NORMAL = 0.6745  # of absolute values, in standard deviations
_THIRD = 20**0.5  # standard deviation of a third difference of errors of 1


def _misfit_of(
    sweeps: ThinnedSweeps,
    poses: NDArray[np.float64],
    parameters: OdometryParameters,
    apart: int,
    jump: int | None,
) -> float | None:
    """How far points lie from where sweeps so many before them, and the poses, say [m].

    The median of a few places, or what is found across the pose ``jump``, whichever is more.
    """

    def points(k: int) -> NDArray[np.float32]:
        return deskewed_points(sweeps[k], k, centred_motion(poses, sweeps.times, [k])[0])

    found = [misfit(points, poses, sweeps.times, parameters, apart)]
    if jump is not None:
        last = max(jump, 2)
        apart = min(apart, len(poses) - 1 - last)
        found += [misfit(points, poses, sweeps.times, parameters, apart, last + apart)]
    return max((one for one in found if one is not None), default=None)


def noise_along(poses: NDArray[np.float64], times: NDArray[np.int64]) -> float:
    """Standard deviation of the error that each pose has by itself along the way [m].

    A vehicle heaves, sways and turns, but along its way it drives evenly: third differences of the
    path are errors, but for those that a vehicle's jerk explains.
    """
    if len(poses) < 4:
        return 0.0
    seconds = 1e-9 * np.diff(times)
    period = float(np.median(seconds))
    ways = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1) * period / seconds
    third = float(np.median(np.abs(np.diff(ways, 2)))) / _MEDIAN_OF_NORMAL
    return max(0.0, third - _JERK * period**3) / _THIRD


def refine_poor(
    sweeps: ThinnedSweeps,
    poses: NDArray[np.float64],
    parameters: OdometryParameters,
    threads: int,
    logs: Callable[[range], Sequence[RegistrationLog]],
) -> tuple[NDArray[np.float64], list[Finding]]:
    """Poses (n, 4, 4) ``T_world_lidar`` that fit the sweeps, and what is to be said of them.

    Poses that fit are returned as they are. Others are registered, once for each of the ``logs``
    of a part, each sweep from where they say that it lies. What fits better is laid on them, each
    part as a whole: the world stays where it was given.
    """
    apart = min(_APART, max(1, len(poses) // 3))
    jump = sudden_change(Trajectory(sweeps.times, poses))
    before = _misfit_of(sweeps, poses, parameters, apart, jump)
    shaken = noise_along(poses, sweeps.times)
    if before is None or (before <= _DOUBTFUL and shaken <= _SHAKES):
        return poses, []
    found: list[Finding] = []
    refined = poses.copy()
    for part in parts_of(sweeps.times):
        rows, path = slice(part.start, part.stop), poses[part.start : part.stop]
        if shaken > _SHAKES:
            path = _steadied(path, sweeps.times[rows])
        for log in logs(part):  # one pass leaves errors of the motion that deskewed the sweeps
            try:
                path = _registered(SweepPart(sweeps, part), path, parameters, threads, log, found)
            finally:
                log.close()
        refined[rows] = _laid_on(poses[rows], path)
    after = _misfit_of(sweeps, refined, parameters, apart, jump)
    misfits = (
        f"the poses do not fit the sweeps: points lie {before:.3f} m from where they were {apart} "
        "sweeps before"
    )
    if shaken > _SHAKES and before <= MISFIT:
        misfits += f", and each pose is {shaken:.3f} m off along the way by itself"
    better = _BETTER_IF_SHAKEN if shaken > _SHAKES else _BETTER
    if found or after is None or after > min(MISFIT, better * before):
        # What fits worse than the given poses cannot judge them: along a motorway 16 beams find
        # 0.17 m where exact poses have 0.09.
        unable = not found and after is not None and before <= min(after, MISFIT)
        if before <= _POOR or (unable and shaken <= _SHAKES):
            return poses, []
        text = f"{misfits}; registration finds no poses that fit, so these are kept"
        remedy = "labels and depth may be wrong; bring others, or none (`poses`)"
        return poses, [Finding("poor-poses", "", text, remedy)]
    moved = np.linalg.norm((refined - poses)[:, :3, 3], axis=1).max()
    text = (
        f"{misfits}; after registration {after:.3f} m. The poses have moved by up to {moved:.2f} m"
    )
    remedy = "`poses_as_given=True` takes them as they are"
    severity: Literal["warning", "note"] = "warning" if before > MISFIT else "note"
    return refined, [Finding("poses-refined", "", text, remedy, severity)]


def _registered(
    sweeps: SweepPart,
    path: NDArray[np.float64],
    parameters: OdometryParameters,
    threads: int,
    log: RegistrationLog,
    found: list[Finding],
) -> NDArray[np.float64]:
    """Poses (n, 4, 4) of a part, each sweep registered from where ``path`` says that it lies."""
    first = centred_motion(path, sweeps.times, [0])[0]
    states = register(sweeps, parameters, first, lambda _: path, threads, log, found)
    return np.stack(list(smoothed(states)))


def _steadied(poses: NDArray[np.float64], times: NDArray[np.int64]) -> NDArray[np.float64]:
    """Poses (n, 4, 4) by the mean motion around each: the step between two has errors of both."""
    shares = np.diff(times) / np.median(np.diff(times)) if len(times) > 1 else ()
    path = [poses[0]]
    for motion, share in zip(centred_motion(poses, times)[1:], shares, strict=True):
        omega, velocity = se3_log(motion)
        path.append(path[-1] @ se3_exp(share * omega, share * velocity))
    return np.stack(path)


def _laid_on(poses: NDArray[np.float64], path: NDArray[np.float64]) -> NDArray[np.float64]:
    """A trajectory (n, 4, 4), moved as a whole to where ``poses`` are on average."""
    turn, T = path[:, :3, :3].swapaxes(1, 2), np.eye(4)
    T[:3, :3] = nearest_rotation((poses[:, :3, :3] @ turn).sum(axis=0))
    T[:3, 3] = (poses[:, :3, 3] - path[:, :3, 3] @ T[:3, :3].T).mean(axis=0)
    laid: NDArray[np.float64] = T @ path
    return laid
