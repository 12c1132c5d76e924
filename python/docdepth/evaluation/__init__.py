"""How good labels and depth are, by the protocols that papers use, each named with its figures.

Shares of points and pixels (SA, DA, density, ...) are in percent, precision, F1 and IoU in 0..1,
as the literature prints them. What is undefined (no moving point, no pixel) is NaN, not zero.
"""

from docdepth.evaluation.depth import DepthEvaluation, DepthResult
from docdepth.evaluation.depth_metrics import DepthErrors, RegionErrors
from docdepth.evaluation.labels import (
    LabelCounts,
    LabelEvaluation,
    LabelResult,
    ignored,
    moving,
)
from docdepth.evaluation.pixels import depth_edges, fill_background
from docdepth.evaluation.static_map import (
    MapEvaluation,
    MapResult,
    PreservationRejection,
    nearest_neighbor_protocol,
    voxel_protocol,
)
from docdepth.evaluation.tables import Table

__all__ = [
    "DepthErrors",
    "DepthEvaluation",
    "DepthResult",
    "LabelCounts",
    "LabelEvaluation",
    "LabelResult",
    "MapEvaluation",
    "MapResult",
    "PreservationRejection",
    "RegionErrors",
    "Table",
    "depth_edges",
    "fill_background",
    "ignored",
    "moving",
    "nearest_neighbor_protocol",
    "voxel_protocol",
]
