"""Boxes around a LiDAR that drives ahead, and what trackers are given of them."""

from functools import partial
from typing import NamedTuple

import numpy as np

import docdepth._core as _core
from docdepth.dynamics.tracking import TrackedSweep, track_objects
from docdepth.geometry.scan_mesh import ScanMesh
from docdepth.geometry.track import Track
from lidar_rays import scan_rays
from motion import straight

MEMORY = 30  # sweeps: for so long key frames remember a place
NOISE = 0.1  # metres: a return so far outside a thing may be its own
CAR, PERSON, POLE, WALL = (4.2, 1.8, 1.5), (0.6, 0.6, 1.7), (0.3, 0.3, 2.0), (12.0, 0.3, 2.5)
LORRY = (18.0, 2.5, 3.2)


ELEVATIONS, AZIMUTHS = np.arange(-25, 3, 1.0), np.arange(-180, 180, 0.3)
RAYS = scan_rays(np.radians(ELEVATIONS), np.radians(AZIMUTHS)).reshape(-1, 3)


class Thing:
    """A box, its position in each sweep (None: unseen), and the sweeps that vote dynamic.

    Positions are (x, y) or (x, y, z) of its middle. ``seen`` chooses among its returns, in its own
    frame; all if None. ``remembered``: votes tell in order of time that it came or left. ``porous``
    is the share of its places that were hit and passed in turn.
    """

    def __init__(self, size, at, dynamic=(), seen=None, remembered=True, porous=0.0):
        self.at, self.dynamic, self.seen, self.porous = at, set(dynamic), seen, porous
        self.box, self.size, self.remembered = size, float(np.hypot(*size[:2])), remembered

    def stay(self, i, count):
        """Whether its place was free within 3 s, and the sweeps that found it occupied then.

        None: of each point the first and the last one in which the thing was there.
        """
        here = np.array(self.at(i)[:2])
        off = [np.linalg.norm(self.at(j)[:2] - here) for j in self.near(i, count)]
        return self.remembered and max(off) > self.size, None, None

    def near(self, i, count):
        """The sweeps around one that saw the thing."""
        near = range(max(i - MEMORY, 0), min(i + MEMORY + 1, count))
        return [j for j in near if self.at(j) is not None]

    def stays(self, i, count, places):
        """What :meth:`stay` says of each of its points in a sweep, (n, 3)."""
        left, first, last = self.stay(i, count)
        if first is None:
            middles = np.array([self.middle(j) for j in self.near(i, count)])
            off = np.abs(places[None] - middles[:, None])
            there = (off <= 0.5 * np.array(self.box) + NOISE).all(2)
            first, last = there.argmax(0), len(there) - 1 - there[::-1].argmax(0)
            first, last = np.array(self.near(i, count))[[first, last]]
        return np.stack(np.broadcast_arrays(left, first, last, places[:, 0])[:3], 1)

    def middle(self, i):
        place = self.at(i)
        return np.array((*place[:2], *(place[2:] or (0.8,))))

    def ranges(self, i, lidar):
        """Where each ray of a sweep meets it."""
        if self.at(i) is None:
            return np.full(len(RAYS), np.inf)
        middle = self.middle(i) - lidar
        ranges = ranges_of(self.box, middle)
        if self.seen is not None:
            hit = np.flatnonzero(np.isfinite(ranges))
            unseen = ~self.seen(i, RAYS[hit] * ranges[hit, None] - middle)
            ranges[hit[unseen]] = np.inf
        return ranges


def ranges_of(size, middle, turn=0.0):
    """Where each ray of a LiDAR at the origin meets a box; infinite where it does not."""
    rotation = np.array([[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0],
                         [0, 0, 1]])  # fmt: skip
    # Most rays miss even the sphere around the box.
    middle = np.broadcast_to(middle, RAYS.shape)
    nearest = np.einsum("ij,ij->i", middle, middle) - np.dot(size, size) / 4
    ahead = np.einsum("ij,ij->i", RAYS, middle)
    towards = np.flatnonzero((nearest <= 0) | ((ahead > 0) & (ahead**2 > nearest)))
    start, along = rotation @ -middle[towards].T, rotation @ RAYS[towards].T
    half = np.array(size)[:, None] / 2
    with np.errstate(divide="ignore"):
        a, b = ((end - start) / along for end in (-half, half))
    near, far = np.minimum(a, b).max(0), np.maximum(a, b).min(0)
    ranges = np.full(len(RAYS), np.inf)
    ranges[towards] = np.where((near < far) & (near > 0), near, np.inf)
    return ranges


def measured(ranges, rays, rng):
    """The returns of some rays, with noise."""
    noise = rng.normal(0, 0.01, np.count_nonzero(rays))
    return (RAYS[rays] * (ranges[rays] + noise)[:, None]).astype(np.float32)


def detections_of(things, count, seed=0, joined=None, drive=None):
    """Detections from a vehicle that drives ahead, and in each sweep the first row of each thing.

    ``joined`` maps a pair of things to the sweeps in which both are one object.
    """
    rng = np.random.default_rng(seed)
    detections, rows = [], []
    for i, T in enumerate((drive or drive_of(count)).poses[:count]):
        points, about, stays, firsts, wholes, before = [], [], [], {}, {}, 0
        ranges = np.array([thing.ranges(i, T[:3, 3]) for thing in things])
        nearest = np.where(np.isfinite(ranges).any(0), ranges.argmin(0), -1)
        for k, thing in enumerate(things):
            own = nearest == k
            if not own.any():
                continue
            firsts[k] = before
            seen = measured(ranges[k], own, rng)
            whole = next((wholes[a] for (a, b), sweeps in (joined or {}).items()
                          if b == k and a in wholes and i in sweeps), firsts[k])  # fmt: skip
            wholes[k] = whole
            porous = np.arange(len(seen)) < thing.porous * len(seen)
            points.append(seen)
            about.append(np.stack(np.broadcast_arrays(whole, i in thing.dynamic, porous)))
            stays.append(thing.stays(i, count, seen + T[:3, 3]))
            before += len(seen)
        cloud = np.concatenate([np.zeros((0, 3), np.float32), *points])
        none = np.zeros(len(cloud), bool)
        objects, flags, porous = np.concatenate([np.zeros((3, 0), np.int64), *about], 1)
        objects, flags = objects.astype(np.uint32), flags.astype(bool)
        once, *ends = np.concatenate([np.zeros((0, 3)), *stays]).astype(np.int32).T
        seen = (once > 0, porous.astype(bool), *(np.ascontiguousarray(end) for end in ends))
        mesh = ScanMesh(cloud).core
        detections.append(_core.Detections(cloud, none, objects, flags, *seen, mesh, T))
        rows.append(firsts)
    return detections, rows


def one_object(cloud, sweep, T=None, ground=None, times=None):
    """Detections of a sweep in which all points but those of the ground are of a moving object."""
    ground = np.zeros(len(cloud), bool) if ground is None else ground
    objects = np.where(ground, np.arange(len(cloud)), 0).astype(np.uint32)
    ends, none = np.full(len(cloud), sweep, np.int32), np.zeros(len(cloud), bool)
    mesh, T = ScanMesh(cloud).core, np.eye(4) if T is None else T
    seen = ~ground, none, ends, ends
    return _core.Detections(cloud, ground, objects, ~ground, *seen, mesh, T, times)


def with_options(monkeypatch, **changed):
    """Classify objects with other constants of the core."""
    options = _core.ClassificationOptions()
    for name, value in changed.items():
        setattr(options, name, value)
    chosen = partial(_core.classify_objects, options=options)
    monkeypatch.setattr(_core, "classify_objects", chosen)


def drive_of(count):
    """The trajectory of the vehicle."""
    return straight(count, 0.8, 1.7)


class Tracking(NamedTuple):
    """What tracks found in each sweep, and the tracks."""

    sweeps: list[TrackedSweep]
    tracks: list[Track]


def tracking_of(detections, trajectory, threads=0):
    """Track the objects of detections that are all in memory."""
    sweeps = []
    tracks = track_objects(detections.__getitem__, trajectory, sweeps.append, threads)
    return Tracking(sweeps, tracks)


def tracks_of(things, count, drive=None, **more):
    """The tracks of some things."""
    detections, _ = detections_of(things, count, drive=drive, **more)
    return tracking_of(detections, drive or drive_of(count)).tracks


def tracked(things, count, **more):
    """For each thing the sweeps in which only tracks make it dynamic."""
    detections, rows = detections_of(things, count, **more)
    found = tracking_of(detections, drive_of(count)).sweeps
    return [
        [i for i in range(count) if k in rows[i] and rows[i][k] in found[i].dynamic]
        for k in range(len(things))
    ]


def waits(start, leaves, acceleration=2.0):
    """Position of a thing that stands until a sweep and then drives off along x."""
    return lambda i: (start[0] + 0.5 * acceleration * (0.1 * max(i - leaves, 0)) ** 2, start[1])


def passes(y, speed=8.0, start=-10.0):
    return lambda i: (start + 0.1 * speed * i, y)


def parked_at(x, y):
    return lambda i: (x, y)


def rosette(seed, size, share):
    """``seen`` of a thing: this share of its cells of 60 cm, drawn anew in each sweep."""

    def cells(i, points):
        count = np.ceil(np.array(size) / 0.6).astype(int) + 1
        drawn = np.random.default_rng([seed, i]).random(count) < share
        return drawn[tuple(np.floor((points + np.array(size) / 2) / 0.6).astype(int).T)]

    return cells
