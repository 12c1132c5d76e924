"""All scenes by name."""

from __future__ import annotations

from docdepth.errors import InputError
from docdepth.synthetic.rural import highway, hills
from docdepth.synthetic.street import Scene
from docdepth.synthetic.traffic import arrivals, overtaking, queue
from docdepth.synthetic.urban import city, crossing, residential

SCENES = {
    "arrivals": arrivals,
    "city": city,
    "crossing": crossing,
    "highway": highway,
    "hills": hills,
    "overtaking": overtaking,
    "queue": queue,
    "residential": residential,
}


def scene(name: str, seed: int = 0) -> Scene:
    """Build a street with its traffic; equal names and seeds give equal scenes.

    Parameters
    ----------
    name : str
        One of :data:`SCENES`.
    seed : int
        Varies bends, slopes, houses, plants and vehicles.

    Raises
    ------
    InputError
        The name is unknown.
    """
    if name not in SCENES:
        raise InputError(f"unknown scene {name!r}; there are {', '.join(SCENES)}")
    return SCENES[name](seed)
