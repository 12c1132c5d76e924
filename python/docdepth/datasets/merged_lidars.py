"""Several LiDARs in one cloud, one after the other: where each is, and which returns are its own.

Returns of one LiDAR have neighbours on the same surface, seen from where it is. Returns of two lie
before and behind each other there. So a cloud is cut where that gives more returns neighbours.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from docdepth.geometry.lidar_frame import SensorRig
from docdepth.geometry.scan_mesh import share_in_triangles

Place = tuple[float, float, float]
Cloud = NDArray[np.float32]

_BLOCKS = 32  # into which a cloud is cut at first
_GRID = ((-2, -1, 0, 1, 2), (-1, 0, 1), (-1, 0))  # metres from the best single place: x, y, z
_SAME_BORDER = 1.5  # blocks
_BEST = 8  # places that are tried for two neighbours together
_PER_METRE = 0.003  # of the returns may lack neighbours for a place nearer by
_ONE_LIDAR = 0.002  # of all returns may lack neighbours in one mesh that have some in two
_FINEST = 8  # returns; borders are found to that


class Stretch(NamedTuple):
    """Returns ``begin`` to ``end`` - 1 of a cloud, and how many have neighbours."""

    begin: int
    end: int
    place: Place  # the place in metres from which most have neighbours
    neighbored: float  # returns that have, seen from there
    # (k,): The same of each place that was looked from; an estimate where several parts were joined
    from_places: NDArray[np.float64]


def find_lidars(clouds: Sequence[Cloud], around: Place) -> list[Place]:
    """Places of the LiDARs that clouds were merged of, in the order of their returns.

    A border between two of them is at about the same row of each sweep. Borders between parts of
    what one LiDAR measured are not, if any are found. ``clouds`` are two sweeps as
    :func:`find_stretches` takes them; from ``around`` most returns have neighbours in one mesh.
    """
    first, second = (
        np.array([s.end / len(cloud) for s in find_stretches(cloud, around, _blocks(len(cloud)))])
        for cloud in clouds
    )
    common = [end for end in first if np.abs(second - end).min() < _SAME_BORDER / _BLOCKS]
    borders = [0, *(round(end * len(clouds[0])) for end in common)]
    return [stretch.place for stretch in find_stretches(clouds[0], around, borders)]


def find_stretches(cloud: Cloud, around: Place, borders: Sequence[int]) -> list[Stretch]:
    """Parts of a cloud that were measured from one place each.

    Neighbouring parts are joined as long as their returns have neighbours in one mesh, seen from
    one place, as in two. ``cloud`` (N, 3) has finite points in the order of the file, metres.
    Places around ``around`` are tried. ``borders`` are rows where the parts begin, and N.
    """
    steps = np.array(list(itertools.product(*_GRID)), np.float64)
    places: list[Place] = [(x, y, z) for x, y, z in (steps + around).tolist()]
    distances = np.linalg.norm(steps, axis=1)

    def stretch(begin: int, end: int, counts: NDArray[np.float64], tried: int) -> Stretch:
        values = counts - _PER_METRE * distances * (end - begin)
        chosen = np.argsort(-values, kind="stable")[:tried]
        exact = np.array([_neighbored(cloud, begin, end, places[k]) for k in chosen])
        k = int(np.argmax(exact - _PER_METRE * distances[chosen] * (end - begin)))
        return Stretch(begin, end, places[chosen[k]], float(exact[k]), counts)

    found = []
    for begin, end in itertools.pairwise(borders):
        counts = np.array([_neighbored(cloud, begin, end, place) for place in places])
        found.append(stretch(begin, end, counts, 1))
    joined: dict[tuple[int, int, int], Stretch] = {}
    while len(found) > 1:
        gains = []
        for left, right in itertools.pairwise(found):
            key = (left.begin, left.end, right.end)
            if key not in joined:
                counts = left.from_places + right.from_places
                joined[key] = stretch(left.begin, right.end, counts, _BEST)
            gains.append(joined[key].neighbored - left.neighbored - right.neighbored)
        k = int(np.argmax(gains))
        if gains[k] < -_ONE_LIDAR * len(cloud):
            break
        found[k : k + 2] = [joined[found[k].begin, found[k].end, found[k + 1].end]]
    return found


def lidar_ends(cloud: Cloud, places: Sequence[Place]) -> NDArray[np.intp]:
    """Ascending row behind the last return of each LiDAR, if they lie one after the other; (k,).

    ``cloud`` (N, 3) has points in the order of the file, metres; those that are not finite are no
    returns. ``places`` are those of the LiDARs in this order. The last end is N.
    """
    blocks = _blocks(len(cloud))
    counts = np.array(
        [[_neighbored(cloud, a, b, p) for p in places] for a, b in itertools.pairwise(blocks)]
    )
    first_blocks = np.searchsorted(_in_order(counts), np.arange(len(places)))
    borders = [0, *(blocks[k] for k in first_blocks[1:]), len(cloud)]
    for k in range(1, len(places)):
        borders[k] = _border(cloud, borders[k - 1 : k + 2], places[k - 1], places[k])
    return np.array(borders[1:])


def rig_in_order(places: Sequence[Place], ends: NDArray[np.intp]) -> SensorRig:
    """The rig of a sweep whose LiDARs at ``places`` measured one after the other.

    ``ends`` are those of :func:`lidar_ends`.
    """
    T_lidar_sensor = np.repeat(np.eye(4)[None], len(places), axis=0)
    T_lidar_sensor[:, :3, 3] = places
    counts = np.diff(ends, prepend=0)
    return SensorRig(np.repeat(np.arange(len(places), dtype=np.uint8), counts), T_lidar_sensor)


def _in_order(counts: NDArray[np.float64]) -> NDArray[np.intp]:
    """The ascending column of each row that has the largest sum."""
    rows, columns = counts.shape
    best = np.zeros((rows, columns))
    for m in range(rows):
        best[m] = counts[m]
        if m:
            best[m] += np.maximum.accumulate(best[m - 1])
    chosen = np.zeros(rows, np.intp)
    last = columns - 1
    for m in range(rows - 1, -1, -1):
        last = int(np.argmax(best[m, : last + 1]))
        chosen[m] = last
    return chosen


def _border(cloud: Cloud, borders: Sequence[int], before: Place, after: Place) -> int:
    """Where one LiDAR ends and the next begins, between the first and the last of three borders."""
    low, border, high = borders

    def value(at: int) -> float:
        return _neighbored(cloud, low, at, before) + _neighbored(cloud, at, high, after)

    best, step = value(border), max(len(cloud) // _BLOCKS, _FINEST)
    while step >= _FINEST:
        tried = [at for at in (border - step, border + step) if low <= at <= high]
        values = [value(at) for at in tried]
        if values and max(values) > best:
            best, border = max(values), tried[int(np.argmax(values))]
        else:
            step //= 2
    return border


def _neighbored(cloud: Cloud, begin: int, end: int, place: Place) -> float:
    """Returns of a part of the cloud that have neighbours in its mesh."""
    part = cloud[begin:end]
    if len(part) < 4:
        return 0.0
    return len(part) * share_in_triangles(part, SensorRig.single(place, len(part)))


def _blocks(count: int) -> list[int]:
    return [int(border) for border in np.linspace(0, count, _BLOCKS + 1)]
