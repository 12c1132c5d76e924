"""Metrics of labels and depth maps, by the protocols of the literature.

Labels
    static accuracy SA, dynamic accuracy DA, associated accuracy AA, F1, precision and IoU of the
    dynamic class, point by point (the paper's evaluation of labels).
Depth
    the error metrics of KITTI's development kit, density, and errors by range and region.
Trajectories
    absolute and relative pose error (evo), drift (KITTI's odometry benchmark).
Tracks
    share of moving objects found, points with the right instance, HOTA, CLEAR, and errors of boxes.

Shares of points and pixels (SA, DA, density, ...) are percentages; precision, F1 and IoU lie in
0..1. A metric without a point or pixel to compute it from is NaN, not zero.
"""

from docdepth.evaluation.depth import DepthEvaluation, DepthResult
from docdepth.evaluation.depth_metrics import DepthErrors, RegionErrors
from docdepth.evaluation.label_counts import LabelCounts, ignored, moving
from docdepth.evaluation.labels import LabelEvaluation, LabelResult
from docdepth.evaluation.pixels import depth_edges, fill_background
from docdepth.evaluation.tables import Table
from docdepth.evaluation.tracks import TrackEvaluation, TrackResult

__all__ = [
    "DepthErrors",
    "DepthEvaluation",
    "DepthResult",
    "LabelCounts",
    "LabelEvaluation",
    "LabelResult",
    "RegionErrors",
    "Table",
    "TrackEvaluation",
    "TrackResult",
    "depth_edges",
    "fill_background",
    "ignored",
    "moving",
]
