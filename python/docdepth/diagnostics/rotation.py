"""Times of points by the rotation of the LiDAR, for recordings that have none."""

from __future__ import annotations

from dataclasses import replace

from docdepth.datasets.base import Dataset
from docdepth.datasets.point_times import SHARE_BEFORE, Instant
from docdepth.errors import Finding, OdometryError
from docdepth.geometry.turn import Turn
from docdepth.odometry.skew import find_skew


def is_lone_lidar(recording: Dataset) -> bool:
    """Whether a recording is a folder of clouds of one LiDAR, which may be of any kind."""
    return recording.name == "folder" and len(recording.lidars) == 1


def lacks_times(recording: Dataset) -> bool:
    """Whether points of such a folder have no times, which their rotation may tell."""
    if not is_lone_lidar(recording):
        return False
    first = recording.sweep(0)
    return first.relative_time is None and not first.motion_compensated


def find_rotation(
    recording: Dataset, stamp: Instant | None = None
) -> tuple[Turn | None, list[Finding]]:
    """How the LiDAR turns, if its sweeps are as measured, and what tells it.

    Parameters
    ----------
    recording : Dataset
        Its z is up. One that is said to be motion compensated is doubted.
    stamp : {"start", "middle", "end"}, optional
        Which instant of a sweep its time is. If it is not known the middle, which is least wrong.

    Returns
    -------
    turn : Turn or None
        None if the sweeps are not, or cannot be told to be, as measured.
    found : list of Finding
        Empty of a LiDAR that does not spin, or hardly moves.
    """
    said = recording.sweep(0).motion_compensated
    try:
        skew = find_skew(recording)
    except OdometryError:  # which tells nothing of the times
        return None, []
    if skew is None:
        return None, []
    turn = replace(skew.turn, before_stamp=SHARE_BEFORE[stamp or "middle"])
    where, figures = str(recording.path), skew.figures()
    if skew.state == "measured" and said:
        text = f"docdepth.yaml says motion_compensated: true, but {figures}: they are as measured"
        remedy = "say motion_compensated: false"
        return turn, [Finding("not-compensated", where, text, remedy)]
    if skew.state == "measured":
        text = f"points have no times, and sweeps are as measured: {figures}; these times are taken"
        remedy = "if they are deskewed already, say motion_compensated: true in docdepth.yaml"
        return turn, [Finding("times-by-rotation", where, text, remedy)]
    if said:
        return None, []
    if skew.state == "compensated":
        text = f"points have no times, and sweeps are taken as motion compensated: {figures}"
        remedy = "say motion_compensated: true in docdepth.yaml"
        return None, [Finding("taken-as-compensated", where, text, remedy)]
    text = f"points have no times, and it is not clear whether sweeps are as measured: {figures}"
    remedy = "say motion_compensated in docdepth.yaml, and bring times of points if you can"
    return None, [Finding("skew-unknown", where, text, remedy)]
