"""All scenes by name."""

from __future__ import annotations

from docdepth.errors import InputError
from docdepth.synthetic.street import Scene
from docdepth.synthetic.urban import city, crossing

SCENES = {"city": city, "crossing": crossing}
"""Makers of scenes by name, called with a seed. The benchmarks add more."""


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
