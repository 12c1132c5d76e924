"""Tracking in plain numpy, float32, each operation as the core does it."""

from itertools import compress
from types import SimpleNamespace

import numpy as np

F = np.float32
ZERO = np.zeros(3, F)

TRACKS = {
    "min_detections": 3, "min_distance": 1.0, "max_speed": 40.0, "max_gap": 1.0,
    "max_gap_standing": 5.0, "window": 0.3,
}  # fmt: skip


def track_objects(detections, times, **others):
    """For each sweep the first rows of what moves at another time, and boxes where it is predicted.

    Detections are given as arrays.
    """
    p = SimpleNamespace(**TRACKS | others)
    detections = [objects_of(*arrays) for arrays in detections]
    found, boxes = [set() for _ in detections], [[] for _ in detections]
    for order in (range(len(detections)), range(len(detections) - 1, -1, -1)):
        for track in tracks_of(detections, times, order, p):
            objects, predicted = motion_of(track, detections, times, p)
            for sweep, first in objects:
                found[sweep].add(first)
            for sweep, box in predicted:
                boxes[sweep].append(box)
    return [
        (np.array(sorted(rows), np.uint32), np.array(of, F).reshape(-1, 6))
        for rows, of in zip(found, boxes, strict=True)
    ]


def dynamic_voxels(detections, tracked, times):
    """For each sweep the voxels of 1 m that hold dynamic objects up to 0.3 s away, by key."""
    detections = [objects_of(*arrays) for arrays in detections]
    result = []
    for t in times:
        voxels, moves = [], []
        for seen, first, time in zip(detections, tracked, times, strict=True):
            for o in seen if 0 < abs(time - t) <= 0.3 + 1e-3 else ():
                voxels.append(np.floor(o["places"]).astype(np.int64) + (1 << 20))
                moves += [o["moves"] or o["first"] in first] * len(o["places"])
        voxels = np.concatenate(voxels) if voxels else np.zeros((0, 3), np.int64)
        keys, which = np.unique(voxels @ [1 << 42, 1 << 21, 1], return_inverse=True)
        moving = np.bincount(which, moves, len(keys)).astype(F)
        enough = moving > F(0.6) * np.bincount(which, minlength=len(keys)).astype(F)
        result.append(keys[(moving >= 3) & enough])
    return result


def objects_of(numbers, boxes, places):
    ends = np.cumsum(numbers[:, 3]).astype(int)
    return [
        {
            "first": int(n[0]), "points": int(n[1]), "dynamic": int(n[2]),
            "moves": 2 * int(n[2]) >= int(n[1]), "low": box[:3], "high": box[3:], "places": shape,
        }
        for n, box, shape in zip(numbers, boxes, np.split(places, ends[:-1]), strict=True)
    ]  # fmt: skip


def tracks_of(detections, times, order, p):
    alive, done = [], []
    for sweep in order:
        seen = detections[sweep]
        free = [norm(o["high"] - o["low"], 2) <= 25 and (o["high"] - o["low"])[2] >= F(0.15)
                for o in seen]  # fmt: skip
        alive.sort(key=lambda track: -len(track["members"]))
        for track in alive:
            dt = times[sweep] - track["time"]
            reach = F(p.max_speed) * F(abs(dt))
            best = (0, None)
            for shape in (track["places"], track["last"]):
                if best[0]:
                    break
                for start in starts_of(track, shape, seen, free, dt, reach):
                    match = match_from(track, shape, seen, free, start, reach)
                    best = match if match[0] > best[0] else best
            if best[0]:
                go_on(track, sweep, best[1], best[2], seen, free, times)
        held = [abs(times[sweep] - track["time"]) <= patience(track, p) for track in alive]
        done += [track for track, holds in zip(alive, held, strict=True) if not holds]
        alive = [track for track, holds in zip(alive, held, strict=True) if holds]
        for k, o in enumerate(seen):
            if free[k] and o["moves"] and len(o["places"]) >= 5:
                member = (sweep, [k], True, o["low"], o["high"])
                alive.append({"places": o["places"], "last": o["places"], "time": times[sweep],
                              "velocity": ZERO, "members": [member], "shown": [o["dynamic"]],
                              "largest": o["high"] - o["low"]})  # fmt: skip
    return done + alive


def patience(track, p):
    stands = len(track["members"]) > 1 and norm(track["velocity"]) < F(0.5)
    known = sum(member[2] for member in track["members"]) >= p.min_detections
    return (p.max_gap_standing if stands and known else p.max_gap) + 1e-3


def starts_of(track, shape, seen, free, dt, reach):
    if len(track["members"]) > 1:
        return [track["velocity"] * F(dt), ZERO]
    low, high = shape.min(0), shape.max(0)
    return [
        most_frequent_shift(shape, o["places"], reach)
        for k, o in enumerate(seen)
        if free[k] and o["moves"] and overlap(o["low"], o["high"], low, high, reach)
    ]


def match_from(track, shape, seen, free, start, reach):
    low, high = shape.min(0), shape.max(0)
    near = [
        k
        for k, o in enumerate(seen)
        if free[k] and overlap(o["low"], o["high"], low + start, high + start, F(0.5))
        and (len(track["members"]) > 1 or o["moves"]) and could_be(o["high"] - o["low"], high - low)
    ]  # fmt: skip
    if not near:
        return 0, None
    shift = refine(shape, np.concatenate([seen[k]["places"] for k in near]), start)
    if shift is None:
        return 0, None
    members = [k for k in near if share_found(seen[k]["places"], -shift, shape) >= F(0.6)]
    if not members:
        return 0, None
    low, high, largest = whole_of(track, [seen[k] for k in members])
    if not could_be(high - low, largest):
        return 0, None
    there = np.concatenate([seen[k]["places"] for k in members])
    again = min(F(1), F(2) * share_found(shape, shift, there))
    explained = again * share_found(there, -shift, shape) / (F(1) + norm(shift) / (F(2) * reach))
    return (explained, shift, members) if explained >= F(0.4) else (0, None)


def whole_of(track, objects):
    low, high = np.min([o["low"] for o in objects], 0), np.max([o["high"] for o in objects], 0)
    return low, high, np.max([track["largest"], *(o["high"] - o["low"] for o in objects)], 0)


def could_be(size, known):
    return (size < known * F(1.5) + F(0.5)).all()


def go_on(track, sweep, shift, members, seen, free, times):
    velocity = shift / F(times[sweep] - track["time"])
    old = track["velocity"]
    first = len(track["members"]) == 1
    track["velocity"] = velocity if first else F(0.5) * old + F(0.5) * velocity
    track["time"] = times[sweep]
    for k in members:
        free[k] = False
    chosen = [seen[k] for k in members]
    track["shown"].append(sum(o["dynamic"] for o in chosen))
    points = sum(o["points"] for o in chosen)
    moves = 2 * sum(o["points"] for o in chosen if o["moves"]) >= points
    low, high, track["largest"] = whole_of(track, chosen)
    last, size = np.concatenate([o["places"] for o in chosen]), F(0.15)
    places = np.concatenate([track["last"] + shift, last])
    track["last"] = last
    track["places"] = thinned(places, size)
    while len(track["places"]) > 100:
        size = size * F(1.3)
        track["places"] = thinned(places, size)
    track["members"].append((sweep, members, moves, low, high))


def moved(track, p):
    members, moving = track["members"], [m for m in track["members"] if m[2]]
    first, last, last_moving = (
        F(0.5) * (m[3] + m[4]) for m in (members[0], members[-1], moving[-1])
    )
    far = norm(last - first, 2) >= F(p.min_distance)
    by_votes = norm(last_moving - first, 2) >= F(0.3) * F(p.min_distance)
    return far and by_votes and len(moving) >= p.min_detections


def motion_of(track, detections, times, p):
    """Objects (sweep, first row) and boxes (sweep, low and high) of a track that moved."""
    if not moved(track, p):
        return [], []
    members = sorted(track["members"], key=lambda m: m[0])
    seen, count = times[[m[0] for m in members]], len(members)
    middle = np.array([F(0.5) * (m[3] + m[4]) for m in members])
    middle[:, 2] = 0

    def velocity(t):
        few = min(3, count // 2)
        k = min(max(np.searchsorted(seen, t), few), count - few)
        moved = (middle[k : k + few] - middle[k - few : k]).sum(0)
        return moved / F((seen[k : k + few] - seen[k - few : k]).sum())

    def box(t):
        v, stands = velocity(t), norm(velocity(t), 2) < F(0.5)
        far = abs(seen - t)
        first = far.argmin()
        near = far <= p.window * (3 if stands else 1) + 1e-3
        near[first] = True
        shift = [v * F(0 if stands else t - other) for other in seen]
        low = np.array([m[3] + s for m, s in zip(members, shift, strict=True)])
        high = np.array([m[4] + s for m, s in zip(members, shift, strict=True)])
        sizes = np.array([m[4] - m[3] for m in compress(members, near)])
        whole = low[near].min(0), high[near].max(0)
        if could_be(whole[1] - whole[0], sizes.max(0)):
            return whole
        return low[first], high[first]

    standing = [norm(velocity(t), 2) < F(0.5) for t in seen]
    boxes = [box(t) if s else m[3:5] for t, s, m in zip(seen, standing, members, strict=True)]

    def free(places, sweep):
        from_above = places[:, :2]
        left = [
            places[((from_above < low[:2] - F(0.1)) | (from_above > high[:2] + F(0.1))).any(1)]
            for low, high in boxes
        ]
        away = [k for k in range(count) if len(left[k]) >= 0.7 * len(places)]
        asked = sorted(away, key=lambda k: abs(members[k][0] - sweep))[:20:2]
        taken = [share_taken(left[k], detections[members[k][0]]) * F(len(left[k])) for k in asked]
        return len(away) > 0 and max(taken) < F(0.4) * F(len(places))

    objects, predicted = [], []
    for sweep, t in enumerate(times):
        nearest = min(max(t, seen[0]), seen[-1])
        holds = norm(velocity(nearest), 2) < F(0.5)
        if abs(t - nearest) > (p.max_gap_standing if holds else p.max_gap) + 1e-3:
            continue
        speed, (low, high) = norm(velocity(t), 2), box(t)
        own = [k for m in members if m[0] == sweep for k in m[1]]
        for k, o in enumerate(detections[sweep]):
            inside = (o["low"] >= low - F(0.5)).all() and (o["high"] <= high + F(0.5)).all()
            there = inside and o["high"][2] >= low[2] + F(0.15) and speed < F(2)
            if o["dynamic"] == o["points"] or norm(o["high"] - o["low"], 2) < F(0.3):
                continue
            if o["points"] - o["dynamic"] > max(*track["shown"], sum(track["shown"]) // 8):
                continue
            if (there or k in own) and free(o["places"], sweep):
                objects.append((sweep, o["first"]))
        if speed >= F(0.5):
            predicted.append((sweep, [*low, *high]))
    return objects, predicted


def share_taken(places, seen):
    there = [o["places"] for o in seen if not o["moves"]]
    return share_found(places, ZERO, np.concatenate(there), 0.25) if there else F(0)


def overlap(low, high, other_low, other_high, margin):
    return ((low <= other_high + margin) & (other_low <= high + margin)).all()


def norm(v, axes=3):
    x, y, z = v[0] * v[0], v[1] * v[1], v[2] * v[2]
    return np.sqrt(x + y if axes == 2 else x + (y + z))


def nearest(places, others):
    d = others[None] - places[:, None]
    d = d * d
    squared = d[..., 0] + (d[..., 1] + d[..., 2])
    k = squared.argmin(1)
    return squared[np.arange(len(places)), k], k


def share_found(places, shift, others, distance=0.3):
    distance = F(distance)
    return F((nearest(places + shift, others)[0] < distance * distance).sum()) / F(len(places))


def refine(a, b, shift):
    for radius in np.array([0.6, 0.4, 0.3, 0.3, 0.3], F):
        moved = a + shift
        squared, k = nearest(moved, b)
        near = squared <= radius * radius
        if not near.any():
            return None
        sums = np.cumsum((b[k] - moved)[near], axis=0, dtype=F)[-1] / F(near.sum())
        shift = shift + np.array([sums[0], sums[1], 0], F)
    return shift


def most_frequent_shift(a, b, reach):
    d = (b[None] - a[:, None]).reshape(-1, 3)
    d = d[(abs(d[:, 2]) <= F(0.2)) & (abs(d[:, :2]) <= reach).all(1)]
    side = 2 * int(np.ceil(reach / F(0.2))) + 3
    bins = d[:, :2] / F(0.2)
    bins = (side // 2 + np.sign(bins) * np.floor(abs(bins) + F(0.5))).astype(int)
    counts = np.zeros((side, side), int)
    np.add.at(counts, tuple(bins.T), 1)
    around = sum(
        counts[1 + i : side - 1 + i, 1 + j : side - 1 + j] for i in (-1, 0, 1) for j in (-1, 0, 1)
    )
    u, v = np.unravel_index(around.argmax(), around.shape)
    return np.array([F(u + 1 - side // 2) * F(0.2), F(v + 1 - side // 2) * F(0.2), 0], F)


def thinned(points, size):
    voxels = np.floor(points / size).astype(int)
    _, first, cube = np.unique(voxels, axis=0, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(first))[cube.ravel()]
    sums, counts = np.zeros((len(first), 3), F), np.zeros(len(first), F)
    np.add.at(sums, rank, points)
    np.add.at(counts, rank, F(1))
    return sums / counts[:, None]
