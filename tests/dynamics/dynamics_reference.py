"""Voting and objects in plain numpy, written from their description alone.

Algorithm 1 with a range image, and the vote of a key frame's surface.
"""

from types import SimpleNamespace

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from docdepth.geometry.scan_mesh import ScanMesh
from lidar_rays import TURN, directions

EMPTY = np.float32(np.inf)

OBJECTS = {
    "cluster_distance": 0.3, "cluster_distance_growth": 0.05, "min_cluster_size": 6,
    "neighbor_radius": 1.0, "clear_votes": 2, "min_object_points": 10,
    "dynamic_share": 0.5, "min_dynamic_share": 0.1, "min_object_width": 1.5,
    "min_object_height": 0.3, "observed_free_share": 0.6, "occupied_once_share": 1 / 3,
    "observed_free_votes": 2, "max_static_ratio": 8, "isolated_votes": 2,
}  # fmt: skip


def reference_move(points, T_world_query, T_world_key):
    """Float32 coordinates in the key frame, one rounded operation at a time."""
    a, b = T_world_key[:3, :3], T_world_query[:3, :3]
    shift = T_world_query[:3, 3] - T_world_key[:3, 3]
    rotation = np.array(
        [[(a[0, i] * b[0, j] + a[1, i] * b[1, j]) + a[2, i] * b[2, j] for j in range(3)]
         for i in range(3)]
    ).astype(np.float32)  # fmt: skip
    offset = np.array(
        [(a[0, i] * shift[0] + a[1, i] * shift[1]) + a[2, i] * shift[2] for i in range(3)]
    ).astype(np.float32)
    x, y, z = points.T
    return [
        ((row[0] * x + row[1] * y) + row[2] * z) + t
        for row, t in zip(rotation, offset, strict=True)
    ]


def reference_pixels(x, y, z, columns):
    pixel = 2 * np.pi / columns
    rho = np.sqrt((x * x + y * y) + z * z)
    assert rho.dtype == np.float32
    cosine = np.clip(z.astype(np.float64) / rho.astype(np.float64), -1, 1)
    theta = -np.arctan2(y.astype(np.float64), x.astype(np.float64))
    row = np.floor(np.arccos(cosine) / pixel).astype(int)
    return rho, row, np.floor((np.pi + theta) / pixel).astype(int) % columns


def reference_image(points, ground, columns):
    returns = points.any(axis=1)
    points, ground = points[returns], ground[returns]
    rho, row, column = reference_pixels(*points.T, columns)
    image = np.full((columns // 2 + 1, columns), EMPTY)
    image_ground = np.zeros(image.shape, bool)
    order = np.argsort(rho, kind="stable")
    _, first = np.unique((row * columns + column)[order], return_index=True)
    nearest = order[first]
    image[row[nearest], column[nearest]] = rho[nearest]
    image_ground[row[nearest], column[nearest]] = ground[nearest]
    return image, image_ground


def reference_vote(points, ground, T_query, key_sweeps, key_grounds, key_poses, p):
    static, dynamic = np.zeros((2, len(points)), np.uint16)
    voted_on = points.any(axis=1)
    if p.vote_model == "range_image":
        voted_on &= ~ground
    for sweep, sweep_ground, T_key in zip(key_sweeps, key_grounds, key_poses, strict=True):
        moved = reference_move(points, T_query, T_key)
        if p.vote_model == "range_image":
            outcome = vote_by_range_image(moved, sweep, sweep_ground, p)
        else:
            outcome = vote_by_surface(moved, ground, sweep, sweep_ground, p)
        static += (outcome == "static") & voted_on
        dynamic += (outcome == "dynamic") & voted_on
    return static, dynamic


def vote_by_range_image(query, sweep, sweep_ground, p):
    columns = round(360 / p.resolution_deg)
    half = p.window // 2
    image, image_ground = reference_image(sweep, sweep_ground, columns)
    image = np.pad(image, ((half, half), (0, 0)), constant_values=EMPTY)
    rho, row, column = reference_pixels(*query, columns)
    centre_ground = image_ground[row, column]
    tau = np.where(centre_ground, np.float32(0), np.float32(p.tolerance))
    outcome = np.full(len(rho), "none   ")
    going = np.ones(len(rho), bool)
    for i in range(p.window):
        for j in range(-half, half + 1):
            measured = image[row + i, (column + j) % columns]
            with np.errstate(invalid="ignore"):
                difference = rho - measured
            seen = going & (measured != EMPTY)
            same = seen & (np.abs(difference) < tau)
            nearer = seen & ~same & (difference < -tau)
            hidden = seen & ~same & ~nearer & ~centre_ground
            outcome[same], outcome[nearer], outcome[hidden] = "static", "dynamic", "none"
            going &= ~(same | hidden)
    return outcome


def vote_by_surface(query, query_ground, sweep, sweep_ground, p):
    columns = round(360 / p.resolution_deg)
    half = p.window // 2
    mesh = ScanMesh(sweep)
    image, _ = reference_image(sweep, np.zeros(len(sweep), bool), columns)
    image = np.pad(image, ((half, half), (0, 0)), constant_values=EMPTY)
    rho, row, column = reference_pixels(*query, columns)
    window = np.stack(
        [image[row + i, (column + j) % columns]
         for i in range(p.window) for j in range(-half, half + 1)]
    )  # fmt: skip
    near_return = (np.abs(rho - window) < np.float32(p.tolerance)).any(axis=0)

    f = np.float32
    seen = triangle_image(sweep, mesh, columns)[row, column]
    corners = sweep[mesh.triangles]
    normal, flat = planes(corners)
    in_sight = rho * nearest_corner(sweep, mesh, columns, seen, row, column) < f(0.15)
    jump = (mesh.discontinuity | flat)[seen] & (seen >= 0)
    plane = ~jump & (seen >= 0)

    a, b, c = normal[seen].T
    x, y, z = query
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = (a * x + b * y) + c * z
        distance = f(1) / np.sqrt((a * a + b * b) + c * c)
        before = f(1) - depth
        level = plane & (np.abs(c) * distance > f(np.cos(np.radians(25))))
        of_ground = query_ground | sweep_ground[mesh.triangles].all(axis=1)[seen]
        level_across = np.where(of_ground, f(0.03), f(0.08))
        across = np.where(level, level_across, f(0.2))
        along = np.where(level, f(0.1), f(0.3) + f(0.01) * rho)
        on_plane = (np.abs(before) * distance < across) | (rho * np.abs(before) < along * depth)

    x, y, z = np.moveaxis(corners, -1, 0)
    beyond = rho[:, None] - np.sqrt((x * x + y * y) + z * z)[seen]
    on_corner = (np.abs(beyond) < f(p.tolerance)).any(axis=1)
    before_corners = (beyond < -f(p.tolerance)).all(axis=1)

    outcome = np.full(len(rho), "none   ")
    free = (plane & (before > 0) & (depth > 0)) | (jump & before_corners)
    met = (plane & on_plane) | (jump & on_corner)
    outcome[free & ~met & in_sight] = "dynamic"
    outcome[(met & in_sight) | (near_return & ~level)] = "static"
    return outcome


def planes(corners):
    """Unit normals over the distances of the planes, and which ones the sensor could not see."""
    p = corners.astype(np.float64)
    u, v = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    n = np.stack(
        [
            u[:, 1] * v[:, 2] - u[:, 2] * v[:, 1],
            u[:, 2] * v[:, 0] - u[:, 0] * v[:, 2],
            u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0],
        ],
        1,
    )
    length = np.sqrt((n[:, 0] * n[:, 0] + n[:, 1] * n[:, 1]) + n[:, 2] * n[:, 2])
    offset = (n[:, 0] * p[:, 0, 0] + n[:, 1] * p[:, 0, 1]) + n[:, 2] * p[:, 0, 2]
    edge_on = ~(np.abs(offset) > 0.01 * length)
    return (n / np.where(edge_on, 1, offset)[:, None]).astype(np.float32), edge_on


def triangle_image(sweep, mesh, columns):
    """For every pixel the first triangle that its centre lies in, -1 where there is none.

    Corners are counted in ``columns`` x 65536ths of a turn, exactly.
    """
    azimuth, elevation = directions(sweep)
    x = ((TURN // 2 - azimuth) * columns)[mesh.triangles]
    y = ((TURN // 4 - elevation) * columns)[mesh.triangles]
    x += np.where(x[:, :1] - x > TURN // 2 * columns, TURN * columns, 0)
    x -= np.where(x - x[:, :1] > TURN // 2 * columns, TURN * columns, 0)
    # Pixel k has its centre at (2 k + 1) turn / 2. Try all pixels of each bounding box.
    (left, right), (top, bottom) = (
        ((c.min(1) - TURN // 2 + TURN - 1) // TURN, (c.max(1) - TURN // 2) // TURN) for c in (x, y)
    )
    width, height = np.maximum(right - left + 1, 0), np.maximum(bottom - top + 1, 0)
    triangle = np.repeat(np.arange(len(x)), width * height)
    start = np.cumsum(width * height) - width * height
    nth = np.arange(len(triangle)) - start[triangle]
    column, row = left[triangle] + nth % width[triangle], top[triangle] + nth // width[triangle]
    px, py = column * TURN + TURN // 2, row * TURN + TURN // 2
    inside = np.ones(len(triangle), bool)
    for i, j in ((0, 1), (1, 2), (2, 0)):
        ax, ay, bx, by = (c[triangle, k] for k in (i, j) for c in (x, y))
        inside &= (bx - ax) * (py - ay) - (by - ay) * (px - ax) >= 0
    image = np.full((columns // 2 + 1, columns), len(x))
    np.minimum.at(image, (row[inside], column[inside] % columns), triangle[inside])
    return np.where(image == len(x), -1, image)


def nearest_corner(sweep, mesh, columns, triangle, row, column):
    """Angle from the centre of a pixel to its triangle's nearest corner, in steps of 1/8 pixel."""
    azimuth, elevation = (angle[mesh.triangles[triangle]] for angle in directions(sweep))
    x = (TURN // 2 - azimuth) * columns - (column * TURN + TURN // 2)[:, None]
    y = (TURN // 4 - elevation) * columns - (row * TURN + TURN // 2)[:, None]
    x = (x + TURN * columns // 2) % (TURN * columns) - TURN * columns // 2
    steps = np.floor(np.sqrt((x * x + y * y).min(axis=1)) / (TURN / 8))
    return np.float32(2 * np.pi / columns / 8) * np.minimum(steps, 63).astype(np.float32)


def reference_moving(points, ground, static, dynamic, once, **others):
    """Evidence shared within connected objects, with scipy's graphs and all distances."""
    p = SimpleNamespace(**OBJECTS | others)
    static, dynamic = static.astype(int), dynamic.astype(int)
    mesh = ScanMesh(points)
    edges = short_edges(
        points, mesh.triangles[~mesh.discontinuity], p.cluster_distance, p.cluster_distance_growth
    )
    candidate = dynamic > static
    label, size = connected(len(points), edges[candidate[edges].all(axis=1)])
    low, high = np.full(len(size), np.inf, np.float32), np.full(len(size), -np.inf, np.float32)
    np.minimum.at(low, label, points[:, 2])
    np.maximum.at(high, label, points[:, 2])
    rises = high - low >= np.float32(p.min_object_height)
    count = np.where(rises, size, np.bincount(label, ~ground))
    moving = candidate & (count[label] >= p.min_cluster_size)

    edges = edges[~ground[edges].any(axis=1)]
    label, size = connected(len(points), edges)
    jumps = short_edges(points, mesh.triangles[mesh.discontinuity], p.cluster_distance, 0.03)
    pieces = ~ground & (size[label] < 5)
    label, size = connected(len(points), np.concatenate([edges, jumps[pieces[jumps].all(axis=1)]]))
    in_pieces = np.bincount(label[mesh.isolated], minlength=len(size)) > 0
    free = (dynamic >= p.observed_free_votes) & (p.max_static_ratio * dynamic > static)
    found, voted = np.bincount(label, candidate), np.bincount(label, static + dynamic > 0)
    goes = found >= np.float32(p.dynamic_share) * voted
    goes &= found >= np.float32(p.min_dynamic_share) * size
    left = np.bincount(label, free) >= (np.float32(p.observed_free_share) * size.astype(np.float32))
    freed = np.bincount(label, free)
    left &= np.bincount(label, free & once) >= np.float32(p.occupied_once_share) * freed
    for k in np.flatnonzero((goes | left) & (size >= p.min_object_points)):
        members = np.flatnonzero((label == k) & ~ground)
        x, y, z = np.ptp(points[members], axis=0) if len(members) else (0, 0, 0)
        wide = x * x + y * y >= np.float32(p.min_object_width) ** 2
        if goes[k]:
            most = p.max_static_ratio * np.maximum(dynamic[members], 1)
            moving[members[static[members] < most]] = True
        elif wide and z >= np.float32(p.min_object_height) and not in_pieces[k]:
            moving[members] = True

    sure = points[moving]
    for i in np.flatnonzero(candidate & ~moving):
        clear = dynamic[i] >= p.clear_votes and dynamic[i] > 2 * static[i] and once[i]
        near = squared(sure - points[i]) < np.float32(p.neighbor_radius) ** 2
        moving[i] = (clear and not ground[i]) or near.any()

    share = np.bincount(label, moving) / size
    isolated = ~moving & ~ground & (size[label] < 5) & (static <= dynamic + p.isolated_votes)
    for k in np.flatnonzero((share >= 0.5) & (size >= p.min_object_points)):
        members = points[(label == k) & ~ground]
        low, high = members.min(0), members.max(0)
        x, y = high[:2] - low[:2]
        margin = np.float32(0.2)
        if x * x + y * y <= 25**2:
            inside = (points <= high + margin).all(1) & (low <= points + margin).all(1)
            moving |= isolated & inside
    return moving


def short_edges(points, triangles, distance, growth):
    """Sides of triangles that connect their corners."""
    corners = triangles.astype(int)
    edges = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    range_ = np.sqrt(squared(points))[edges]
    apart = squared(points[edges[:, 0]] - points[edges[:, 1]])
    along = (range_[:, 0] - range_[:, 1]) ** 2
    near = apart < np.float32(distance) ** 2
    far = np.float32(growth) * range_.min(axis=1)
    beside = along <= np.float32(0.985) ** 2 * apart
    return edges[near | (beside & (apart < far * far))]


def squared(v):
    return (v[:, 0] * v[:, 0] + v[:, 1] * v[:, 1]) + v[:, 2] * v[:, 2]


def connected(count, edges):
    graph = coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), (count, count))
    label = connected_components(graph, directed=False)[1]
    return label, np.bincount(label)


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
        moving = np.bincount(which, moves, len(keys)).astype(np.float32)
        enough = moving > np.float32(0.6) * np.bincount(which, minlength=len(keys)).astype(
            np.float32
        )
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
