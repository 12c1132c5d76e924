"""Small scenes on a plane."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from docdepth.synthetic import Actor, Mesh, Pace, Path, Scene
from docdepth.synthetic.mesh import merged
from docdepth.synthetic.road import Road
from docdepth.synthetic.street import PAINTS


def level_road(end: float = 350.0) -> Road:
    """A plane: x = s, y = d, z = 0."""

    def nothing(s, d=None):
        return np.zeros(np.shape(s))

    cuts = np.linspace(-100.0, 100.0, 9).tolist()
    asphalt = lambda s, d: np.zeros(np.shape(s), np.int64)  # noqa: E731
    return Road(-150.0, end, nothing, nothing, nothing, asphalt, PAINTS, cuts)


def plain_scene(
    static: Sequence[Mesh] = (), actors: Sequence[Actor] = (), speed: float = 0.0
) -> Scene:
    """Meshes and actors on a plane, where the ego moves along x from the origin [m/s]."""
    road = level_road(max(350.0, 150.0 + speed * 30.0))
    ego = Path(road, [(0.0, 0.0), (1.0, 0.0)], Pace(speed))
    return Scene("plain", merged([road.ground(25.0), *static]), list(actors), ego, 30.0)
