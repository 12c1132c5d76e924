"""Arguments of the compiled module that fit each other, and ways to spoil them."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import numpy as np

import docdepth._core as _core

POINTS = 360


class Scene:
    """Arguments that fit each other, and ways to spoil them."""

    def __init__(self, seed: int) -> None:
        self.random = np.random.default_rng(seed)
        r, n = self.random, POINTS
        # Rings around a sensor 1.7 m above the ground, with things of 3 to 15 m range on it.
        azimuth, elevation = np.meshgrid(np.linspace(-0.6, 0.6, 30), np.linspace(-0.3, 0.2, 12))
        ranges = np.where(elevation < -0.11, -1.7 / np.sin(np.minimum(elevation, -0.1)), 15)
        ranges = np.minimum(ranges, np.where(np.abs(azimuth) < 0.2, r.uniform(3, 9), 99))
        across = ranges * np.cos(elevation)
        columns = across * np.cos(azimuth), across * np.sin(azimuth), ranges * np.sin(elevation)
        self.points = np.stack(columns, axis=-1).reshape(-1, 3).astype(np.float32)
        self.points += r.normal(0, 0.01, (n, 3)).astype(np.float32)
        ground = self.points[:, 2] < -1.5
        mesh = _core.ScanMesh(self.points, _core.MeshParameters())
        objects = _core.cluster_objects(self.points, ground, mesh, _core.ObjectParameters())
        pose, dynamic = np.eye(4), r.random(n) < 0.2
        classid = r.choice([0, 50, 100], n).astype(np.uint16)
        frame = _core.Frame(self.points, classid, 300.0)
        isolated = np.array(mesh.isolated)
        of_mesh = (np.array(mesh.triangles), np.array(mesh.discontinuity), isolated)
        owner = np.where(classid == 100, 1, 0).astype(np.uint16)
        motion = np.array([[5, 0, 0, 0.01]], np.float32)
        of_objects = (0.002, owner, motion)
        mesh_frame = _core.MeshFrame(self.points, classid, *of_mesh, *of_objects)
        image = _core.RangeImage(self.points, ground, 0.01, 5, 0.2)
        stays = (dynamic, np.zeros(n, np.int32), np.full(n, 3, np.int32))
        detections = _core.Detections(self.points, ground, objects, dynamic, *stays, mesh, pose)
        numbers, areas, extents, samples, _, borders, sample_times = detections.arrays
        box = np.r_[np.eye(4)[:3].ravel(), 2, 1, 1].astype(np.float32)
        self.mesh_image = _core.MeshImage(self.points, ground, mesh, _core.MeshImageParameters())
        self.static_splats, self.dynamic_splats = [(frame, pose)] * 3, [(frame, pose)]
        self.static_meshes = [(mesh_frame, pose)] * 3
        sighting = (mesh_frame, 1, pose, 3)
        self.sighted = [(7, (4.0, 2.0, 4.2), [sighting], [sighting], [sighting])]
        self.good: dict[str, Any] = {
            "points": self.points,
            "queries": self.points[:50].copy(),
            "ray_origins": np.zeros((n, 3), np.float32),
            "normals": r.normal(size=(n, 3)).astype(np.float32),
            "ground": ground,
            "dynamic": dynamic,
            "objects": objects,
            "static_votes": r.integers(0, 9, n).astype(np.uint16),
            "dynamic_votes": r.integers(0, 9, n).astype(np.uint16),
            "classid": classid,
            "time_offset": np.zeros(n, np.float32),
            "mesh": mesh,
            "meshes": [mesh, mesh],
            "triangles": of_mesh[0],
            "discontinuity": of_mesh[1],
            "isolated": isolated,
            "T_world_lidar": pose,
            "corner": pose[:3, 3].copy(),
            "poses": np.stack([pose, pose]),
            "key_frames": [image, self.mesh_image],
            "one_stay": stays[0],
            "first_occupied": stays[1],
            "last_occupied": stays[2],
            "earlier": 1,
            "boxes": np.stack([box, box]),
            "extents": extents,
            "areas": areas,
            "numbers": numbers,
            "samples": samples,
            "borders": borders,
            "sample_times": sample_times,
            "voxels": np.arange(9, dtype=np.uint64),
            "read": lambda sweep: detections,
            "take": lambda found: None,
            "held": 2,
            "times": np.arange(4) * 0.1,
            "K": np.array([[20.0, 0, 16], [0, 20, 12], [0, 0, 1]]),
            "width": 32,
            "height": 24,
            "depth": r.uniform(1, 50, (24, 32)).astype(np.float32),
            "static_size": (50.0, 3.0),
            "dynamic_size": (80.0, 35.0),
            "owner": owner,
            "motion": motion,
            "drawn": np.ones(len(motion), np.uint8),
            "displacement": np.zeros((n, 3), np.float32),
            "visibility_sweeps": 15,
            "nearest_frames": 1,
            "isolated_angle": 0.002,
            "shutter_frames": [(mesh_frame, pose, 0.03)],
            "seen": True,
            "crop": 300.0,
            "size": 0.5,
            "min_range": 1.0,
            "max_range": 100.0,
            "resolution": 0.01,
            "window": 5,
            "tolerance": 0.2,
            "plain": False,
            "normal_tolerance": 0.2,
            "radial_tolerance": 0.2,
            "radial_growth": 0.01,
            "threads": 2,
            "backend": "osmesa",
            "device": -1,
            "library": "",
        }
        # The maps whose methods are called, and classes whose instances are arguments.
        self.instances: dict[str, Callable[[], Any]] = {
            "GroundMap": self._ground_map,
            "Rays": lambda: _core.Rays(self.points, self.good["normals"]),
            "Frame": lambda: frame,
            "ScanMesh": lambda: mesh,
            "Detections": lambda: detections,
            "Margins": lambda: _core.Margins(0.1, 0.1, 0.1),
        }

    def _ground_map(self) -> Any:
        ground_map = _core.GroundMap(_core.GroundParameters(), 2)
        if self.random.random() < 0.8:
            ground_map.insert(self.points, np.eye(4))
        return ground_map

    def fitting(self, name: str, argument: str, kind: str) -> Any:
        """An argument that fits the others."""
        if argument == "parameters":
            return getattr(_core, kind)()
        if argument in ("static_frames", "dynamic_frames"):
            which = "splats" if "splat" in name else "meshes"
            return getattr(self, argument.replace("frames", which))
        if argument == "objects" and "mesh" in name.rpartition(".")[2]:
            return self.sighted
        if argument == "boxes" and "meshes" in name.rpartition(".")[2]:
            return [(np.eye(4), (4.0, 1.8, 1.5))]
        if argument == "times" and name == "thin_sweep":
            return self.good["time_offset"]
        return self.good[argument]

    def spoiled(self, value: Any) -> tuple[str, Any]:
        """A bad variant of a value, and what was done to it."""
        r = self.random
        if r.random() < 0.06:
            odd = [None, "x", b"", [], {}, (), object(), 3, np.nan, lambda: 0, np.zeros(0), [[]]]
            return self._any(odd)
        if isinstance(value, np.ndarray):
            return self._array(value)
        if isinstance(value, bool):
            return self._any([1, None, 2**70, "yes"])
        if isinstance(value, int):
            return self._any(
                [0, 1, -1, 7, 16, 101, 4096, 65536, 100_000, 2**31 - 1, -(2**31), 2**31, 2**32 + 5]
                + [2**63 - 1, 2**63, 2**64, 10**30, -(10**30), 1.5, "1", np.nan, 2**24]
            )
        if isinstance(value, float):
            return self._any(
                [0.0, -0.0, -1.0, 1e-9, 1e-300, 1e9, 1e18, 1e38, 3.5e38, 1e300, np.nan, np.inf]
                + [-np.inf, 2.0**31, 2.0**63, 1e-5, 1e-45, 1, True, float(r.normal() * 1e4)]
            )
        if isinstance(value, tuple) and len(value) == 2 and isinstance(value[0], float):
            return self._pair(value)
        if isinstance(value, list):
            return self._list(value)
        if isinstance(value, str):
            return self._any(["", "egl", "egl:9", "\0", "\udcff", "x" * 5000, "surfaceless"])
        if inspect.isfunction(value):
            made = self._any([None, 3, np.zeros(3), (), self.good["mesh"], inspect.isfunction])[1]
            return "a function of " + repr(made)[:40], lambda *given: made
        return self._instance(value)

    def _any(self, values: list[Any]) -> tuple[str, Any]:
        value = values[self.random.integers(len(values))]
        return repr(value)[:60], value

    def _pair(self, value: tuple[float, float]) -> tuple[str, Any]:
        what, other = self.spoiled(value[0])
        place = int(self.random.integers(4))
        pairs = [(other, value[1]), (value[0], other), (other, other), (other,)]
        return f"pair {place} with {what}", pairs[place]

    def _list(self, value: list[Any]) -> tuple[str, Any]:
        r, items = self.random, list(value)
        how = r.integers(6)
        if how == 0 or not items:
            return "empty", []
        if how == 1:
            return "one less", items[:-1]
        if how == 2:
            return "one more", [*items, items[0]]
        k = int(r.integers(len(items)))
        if how == 3:
            return f"item {k} None", [*items[:k], None, *items[k + 1 :]]
        if isinstance(items[k], tuple):
            parts = list(items[k])
            j = int(r.integers(len(parts)))
            what, parts[j] = ("None", None) if j == 0 and how == 4 else self.spoiled(parts[j])
            items[k] = tuple(parts)
            return f"item {k} part {j} {what}", items
        what, items[k] = self.spoiled(items[k])
        return f"item {k} {what}", items

    def _instance(self, value: Any) -> tuple[str, Any]:
        """An object of the core: never initialised, of other points, or with odd attributes."""
        r, kind = self.random, type(value)
        if kind.__name__.endswith("Parameters"):
            names = [n for n in dir(value) if not n.startswith("_")]
            told = []
            for name in r.choice(names, r.integers(1, 3)):
                number = getattr(value, name)
                holder = value
                if isinstance(number, list):
                    number = np.array(number)
                elif not isinstance(number, (int, float)):
                    number, name, holder = 0.5, "radial_tolerance", number
                what, odd = self.spoiled(number)
                try:
                    setattr(holder, name, odd)
                    told.append(f"{name}={what}")
                except (TypeError, ValueError, OverflowError):
                    pass
            return " ".join(told), value
        how = r.integers(3)
        if how == 0:
            return "a class", kind
        fewer = self.points[: r.integers(0, POINTS)]
        return "of fewer points", {
            "ScanMesh": lambda: _core.ScanMesh(fewer, _core.MeshParameters()),
            "Detections": lambda: _core.Detections.of(
                np.zeros((0, 10), np.uint32),
                np.zeros((0, 4), np.float32),
                np.zeros((0, 6), np.float32),
                *np.zeros((3, 0, 3), np.float32),
            ),
        }.get(kind.__name__, lambda: None)()

    def _array(self, a: np.ndarray) -> tuple[str, Any]:
        how = int(self.random.integers(3))
        if how == 0:
            return self._other_form(a)
        return self._other_values(a)

    def _other_form(self, a: np.ndarray) -> tuple[str, Any]:
        r = self.random
        raw = np.frombuffer(b"x" + a.tobytes(), np.uint8)[1:]
        forms: dict[str, Callable[[], Any]] = {
            "empty": lambda: a[:0],
            "one less": lambda: a[:-1],
            "twice": lambda: np.concatenate([a, a]),
            "fewer columns": lambda: a[..., :-1],
            "one axis more": lambda: a[None],
            "flat": lambda: a.ravel(),
            "scalar": lambda: a.ravel()[:1].sum(),
            "transposed": lambda: a.T,
            "reversed": lambda: a[::-1],
            "every other": lambda: a[::2],
            "fortran": lambda: np.asfortranarray(a),
            "read-only": lambda: np.frombuffer(a.tobytes(), a.dtype).reshape(a.shape),
            "swapped bytes": lambda: a.astype(a.dtype.newbyteorder()),
            "unaligned": lambda: raw.view(a.dtype).reshape(a.shape),
            "list": lambda: a.tolist(),
            "wide and empty": lambda: np.empty((2**31 + 5, 0), a.dtype),
            "wider and empty": lambda: np.empty((2**59, 0), a.dtype),
            "empty and wide": lambda: np.empty((0, 2**40), a.dtype),
            "masked": lambda: np.ma.masked_all(a.shape, a.dtype),
        }
        for kind in ("f4", "f8", "i8", "u1", "c16", "O", "?", "S4", "f2", "u4", "M8[s]"):
            forms[f"dtype {kind}"] = lambda kind=kind: a.astype(kind)
        name = str(r.choice(list(forms)))
        return name, forms[name]()

    def _other_values(self, a: np.ndarray) -> tuple[str, Any]:
        r, b = self.random, a.copy()
        if not b.size:
            return self._other_form(a)
        share = r.choice([0.01, 0.2, 1.0])
        where = r.random(b.shape) <= share
        where.flat[r.integers(b.size)] = True
        if b.dtype.kind == "f":
            big = float(np.finfo(b.dtype).max)
            odd = [
                np.nan,
                np.inf,
                -np.inf,
                0,
                1e6,
                1e9,
                1e18,
                1e19,
                1e30,
                big,
                -big,
                1e-38,
                1e-20,
                -1,
            ]
        elif b.dtype.kind == "b":
            b = np.where(where, 255, 1).astype(np.uint8).view(bool)
            return "flags of 255", b
        else:
            top = np.iinfo(b.dtype)
            odd = [0, 1, int(top.max), int(top.max) - 1, len(a), len(a) - 1, 2**15]
        if r.random() < 0.25:
            b = np.frombuffer(r.bytes(b.nbytes), b.dtype).reshape(b.shape).copy()
            return "random bits", b
        if r.random() < 0.2 and b.dtype.kind == "f":
            b[where] *= 10.0 ** r.integers(-30, 30)
            return "scaled", b
        value = odd[r.integers(len(odd))]
        value = value if b.dtype.kind == "f" else value % (int(np.iinfo(b.dtype).max) + 1)
        with np.errstate(all="ignore"):
            b[where] = value
        return f"{value} in {int(where.sum())} of {b.size}", b
