"""Dynamic voxels in plain numpy, float32, each operation as the core does it."""

import numpy as np

F = np.float32


def dynamic_voxels(detections, tracked, times):
    """For each sweep the voxels of 1 m that hold dynamic objects up to 0.3 s away, by key."""
    detections = [dynamic_objects(*arrays) for arrays in detections]
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


def dynamic_objects(rows, samples, _borders):
    ends = np.cumsum(rows["samples"]).astype(int)
    return [
        {
            "first": int(row["first"]),
            "moves": 2 * int(row["dynamic_points"]) >= int(row["points"]),
            "places": places,
        }
        for row, places in zip(rows, np.split(samples["point"], ends[:-1]), strict=True)
    ]
