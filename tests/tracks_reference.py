"""Objects followed over time in plain numpy, float32, each operation as the core does it."""

import numpy as np

F = np.float32
ZERO = np.zeros(3, F)


def follow(sightings, times, p):
    """For each sweep the first rows of what moves at another time, and boxes on their way.

    Sightings are given as arrays.
    """
    sightings = [objects_of(*arrays) for arrays in sightings]
    found, boxes = [set() for _ in sightings], [[] for _ in sightings]
    for order in (range(len(sightings)), range(len(sightings) - 1, -1, -1)):
        for track in tracks_of(sightings, times, order, p):
            for sweep, first in carried(track, sightings, p):
                found[sweep].add(first)
            for sweep, box in on_its_way(track, times, p):
                boxes[sweep].append(box)
    return [
        (np.array(sorted(rows), np.uint32), np.array(of, F).reshape(-1, 6))
        for rows, of in zip(found, boxes, strict=True)
    ]


def objects_of(numbers, boxes, places):
    ends = np.cumsum(numbers[:, 3]).astype(int)
    return [
        {
            "first": int(n[0]), "points": int(n[1]), "dynamic": int(n[2]),
            "moves": 2 * int(n[2]) >= int(n[1]), "low": box[:3], "high": box[3:], "places": shape,
        }
        for n, box, shape in zip(numbers, boxes, np.split(places, ends[:-1]), strict=True)
    ]  # fmt: skip


def tracks_of(sightings, times, order, p):
    alive, done = [], []
    for sweep in order:
        seen = sightings[sweep]
        free = [norm(o["high"] - o["low"], 2) <= 25 and (o["high"] - o["low"])[2] >= F(0.3)
                for o in seen]  # fmt: skip
        alive.sort(key=lambda track: -len(track["members"]))
        for track in alive:
            dt = times[sweep] - track["time"]
            reach = F(p.track_speed) * F(abs(dt))
            best = (0, None)
            for start in starts(track, seen, free, dt, reach):
                match = match_from(track, seen, free, start, reach)
                best = match if match[0] > best[0] else best
            if best[0]:
                go_on(track, sweep, best[1], best[2], seen, free, times)
        held = [abs(times[sweep] - track["time"]) <= patience(track, p) for track in alive]
        done += [track for track, holds in zip(alive, held, strict=True) if not holds]
        alive = [track for track, holds in zip(alive, held, strict=True) if holds]
        for k, o in enumerate(seen):
            if free[k] and o["moves"] and o["points"] >= 10 and len(o["places"]) >= 5:
                member = (sweep, [k], True, o["low"], o["high"])
                alive.append({"places": o["places"], "time": times[sweep], "velocity": ZERO,
                              "members": [member]})  # fmt: skip
    return done + alive


def patience(track, p):
    stands = len(track["members"]) > 1 and norm(track["velocity"]) < F(0.5)
    known = sum(member[2] for member in track["members"]) >= p.track_sightings
    return (p.track_hold if stands and known else p.track_gap) + 1e-3


def starts(track, seen, free, dt, reach):
    if len(track["members"]) > 1:
        return [track["velocity"] * F(dt), ZERO]
    low, high = track["places"].min(0), track["places"].max(0)
    return [
        most_frequent_shift(track["places"], o["places"], reach)
        for k, o in enumerate(seen)
        if free[k] and o["moves"] and overlap(o["low"], o["high"], low, high, reach)
    ]


def match_from(track, seen, free, start, reach):
    shape = track["places"]
    low, high = shape.min(0), shape.max(0)
    most = (high - low) * F(1.5) + F(0.5)
    near = [
        k
        for k, o in enumerate(seen)
        if free[k] and overlap(o["low"], o["high"], low + start, high + start, F(0.5))
        and (len(track["members"]) > 1 or o["moves"]) and (o["high"] - o["low"] < most).all()
    ]  # fmt: skip
    if not near:
        return 0, None
    shift = refine(shape, np.concatenate([seen[k]["places"] for k in near]), start)
    if shift is None:
        return 0, None
    members = [k for k in near if share_found(seen[k]["places"], -shift, shape) >= F(0.6)]
    if not members:
        return 0, None
    there = np.concatenate([seen[k]["places"] for k in members])
    both = share_found(shape, shift, there) * share_found(there, -shift, shape)
    explained = both / (F(1) + norm(shift) / (F(2) * reach))
    return (explained, shift, members) if explained >= F(0.4) else (0, None)


def go_on(track, sweep, shift, members, seen, free, times):
    velocity = shift / F(times[sweep] - track["time"])
    old = track["velocity"]
    first = len(track["members"]) == 1
    track["velocity"] = velocity if first else F(0.5) * old + F(0.5) * velocity
    track["time"] = times[sweep]
    for k in members:
        free[k] = False
    chosen = [seen[k] for k in members]
    points = sum(o["points"] for o in chosen)
    moves = 2 * sum(o["points"] for o in chosen if o["moves"]) >= points
    low, high = np.min([o["low"] for o in chosen], 0), np.max([o["high"] for o in chosen], 0)
    places, size = np.concatenate([o["places"] for o in chosen]), F(0.15)
    track["places"] = thinned(places, size)
    while len(track["places"]) > 100:
        size = size * F(1.3)
        track["places"] = thinned(places, size)
    track["members"].append((sweep, members, moves, low, high))


def moved(track, p):
    members = track["members"]
    way = [F(0.5) * (m[3] + m[4]) for m in (members[0], members[-1])]
    far = norm(way[1] - way[0], 2) >= F(p.track_distance)
    return far and sum(m[2] for m in members) >= p.track_sightings


def on_its_way(track, times, p):
    """Where it is in each sweep of its life, and a little before and after, unless it stands."""
    if not moved(track, p):
        return
    members = sorted(track["members"], key=lambda m: m[0])
    seen, way = times[[m[0] for m in members]], np.array([F(0.5) * (m[3] + m[4]) for m in members])
    way[:, 2] = 0

    def at(t):
        k = np.searchsorted(seen, t)
        if k == 0:
            a, b, start = 0, min(4, len(seen)) - 1, 0
        elif k == len(seen):
            a, b, start = len(seen) - min(4, len(seen)), len(seen) - 1, len(seen) - 1
        else:
            a, b, start = k - 1, k, k
        return way[start] + F((t - seen[start]) / (seen[b] - seen[a])) * (way[b] - way[a])

    for sweep, t in enumerate(times):
        if not seen[0] - p.track_gap - 1e-3 <= t <= seen[-1] + p.track_gap + 1e-3:
            continue
        near = np.flatnonzero(np.abs(seen - t) <= p.track_window + 1e-3)
        if len(near) and norm(at(t + 0.3) - at(t - 0.3), 2) / F(0.6) >= F(0.5):
            low = np.min([members[k][3] + (at(t) - way[k]) for k in near], 0)
            high = np.max([members[k][4] + (at(t) - way[k]) for k in near], 0)
            yield sweep, [*low, *high]


def carried(track, sightings, p):
    members = track["members"]
    if not moved(track, p):
        return
    for sweep, objects, _, low, high in members:
        away = [
            other[0]
            for other in members
            if ((other[3] > high + F(0.1)) | (other[4] < low - F(0.1)))[:2].any()
        ]
        witnesses = sorted(away, key=lambda other: abs(other - sweep))[::5][:4]
        for k in objects if witnesses else []:
            o = sightings[sweep][k]
            if o["dynamic"] < o["points"] and all(
                share_taken(o["places"], sightings[w]) < F(0.4) for w in witnesses
            ):
                yield sweep, o["first"]


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
    cubes = np.floor(points / size).astype(int)
    _, first, cube = np.unique(cubes, axis=0, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(first))[cube.ravel()]
    sums, counts = np.zeros((len(first), 3), F), np.zeros(len(first), F)
    np.add.at(sums, rank, points)
    np.add.at(counts, rank, F(1))
    return sums / counts[:, None]
