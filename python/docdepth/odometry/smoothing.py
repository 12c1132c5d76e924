"""Positions filtered and smoothed along the trajectory, and rotations that follow them.

Where registration is unsure, a steady motion decides. Walls and poles hold a pose to millimetres.
Along a motorway nothing does, and registration is centimetres to decimetres off there. Lorries at
the same speed pull its result along. A vehicle cannot jerk that much from sweep to sweep.

A LiDAR that looks ahead hardly tells a step to the side from a turn: points 50 m ahead move as much
by 0.2 degrees as by 17 cm. Registration then errs in both at once, so that these points fit. If the
filter took back the step alone, they would no longer fit, and the next sweep would turn farther.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from docdepth.geometry.se3 import rigid, se3_exp, se3_log

LAG = 10
"""Sweeps after one that are used for it. At 10 sweeps a second they last four times as long as the
smoothing reaches where registration is 5 cm unsure: cube root of 0.05 m / (2 m/s^3) = 0.3 s."""

# Metres/s^3, standard deviations. Along the way a car only drives and brakes. Its roof heaves and
# rolls on the springs as well: 5 mm at 1.5 to 3 Hz are 4 to 33.
_JERK, _SWAY = 2.0, 20.0
_STANDING = 1.0  # metres/s; a slower vehicle may set off in any direction
_NOISE = 0.002  # metres; error of a position beside what its covariance says
_LOST = 25.0
"""Beyond so many standard deviations between registration and the predicted position, registration
is right if it is ahead: a sweep was lost without a gap in the stamps. Behind, traffic pulls it."""
_HELD = 0.005  # metres; a change of position up to this size is no sign of a turn
_ALIKE = 10  # neighbouring points that have the same error, and so count as one
_MEDIAN_OF_NORMAL = 0.6745  # of absolute values, in standard deviations
_SPEED, _ACCELERATION = 60.0, 10.0  # metres/s, metres/s^2; what is known of them at the start
_FIRST_SPEED = 2.0  # metres/s; error of the first motion: its steps, and 10 m/s^2 for 0.2 s


class State(NamedTuple):
    """Position, velocity and acceleration (9,) at a sweep, and their covariance (9, 9).

    ``predicted`` is what the sweeps before tell, ``mean`` what they and this one tell.
    """

    pose: NDArray[np.float64]  # with the filtered position, and the rotation that goes with it
    transition: NDArray[np.float64]  # from the sweep before
    predicted: NDArray[np.float64]
    predicted_covariance: NDArray[np.float64]
    mean: NDArray[np.float64]
    covariance: NDArray[np.float64]
    lean: NDArray[np.float64]  # rotation that goes with a change of position (3, 3) [rad/m]

    @property
    def velocity(self) -> NDArray[np.float64]:
        """In the world (3,) [m/s]."""
        return self.mean[3:6]


def first_state(pose: NDArray[np.float64], velocity: NDArray[np.float64] | None) -> State:
    """State at the first sweep, whose pose is the frame of all others.

    Parameters
    ----------
    velocity : ndarray of float64, shape (3,), optional
        From the first motion, in the world [m/s]. None if it is not known.
    """
    speed = _SPEED if velocity is None else _FIRST_SPEED
    mean = np.concatenate([pose[:3, 3], np.zeros(3) if velocity is None else velocity, np.zeros(3)])
    covariance = np.diag(np.repeat([0.0, speed, _ACCELERATION], 3) ** 2)
    return State(pose, np.eye(9), mean, covariance, mean, covariance, np.zeros((3, 3)))


def filtered(
    before: State,
    pose: NDArray[np.float64],
    covariance: NDArray[np.float64],
    elapsed: float,
    stamp_error: float = 0.0,
) -> State:
    """One step of a Kalman filter with white jerk; rotations follow the positions.

    Parameters
    ----------
    before : State
        Of the sweep before.
    pose : ndarray of float64, shape (4, 4)
        ``T_world_lidar`` as registered.
    covariance : ndarray of float64, shape (6, 6)
        Of its rotation [rad^2] and its position [m^2], about the axes of the world.
    elapsed : float
        Seconds since the sweep before.
    stamp_error : float
        Standard deviation of a stamp [s], from :func:`stamp_error_of`. The predicted position is
        uncertain by the way that the vehicle goes in that time.
    """
    position = pose[:3, 3]
    measured = _ALIKE * covariance[3:, 3:] + _NOISE**2 * np.eye(3)
    transition = _transition(before.pose, pose, elapsed)
    predicted, noise = transition @ before.mean, measured
    of_jerk = np.array([elapsed**3 / 6, elapsed**2 / 2, elapsed])
    spread = transition @ before.covariance @ transition.T
    spread += np.kron(np.outer(of_jerk, of_jerk), _covariance_of_jerk(before.velocity))
    of_stamps = stamp_error * before.velocity
    spread[:3, :3] += 2 * np.outer(of_stamps, of_stamps)  # of this sweep and the one before
    off = position - predicted[:3]
    squared = float(off @ np.linalg.solve(spread[:3, :3] + noise, off))
    if squared > _LOST**2 and off @ before.velocity > 0:
        spread[:3, :3] += np.outer(off, off)
    else:
        # Traffic pulls it along, or nothing holds it. The farther away, the less it counts.
        noise = noise * max(1.0, squared)
    gain = np.linalg.solve(spread[:3, :3] + noise, spread[:3]).T
    mean = predicted + gain @ (position - predicted[:3])
    left = np.eye(9)
    left[:, :3] -= gain
    # Joseph's form keeps the covariance positive.
    after = left @ spread @ left.T + gain @ noise @ gain.T
    # What registration found of both together: the mean rotation where the position is known.
    lean = _ALIKE * covariance[:3, 3:] @ np.linalg.inv(measured + _HELD**2 * np.eye(3))
    pose = _moved(pose, mean[:3], lean)
    return State(pose, transition, predicted, spread, mean, after, lean)


def _moved(
    pose: NDArray[np.float64], position: NDArray[np.float64], lean: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The pose at another position, with the rotation that goes with it."""
    turn = se3_exp(lean @ (position - pose[:3, 3]), np.zeros(3))[:3, :3]
    return rigid(turn @ pose[:3, :3], position)


def _transition(
    before: NDArray[np.float64], pose: NDArray[np.float64], elapsed: float
) -> NDArray[np.float64]:
    """Matrix (9, 9) from one state to the next. Velocity and acceleration turn with the vehicle."""
    turn = rigid(pose[:3, :3] @ before[:3, :3].T)
    half = se3_exp(0.5 * se3_log(turn)[0], np.zeros(3))[:3, :3]
    advance = np.array([[1, elapsed, elapsed**2 / 2], [0, 1, elapsed], [0, 0, 1]])
    transition = np.kron(advance, np.eye(3))
    transition[:3, 3:] = half @ transition[:3, 3:]
    transition[3:6, 3:] = turn[:3, :3] @ transition[3:6, 3:]
    transition[6:, 6:] = turn[:3, :3]
    return transition


def stamp_error_of(times: NDArray[np.int64]) -> float:
    """Standard deviation [s] of the errors of stamps (n,) [ns], as a LiDAR turns evenly.

    Sweeps that a computer stamps when they arrive are milliseconds late, some more, some less.
    """
    if len(times) < 3:
        return 0.0
    # The second difference of independent errors has six times their variance.
    return float(np.median(np.abs(np.diff(times, 2)))) * 1e-9 / (_MEDIAN_OF_NORMAL * 6**0.5)


def _covariance_of_jerk(velocity: NDArray[np.float64]) -> NDArray[np.float64]:
    """Covariance (3, 3) of the jerk [m^2/s^6]: small along the way."""
    ahead = velocity / max(float(np.linalg.norm(velocity)), _STANDING)
    covariance: NDArray[np.float64] = _SWAY**2 * np.eye(3)
    covariance -= (_SWAY**2 - _JERK**2) * np.outer(ahead, ahead)
    return covariance


def smoothed(states: Iterable[State]) -> Iterator[NDArray[np.float64]]:
    """Tell each filtered position what later sweeps know (Rauch, Tung and Striebel).

    Yields
    ------
    ndarray of float64, shape (4, 4)
        The pose of each state, when up to :data:`LAG` after it are known.
    """
    window: deque[State] = deque()
    for state in states:
        window.append(state)
        if len(window) > LAG:
            yield _smoothed_poses(window, 1)[0]
            window.popleft()
    if window:
        yield from _smoothed_poses(window, len(window))


def _smoothed_poses(window: deque[State], wanted: int) -> list[NDArray[np.float64]]:
    """The first poses of a window."""
    states = list(window)
    means = [states[-1].mean]
    for state, after in zip(states[-2::-1], states[:0:-1], strict=True):
        gain = np.linalg.solve(after.predicted_covariance, after.transition @ state.covariance).T
        means.append(state.mean + gain @ (means[-1] - after.predicted))
    known = zip(states[:wanted], means[: -wanted - 1 : -1], strict=True)
    return [_moved(state.pose, mean[:3], state.lean) for state, mean in known]
