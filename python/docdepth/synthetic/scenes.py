"""The streets by name."""

from __future__ import annotations

from docdepth.errors import InputError
from docdepth.synthetic.rural import highway, hills
from docdepth.synthetic.street import Scene
from docdepth.synthetic.urban import city, crossing, residential

SCENES = {
    "city": city,
    "crossing": crossing,
    "highway": highway,
    "hills": hills,
    "residential": residential,
}


def scene(name: str, seed: int = 0) -> Scene:
    """A street with its traffic; the same for the same name and seed.

    Parameters
    ----------
    name : {"city", "crossing", "highway", "hills", "residential"}
    seed : int
        Varies bends, slopes, houses, plants and vehicles.

    Raises
    ------
    InputError
        There is no such scene.
    """
    if name not in SCENES:
        raise InputError(f"there is no scene {name!r}; known are {', '.join(SCENES)}")
    return SCENES[name](seed)
