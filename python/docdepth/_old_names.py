"""Names of parameters of the last release: renamed ones, and those that are constants now."""

from __future__ import annotations

import logging
from collections.abc import Callable
from functools import lru_cache
from typing import Any

logger = logging.getLogger(__name__)

Convert = Callable[[Any, Any], Any]
"""The value of the new name, given that of the old one and the new one's present value."""


def _objects_to_evidence(shared: bool, now: str) -> str:
    return ("objects" if now == "points" else now) if shared else "points"


def _tracks_to_evidence(tracked: bool, now: str) -> str:
    return now if now == "points" else "tracks" if tracked else "objects"


# Names of the last release, which this one still understands.
RENAMED: dict[str, tuple[str, Convert]] = {
    "dynamics.against": (
        "dynamics.vote_model",
        lambda value, _: "range_image" if value == "pixels" else value,
    ),
    "dynamics.objects": ("dynamics.evidence", _objects_to_evidence),
    "dynamics.tracks": ("dynamics.evidence", _tracks_to_evidence),
    "odometry.bloom_deg": ("odometry.blooming_deg", lambda value, _: value),
    "render.surface": ("render.primitive", lambda value, _: value),
    "render.witnesses": ("render.visibility_sweeps", lambda value, _: value),
    "render.static_size_max": ("render.static_size", lambda value, now: (value, now[1])),
    "render.static_size_min": ("render.static_size", lambda value, now: (now[0], value)),
    "render.dynamic_size_max": ("render.dynamic_size", lambda value, now: (value, now[1])),
    "render.dynamic_size_min": ("render.dynamic_size", lambda value, now: (now[0], value)),
}

# Parameters of the last release that are constants now, and what its presets set them to: a
# run.yaml with these values still opens.
REMOVED: dict[str, tuple[float, ...]] = {
    "odometry.refine_voxel_size": (0.5,),
    "odometry.passes": (2, 3),
    "ground.chunk_overlap": (100.0, 0),
    "ground.least_share": (0.01, 0),
    "surface.max_gap_deg": (4.0,),
    "surface.jump_ratio": (4.0,),
    "surface.noise": (0.1,),
    "surface.flatness": (0.1,),
    "dynamics.time_radius": (10.0,),
    "dynamics.end_spacing": (0.4,),
    "dynamics.end_radius": (3.0, 0),
    "dynamics.across": (0.2,),
    "dynamics.along": (0.3,),
    "dynamics.along_growth": (0.01,),
    "dynamics.level_across": (0.08,),
    "dynamics.level_along": (0.1,),
    "dynamics.ground_across": (0.03,),
    "dynamics.level_lean_deg": (25.0,),
    "dynamics.beam": (0.15,),
    "dynamics.link": (0.3,),
    "dynamics.link_growth": (0.05,),
    "dynamics.companions": (6,),
    "dynamics.company": (1.0,),
    "dynamics.clear_votes": (2,),
    "dynamics.clear_ratio": (4.0,),
    "dynamics.object_points": (10,),
    "dynamics.object_share": (0.5,),
    "dynamics.object_least": (0.1,),
    "dynamics.object_width": (1.5,),
    "dynamics.object_height": (0.3,),
    "dynamics.freed_share": (0.6,),
    "dynamics.freed_votes": (2,),
    "dynamics.freed_ratio": (8.0,),
    "dynamics.loose_votes": (2,),
    "dynamics.track_sightings": (3,),
    "dynamics.track_distance": (1.0,),
    "dynamics.track_speed": (40.0,),
    "dynamics.track_gap": (1.0,),
    "dynamics.track_hold": (5.0,),
    "dynamics.track_stood": (0.8,),
    "dynamics.track_window": (0.3,),
    "render.step_growth": (0.22,),
    "render.max_speed": (50.0,),
    "render.loose_deg": (0.1,),
}


def translate(tree: dict[str, Any], default: Callable[[str], Any]) -> dict[str, Any]:
    """Translate a tree of parameters, ``{stage: {name: value}}``, to today's names.

    Parameters
    ----------
    tree : dict
    default : callable
        The default of a parameter by its dotted name.

    Returns
    -------
    dict

    Raises
    ------
    ValueError
        A parameter that is a constant now has another value than it used to, or an old and a new
        name contradict each other.
    """
    tree = {stage: dict(v) if isinstance(v, dict) else v for stage, v in tree.items()}
    for name, values in REMOVED.items():
        stage, _, key = name.partition(".")
        if isinstance(tree.get(stage), dict) and key in tree[stage]:
            value = tree[stage].pop(key)
            if value not in values:
                raise ValueError(f"{is_constant(name)} (here it is {value!r})")
            if not tree[stage]:  # the stage itself may be gone
                del tree[stage]
    for name, (new, convert) in RENAMED.items():
        stage, _, key = name.partition(".")
        if isinstance(tree.get(stage), dict) and key in tree[stage]:
            warn_of_rename(name, new)
            value, new_key = tree[stage].pop(key), new.partition(".")[2]
            now = tree[stage].get(new_key, default(new))
            try:
                tree[stage][new_key] = convert(value, now)
            except (TypeError, IndexError):
                raise ValueError(f"{new} = {now!r} cannot be joined with {name}") from None
    return tree


def is_constant(name: str) -> str:
    """The message to somebody who sets what is a constant now."""
    return f"{name} is no parameter any more but the constant {REMOVED[name][0]:g}; leave it out"


@lru_cache  # a run reads its parameters often
def warn_of_rename(old: str, new: str) -> None:
    """Warn once of each old name."""
    logger.warning("%s is called %s now; the next release will not know the old name", old, new)
