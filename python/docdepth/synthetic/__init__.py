"""Synthetic drives with exact ground truth: scenes, LiDAR models and a camera."""

from docdepth.synthetic.actors import Actor, Pace, Part, Path
from docdepth.synthetic.drive import Drive, TrueSweep, kitti_rig
from docdepth.synthetic.mesh import Mesh, Paint, box, pose_of
from docdepth.synthetic.photo import View
from docdepth.synthetic.scenes import SCENES, scene
from docdepth.synthetic.sensors import Sensor, sensor, sensors
from docdepth.synthetic.street import Scene
from docdepth.synthetic.writer import write_drive

__all__ = [
    "SCENES",
    "Actor",
    "Drive",
    "Mesh",
    "Pace",
    "Paint",
    "Part",
    "Path",
    "Scene",
    "Sensor",
    "TrueSweep",
    "View",
    "box",
    "kitti_rig",
    "pose_of",
    "scene",
    "sensor",
    "sensors",
    "write_drive",
]
