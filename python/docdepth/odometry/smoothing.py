"""Positions filtered and smoothed along the trajectory.

Where registration is unsure, a steady motion decides. Walls and poles hold a pose to millimetres.
Along a motorway nothing does, and registration leaves centimetres to decimetres there. A vehicle
cannot jerk that much from sweep to sweep.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

LAG = 10
"""Sweeps after one that are used for it. At 10 sweeps a second they last four times as long as the
smoothing reaches where registration is 5 cm unsure: cube root of 0.05 m / (2 m/s^3) = 0.3 s."""

# Metres/s^3, standard deviations. Along the way a car only drives and brakes. Its roof heaves and
# rolls on the springs as well: 5 mm at 1.5 to 3 Hz are 4 to 33.
_JERK, _SWAY = 2.0, 20.0
_STANDING = 1.0  # metres/s; a slower vehicle may set off in any direction
_NOISE = 0.002  # metres; error of a position beside what its covariance says
_SPEED, _ACCELERATION = 60.0, 10.0  # metres/s, metres/s^2; what is known of them at the start


class State(NamedTuple):
    """Position, velocity and acceleration (9,) at a sweep, and their covariance (9, 9).

    ``predicted`` is what the sweeps before tell, ``mean`` what they and this one tell.
    """

    pose: NDArray[np.float64]  # with the filtered position
    transition: NDArray[np.float64]  # from the sweep before
    predicted: NDArray[np.float64]
    predicted_covariance: NDArray[np.float64]
    mean: NDArray[np.float64]
    covariance: NDArray[np.float64]

    @property
    def velocity(self) -> NDArray[np.float64]:
        """In the world (3,) [m/s]."""
        return self.mean[3:6]


def filtered(
    before: State | None,
    pose: NDArray[np.float64],
    covariance: NDArray[np.float64],
    elapsed: float,
) -> State:
    """One step of a Kalman filter with white jerk; rotations are kept.

    Parameters
    ----------
    before : State, optional
        Of the sweep before; None for the first.
    pose : ndarray of float64, shape (4, 4)
        ``T_world_lidar`` as registered.
    covariance : ndarray of float64, shape (3, 3)
        Of its position [m^2].
    elapsed : float
        Seconds since the sweep before.
    """
    position = pose[:3, 3]
    advance = np.array([[1, elapsed, elapsed**2 / 2], [0, 1, elapsed], [0, 0, 1]])
    transition = np.kron(advance, np.eye(3))
    if before is None:
        predicted = np.concatenate([position, np.zeros(6)])
        spread = np.diag(np.repeat([1.0, _SPEED, _ACCELERATION], 3) ** 2)
        noise = covariance
    else:
        predicted, noise = transition @ before.mean, covariance + _NOISE**2 * np.eye(3)
        of_jerk = np.array([elapsed**3 / 6, elapsed**2 / 2, elapsed])
        spread = transition @ before.covariance @ transition.T
        spread += np.kron(np.outer(of_jerk, of_jerk), _covariance_of_jerk(before.velocity))
    gain = np.linalg.solve(spread[:3, :3] + noise, spread[:3]).T
    mean = predicted + gain @ (position - predicted[:3])
    left = np.eye(9)
    left[:, :3] -= gain
    # Joseph's form keeps the covariance positive.
    after = left @ spread @ left.T + gain @ noise @ gain.T
    pose = pose.copy()
    pose[:3, 3] = mean[:3]
    return State(pose, transition, predicted, spread, mean, after)


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
            yield _smoothed_poses(window)[0]
            window.popleft()
    if window:
        yield from _smoothed_poses(window)


def _smoothed_poses(window: deque[State]) -> list[NDArray[np.float64]]:
    states = list(window)
    means = [states[-1].mean]
    for state, after in zip(states[-2::-1], states[:0:-1], strict=True):
        gain = np.linalg.solve(after.predicted_covariance, after.transition @ state.covariance).T
        means.append(state.mean + gain @ (means[-1] - after.predicted))
    poses = np.array([state.pose for state in states])
    poses[:, :3, 3] = np.array(means[::-1])[:, :3]
    return list(poses)
