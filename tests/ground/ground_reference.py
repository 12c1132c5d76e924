"""Ground growing in plain numpy and scipy, round by round, to compare the core with."""

import numpy as np
from scipy.spatial import cKDTree


def to_world(points, pose, origin):
    x, y, z = points.astype(np.float64).T
    r, t = pose[:3, :3], pose[:3, 3] - origin
    return np.stack([((r[i, 0] * x + r[i, 1] * y) + r[i, 2] * z) + t[i] for i in range(3)], axis=1)


def voxels_of(world, size):
    return np.floor(world / size).astype(np.int64)


def centroids(world, size):
    """Voxel coordinates, sorted, and the mean of each voxel's points, added in their order."""
    cells, voxel = np.unique(voxels_of(world, size), axis=0, return_inverse=True)
    sums = np.zeros((len(cells), 3))
    np.add.at(sums, voxel.ravel(), world)
    return cells, sums / np.bincount(voxel.ravel())[:, None], voxel.ravel()


def lowest(points, position, radius, quantile):
    """Of the points around a position that with this share of the others below it, if any."""
    x, y, z = points.T
    dx, dy = x - position[0], y - position[1]
    inside = np.flatnonzero(dx * dx + dy * dy <= radius * radius)
    if not len(inside):
        return None
    upwards = np.lexsort((y[inside], x[inside], z[inside]))
    return inside[upwards[int(quantile * (len(inside) - 1))]]


def seed(points, position, radius, quantile):
    while (found := lowest(points, position, radius, quantile)) is None:
        radius *= 2
    return found


def neighbours(points, tree, front, k):
    """The k nearest of the front's points (themselves the first); equal distances by x, y, z."""
    near = tree.query(points[front], min(len(points), k + 40))[1].reshape(len(front), -1)
    d = points[near] - points[front][:, None]
    squared = (d[..., 0] * d[..., 0] + d[..., 1] * d[..., 1]) + d[..., 2] * d[..., 2]
    x, y, z = np.moveaxis(points[near], -1, 0)
    return np.take_along_axis(near, np.lexsort((z, y, x, squared), axis=1)[:, :k], axis=1)


def grow(points, seeds, p, stands=False, ground=None):
    """Which points the front reaches, beside those that are ground already."""
    tree = cKDTree(points)
    ground = np.zeros(len(points), dtype=bool) if ground is None else ground.copy()
    seeds = front = np.unique(seeds)
    ground[front] = True
    lines = set()  # steep ones, of which more neighbours tell the plane
    while len(points) >= 3 and (len(front) or lines):
        is_wide = not len(front)
        if is_wide:
            front, lines = np.array(sorted(lines)), set()
        near = neighbours(points, tree, front, 8 * p.neighbors if is_wide else p.neighbors)
        d = points[near] - points[front][:, None]
        centred = d - d.mean(axis=1, keepdims=True)
        spread, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", centred, centred))
        normal = axes[:, :, 0]
        upright = np.abs(normal[:, 2]) >= np.cos(np.radians(p.max_slope_deg))
        is_line = spread[:, 1] <= near.shape[1] * p.plane_distance**2
        if stands and not is_wide:
            lines |= set(front[is_line & ~upright].tolist())
        # The plane of a seed goes through the mean.
        from_plane = np.where(np.isin(front, seeds)[:, None, None], centred, d)
        on_plane = np.abs(np.einsum("nki,ni->nk", from_plane, normal)) < p.plane_distance
        reached = np.unique(near[on_plane & upright[:, None]])
        front = reached[~ground[reached]]
        ground[front] = True
    return ground


def behind_steps(points, ground, p):
    """Low places of cells of a metre with little ground, no more than a step from one beside it."""
    cells = np.floor(points[:, :2]).astype(int)
    found, cell, count = np.unique(cells[ground], axis=0, return_inverse=True, return_counts=True)
    height = np.bincount(cell.ravel(), points[ground, 2]) / count
    heights = {tuple(c): h for c, h, n in zip(found, height, count, strict=True)
               if 2 * n >= p.neighbors}  # fmt: skip
    full = {tuple(c) for c, n in zip(found, count, strict=True) if n >= p.neighbors}
    seeds = set()
    for (x, y), h in heights.items():
        for beside in ((x + i, y + j) for i in (-1, 0, 1) for j in (-1, 0, 1)):
            low = lowest(points, np.add(beside, 0.5), 0.5, p.seed_quantile)
            if beside in full or low is None or ground[low]:
                continue
            if abs(points[low, 2] - h) <= p.step_height:
                seeds.add(low)
    return sorted(seeds)


def beyond_gaps(points, ground, p, lidar):
    """Low places of the next cells with points, away from a LiDAR that stands, and level."""
    cells = np.floor(points[:, :2]).astype(int)
    found, cell, count = np.unique(cells[ground], axis=0, return_inverse=True, return_counts=True)
    height = np.bincount(cell.ravel(), points[ground, 2]) / count
    full = {tuple(c) for c, n in zip(found, count, strict=True) if n >= p.neighbors}
    seeds = set()
    for c, h, n in zip(found, height, count, strict=True):
        way = c + 0.5 - lidar
        for step in np.arange(1, np.linalg.norm(way)) if 2 * n >= p.neighbors else ():
            beyond = np.floor(c + 0.5 + step * way / np.linalg.norm(way))
            low = lowest(points, beyond + 0.5, 0.5, p.seed_quantile)
            if (beyond == c).all() or low is None:
                continue
            if tuple(beyond) not in full and not ground[low] and abs(points[low, 2] - h) <= 0.1:
                seeds.add(low)
            break
    return sorted(seeds)


def label_sweeps(sweeps, poses, p):
    """Ground labels of every sweep, and how many voxels are ground."""
    origin = poses[0][:3, 3]
    world = [to_world(s, T, origin) for s, T in zip(sweeps, poses, strict=True)]
    _, points, voxel = centroids(np.concatenate(world), p.voxel_size)
    radius = p.seed_radius
    stands = np.linalg.norm(np.ptp(poses[:, :3, 3], axis=0)) < 2
    while True:
        seeds = [seed(points, T[:3, 3] - origin, radius, p.seed_quantile) for T in poses]
        ground = grow(points, seeds, p, stands)
        widens = p.seed_quantile > 0 and ground.sum() < 0.01 * len(points)
        if not widens or radius >= 16:
            break
        radius *= 2
    middle = (poses[:, :2, 3].min(axis=0) + poses[:, :2, 3].max(axis=0)) / 2 - origin[:2]

    def more():
        steps = behind_steps(points, ground, p)
        return sorted({*steps, *(beyond_gaps(points, ground, p, middle) if stands else ())})

    while p.step_height and (seeds := more()):
        ground = grow(points, seeds, p, stands, ground)
    ends = np.cumsum([len(s) for s in sweeps])[:-1]
    return np.split(ground[voxel], ends), int(ground.sum())
